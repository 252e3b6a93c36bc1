//! Simulated devices that answer at a serial line, and programs whose clocks do not count how long these take.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rustix::fs::stat;

use super::board::Board;

/// A device at the end of a pseudo-terminal, on a thread of its own until it is unplugged. A program with the hook `answers`
/// waits with each write until the device has answered.
pub struct AnsweringDevice {
    pub path: PathBuf,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl AnsweringDevice {
    /// Plugs in a device that answers each message by `take`, which is also called while nothing comes.
    pub fn plugged_in(take: impl FnMut(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        let board = Board::plugged_in();
        let path = board.device.clone();
        let listener = listener(&path);
        let is_over = Arc::<AtomicBool>::default();
        let over = Arc::clone(&is_over);
        let thread = thread::spawn(move || run(board, &listener, take, &over));
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

/// A program that waits in a write, and what the device has read and answered since the write began, in bytes.
struct Writer {
    stream: UnixStream,
    /// How many bytes the program has written, once it has.
    written: Option<usize>,
    read: usize,
    answered: u32,
}

impl Writer {
    /// Lets the next program write.
    fn accept(listener: &UnixListener) -> Option<Self> {
        let (mut stream, _) = listener.accept().ok()?;
        stream.set_nonblocking(true).unwrap();
        stream.write_all(&[0]).ok()?;
        Some(Self { stream, written: None, read: 0, answered: 0 })
    }

    /// Returns whether the program waits no longer: it has its answer, or has ended.
    fn is_over(&mut self) -> bool {
        let mut count = [0; 4];
        match self.stream.read(&mut count) {
            Ok(0) => return true,
            Ok(_) => self.written = Some(u32::from_ne_bytes(count) as usize),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return true,
        }
        let is_answered = self.written.is_some_and(|written| self.read >= written);
        if is_answered {
            let _ = self.stream.write_all(&self.answered.to_ne_bytes());
        }
        is_answered
    }
}

fn run(mut board: Board, listener: &UnixListener, mut take: impl FnMut(&[u8]) -> Vec<u8>, is_over: &AtomicBool) {
    let mut writer: Option<Writer> = None;
    while !is_over.load(Relaxed) {
        writer = writer.or_else(|| Writer::accept(listener));
        let mut bytes = [0; 1024];
        let length = board.master.read(&mut bytes).unwrap_or(0);
        let answer = take(&bytes[..length]);
        let _ = board.master.write_all(&answer);
        if let Some(writer) = &mut writer {
            writer.read += length;
            writer.answered += answer.len() as u32;
        }
        writer.take_if(Writer::is_over);
        if length == 0 {
            let pause_us = if writer.is_some() { 50 } else { 500 };
            thread::sleep(Duration::from_micros(pause_us));
        }
    }
}
