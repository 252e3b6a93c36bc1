//! The log of the service: lines on standard error, which must never delay the service.

use std::io::{self, IsTerminal as _, Write, stderr};
use std::os::fd::AsFd;
use std::sync::Mutex;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use tracing::level_filters::LevelFilter;
use tracing_subscriber::fmt::time::uptime;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{Registry, reload};

/// The largest write that a pipe reported as writable accepts without blocking (`PIPE_BUF` in pipe(7)).
const LONGEST_LINE: usize = 4096;

/// Starts the log on standard error. Lines have no times if they go to the journal, which adds its own. Returns what changes
/// the level.
pub fn start(level: LevelFilter) -> reload::Handle<LevelFilter, Registry> {
    let (filter, handle) = reload::Layer::new(level);
    let output = Mutex::new(Lossy { output: stderr(), lost: 0 });
    let lines = tracing_subscriber::fmt::layer().with_target(false).with_writer(output);
    // `tracing` would report that standard error is closed on standard error, and panic.
    let lines = lines.log_internal_errors(false);
    let registry = tracing_subscriber::registry().with(filter);
    if std::env::var_os("JOURNAL_STREAM").is_some() {
        registry.with(lines.without_time().with_ansi(false)).init();
    } else {
        registry.with(lines.with_timer(uptime()).with_ansi(stderr().is_terminal())).init();
    }
    handle
}

/// An output that never blocks. A line that cannot be written at once is dropped, and the next one that can be follows a
/// count of the dropped ones. A line that is too long loses its end.
struct Lossy<W> {
    output: W,
    lost: u64,
}

impl<W: Write + AsFd> Lossy<W> {
    /// Returns whether the output accepts a line now. If its reader has gone, this is true and the write fails.
    fn is_writable(&self) -> bool {
        const AT_ONCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };
        poll(&mut [PollFd::new(&self.output, PollFlags::OUT)], Some(&AT_ONCE)).is_ok_and(|ready| ready > 0)
    }
}

impl<W: Write + AsFd> Write for Lossy<W> {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.lost > 0 && self.is_writable() {
            let lost = std::mem::take(&mut self.lost);
            writeln!(self.output, "{lost} lines of the log are lost: they were not read in time")?;
        }
        if self.is_writable() {
            match line.get(..LONGEST_LINE - 1) {
                Some(kept) if line.len() > LONGEST_LINE => self.output.write_all(&[kept, b"\n"].concat())?,
                _ => self.output.write_all(line)?,
            }
        } else {
            self.lost += 1;
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, pipe};

    use super::*;

    /// The most that Linux writes to a pipe whole or not at all.
    const PIPE_BUF: usize = 4096;

    #[test]
    fn a_line_that_cannot_be_written_at_once_is_dropped_and_counted_and_a_longer_one_keeps_its_line_end() {
        let (mut reader, output) = pipe().unwrap();
        let mut log = Lossy { output, lost: 0 };
        while log.is_writable() {
            log.write_all(&[b'.'; PIPE_BUF]).unwrap();
        }
        log.write_all(b"first\n").unwrap();
        reader.read_exact(&mut [0; 4 * PIPE_BUF]).unwrap();
        log.write_all(b"second\n").unwrap();
        [&[b'x'; PIPE_BUF + 1][..], b"third\n"].iter().for_each(|line| log.write_all(line).unwrap());
        drop(log);
        let mut rest = String::new();
        reader.read_to_string(&mut rest).unwrap();
        let long = "x".repeat(PIPE_BUF - 1);
        let want = format!(".1 lines of the log are lost: they were not read in time\nsecond\n{long}\nthird\n");
        assert!(rest.ends_with(&want), "{rest}");
    }
}
