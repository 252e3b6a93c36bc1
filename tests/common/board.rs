//! A pseudo-terminal that plays a board at a serial line.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use facewire_packet::{FrameReader, Packet};
use rustix::fs::{Mode, OFlags};
use rustix::io::{Errno, ioctl_fionbio, ioctl_fionread};
use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::eventually;

/// How many bytes wait at the board's end of a line that it does not read (`N_TTY_BUF_SIZE` of Linux, less one).
const END_BYTES: u64 = 4095;

pub struct Board {
    pub master: File,
    pub device: PathBuf,
    reader: FrameReader,
}

impl Board {
    pub fn plugged_in() -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        unlockpt(&master).unwrap();
        ioctl_fionbio(&master, true).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let device = OsStr::from_bytes(name.as_bytes()).into();
        Self { master: master.into(), device, reader: FrameReader::default() }
    }

    /// Opens the port like a program that does not lock it.
    pub fn port(&self) -> OwnedFd {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        rustix::fs::open(&self.device, flags, Mode::empty()).unwrap()
    }

    /// Fills the line, as if the board had stopped reading. The bytes stay until the returned port is dropped.
    pub fn stall(&self) -> File {
        let mut port = File::from(self.port());
        let mut modes = tcgetattr(&port).unwrap();
        modes.make_raw();
        tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
        let mut fill = || std::iter::repeat_with(|| port.write(&[1])).take_while(Result::is_ok).count();
        // The system moves bytes to the board's end after a while, which makes room again until that end is full.
        eventually("a full line", || {
            let is_end_full = ioctl_fionread(&self.master).unwrap() >= END_BYTES;
            let is_full = fill() == 0 && is_end_full;
            thread::sleep(Duration::from_millis(50));
            is_full && fill() == 0
        });
        port
    }

    /// Sends these bytes, which must be fewer than the line holds.
    pub fn send(&self, bytes: &[u8]) {
        (&self.master).write_all(bytes).unwrap();
    }

    pub fn packets(&mut self) -> Vec<Packet> {
        let mut bytes = [0; 4096];
        let length = self.master.read(&mut bytes).unwrap_or(0);
        let taken = bytes.iter().take(length);
        taken.filter_map(|byte| self.reader.push(*byte)?.ok()).collect()
    }

    /// Whether nobody has the port open. Bytes on the line are lost.
    pub fn is_closed(&mut self) -> bool {
        let read = self.master.read(&mut [0; 4096]);
        read.is_err_and(|error| error.raw_os_error() == Some(Errno::IO.raw_os_error()))
    }

    /// Waits for packets, and returns those that arrive first.
    pub fn next(&mut self) -> Vec<Packet> {
        let mut packets = Vec::new();
        eventually("a packet", || {
            packets = self.packets();
            !packets.is_empty()
        });
        packets
    }
}

/// A path that always means the same board, like those in `/dev/serial/by-id/`.
pub struct StablePath(tempfile::TempDir);

impl StablePath {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self) -> PathBuf {
        self.0.path().join("board")
    }

    /// Unplugs the board. Its path disappears first, because another board may get its device node at once.
    pub fn pull(&self, board: Board) {
        fs::remove_file(self.path()).unwrap();
        drop(board);
    }

    pub fn leads_to(&self, board: &Board) {
        symlink(&board.device, self.path()).unwrap();
    }

    /// Moves the path to another board in one step, as udev does.
    pub fn leads_elsewhere(&self, board: &Board) {
        let link = self.0.path().join("new");
        symlink(&board.device, &link).unwrap();
        fs::rename(link, self.path()).unwrap();
    }
}
