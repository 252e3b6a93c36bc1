//! Stops a thread of another process wherever it is, like an inference that hangs.

use std::fs;
use std::process::Child;
use std::thread::sleep;
use std::time::Duration;

use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;

/// A thread that is stopped until this is dropped. The kernel allows only the thread that stopped it to resume it.
pub struct Stuck(Pid);

impl Stuck {
    /// Stops a thread in the middle of its work, or while it waits.
    pub fn stop(thread: i32) -> Self {
        let thread = Pid::from_raw(thread);
        ptrace::seize(thread, ptrace::Options::empty()).unwrap();
        ptrace::interrupt(thread).unwrap();
        waitpid(thread, Some(WaitPidFlag::__WALL)).unwrap();
        Self(thread)
    }

    /// Stops a thread while it computes. It waits only inside calls of the kernel.
    pub fn computing(thread: i32) -> Self {
        loop {
            let stuck = Self::stop(thread);
            // The kernel writes -1 for a thread outside of all calls.
            if fs::read_to_string(format!("/proc/{thread}/syscall")).unwrap().starts_with("-1 ") {
                return stuck;
            }
            drop(stuck);
            sleep(Duration::from_millis(3));
        }
    }
}

impl Drop for Stuck {
    fn drop(&mut self) {
        // The thread may have been killed meanwhile. Then its process cannot end until this one has waited for the thread.
        if ptrace::detach(self.0, None).is_err() {
            let _ = waitpid(self.0, Some(WaitPidFlag::__WALL));
        }
    }
}

/// Waits until the process has a thread of this name, and returns its number.
pub fn thread_called(child: &mut Child, name: &str) -> i32 {
    let tasks = format!("/proc/{}/task", child.id());
    let is_called =
        |thread: &str| fs::read_to_string(format!("{tasks}/{thread}/comm")).is_ok_and(|comm| comm.trim_end() == name);
    loop {
        let threads = fs::read_dir(&tasks).unwrap().map(|task| task.unwrap().file_name().into_string().unwrap());
        if let Some(thread) = threads.into_iter().find(|thread| is_called(thread)) {
            return thread.parse().unwrap();
        }
        assert_eq!(child.try_wait().unwrap(), None, "the program has ended");
        sleep(Duration::from_millis(10));
    }
}
