//! Threads of another process, and one that stands still wherever it is: an inference that hangs.

use std::fs;
use std::process::Child;
use std::thread::sleep;
use std::time::Duration;

use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;

/// A thread that is stopped until this is dropped. The kernel wants both in the same thread.
pub struct Stuck(Pid);

impl Stuck {
    /// Stops it in the middle of whatever it is at.
    pub fn stop(thread: i32) -> Self {
        let thread = Pid::from_raw(thread);
        ptrace::seize(thread, ptrace::Options::empty()).unwrap();
        ptrace::interrupt(thread).unwrap();
        waitpid(thread, Some(WaitPidFlag::__WALL)).unwrap();
        Self(thread)
    }

    /// Stops it while it computes: in no call of the kernel, where it waits.
    pub fn computing(thread: i32) -> Self {
        loop {
            let stuck = Self::stop(thread);
            // The kernel's word for no call is -1.
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
        // It may have been killed meanwhile.
        let _ = ptrace::detach(self.0, None);
    }
}

/// The number of the process's thread of this name, once it is there.
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
