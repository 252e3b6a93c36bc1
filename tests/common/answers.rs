//! Simulated devices that answer at a serial line.

use std::io::{self, Read as _, Write as _};
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rustix::fs::stat;

use super::PATIENCE;
use super::board::Board;

/// A device at the end of a pseudo-terminal, on a thread of its own until it is unplugged. A program with the hook `answers`
/// gets its answers in time, however busy the machine is.
pub struct AnsweringDevice {
    pub path: PathBuf,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl AnsweringDevice {
    /// Plugs in a device that answers what it reads by `take`, which gets an empty slice while nothing arrives.
    pub fn plugged_in(take: impl FnMut(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        let board = Board::plugged_in();
        let path = board.device.clone();
        let listener = listener(&path);
        let is_over = Arc::<AtomicBool>::default();
        let over = Arc::clone(&is_over);
        let thread = thread::spawn(move || run(board, listener, take, &over));
        Self { path, is_over, thread: Some(thread) }
    }
}

impl Drop for AnsweringDevice {
    fn drop(&mut self) {
        self.is_over.store(true, Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// The socket at which the hook waits for the device.
fn listener(path: &PathBuf) -> UnixListener {
    let status = stat(path).unwrap();
    let name = format!("facewire-answers-{}-{}", status.st_dev, status.st_rdev);
    let listener = UnixListener::bind_addr(&SocketAddr::from_abstract_name(name).unwrap()).unwrap();
    listener.set_nonblocking(true).unwrap();
    listener
}

/// Answers programs until the device is unplugged. The socket is closed before the pseudo-terminal, whose number the next
/// device may get.
fn run(mut board: Board, listener: UnixListener, mut take: impl FnMut(&[u8]) -> Vec<u8>, is_over: &AtomicBool) {
    while !is_over.load(Relaxed) {
        let mut is_idle = true;
        while let Ok((program, _)) = listener.accept() {
            is_idle = false;
            // A program may have ended.
            let _ = answer(program, &mut take);
        }
        // A program without the hook, and answers that a device gives later.
        let mut bytes = [0; 1024];
        let length = board.master.read(&mut bytes).unwrap_or(0);
        let _ = board.master.write_all(&take(&bytes[..length]));
        if is_idle && length == 0 {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Takes what a program writes, and answers it, as `tests/hooks/answers.c` describes.
fn answer(mut program: UnixStream, take: &mut impl FnMut(&[u8]) -> Vec<u8>) -> io::Result<()> {
    program.set_nonblocking(false)?;
    program.set_read_timeout(Some(PATIENCE))?;
    let mut length = [0; 4];
    program.read_exact(&mut length)?;
    let mut bytes = vec![0; u32::from_ne_bytes(length) as usize];
    program.read_exact(&mut bytes)?;
    let answer = take(&bytes);
    program.write_all(&(answer.len() as u32).to_ne_bytes())?;
    program.write_all(&answer)
}
