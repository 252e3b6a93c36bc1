//! How far long work has come: a line on a terminal that is drawn anew.

use std::fmt::Display;
use std::io::{self, BufRead, IsTerminal as _, Read, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::tcgetwinsize;

/// Time between two lines.
const PERIOD: Duration = Duration::from_millis(200);
/// Moves to the first column and clears the line.
const CLEAR: &str = "\r\x1b[K";
/// Below this share, the time that is left is a guess.
const LEAST_SHARE: f64 = 0.02;

/// How much of a file was read. The default knows of none.
#[derive(Debug, Clone, Default)]
pub struct ShareRead {
    read_bytes: Arc<AtomicU64>,
    file_bytes: u64,
}

impl ShareRead {
    pub fn of(file_bytes: u64) -> Self {
        Self { file_bytes, ..Self::default() }
    }

    /// The share from 0 to 1, if the size of the file is known.
    pub fn share(&self) -> Option<f64> {
        let is_known = self.file_bytes > 0;
        is_known.then(|| (self.read_bytes.load(Relaxed) as f64 / self.file_bytes as f64).min(1.0))
    }

    /// Counts what is read from this file.
    pub fn count<R: Read>(&self, input: R) -> Counted<R> {
        Counted { input, read_bytes: Arc::clone(&self.read_bytes) }
    }
}

/// A reader that counts the bytes that were taken from it.
pub struct Counted<R> {
    input: R,
    read_bytes: Arc<AtomicU64>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let length = self.input.read(bytes)?;
        self.read_bytes.fetch_add(length as u64, Relaxed);
        Ok(length)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.input.fill_buf()
    }

    fn consume(&mut self, length: usize) {
        self.read_bytes.fetch_add(length as u64, Relaxed);
        self.input.consume(length);
    }
}

/// The line on standard error. It shows nothing unless that is a terminal, and goes when it is dropped.
pub struct ProgressLine {
    is_shown: bool,
    begun: Instant,
    drawn: Option<Instant>,
}

impl ProgressLine {
    pub fn new() -> Self {
        Self { is_shown: io::stderr().is_terminal(), begun: Instant::now(), drawn: None }
    }

    /// Shows nothing if the lines of the result go to the same terminal.
    pub fn beside_standard_output(self) -> Self {
        let is_shown = self.is_shown && !io::stdout().is_terminal();
        Self { is_shown, ..self }
    }

    pub fn is_shown(&self) -> bool {
        self.is_shown
    }

    /// Shows this text and, if the share of the work that is done is known, percent and the time that is left.
    pub fn draw(&mut self, share: Option<f64>, text: impl Display) {
        if !self.is_shown || self.drawn.is_some_and(|drawn| drawn.elapsed() < PERIOD) {
            return;
        }
        self.drawn = Some(Instant::now());
        if !is_writable() {
            return;
        }
        let share = share.map_or_else(String::new, |share| in_words(share, self.begun.elapsed()));
        // A longer line would leave its beginning behind.
        let columns = tcgetwinsize(io::stderr()).map_or(80, |size| usize::from(size.ws_col));
        let line: String = format!("{share}{text}").chars().take(columns.saturating_sub(1)).collect();
        // A terminal that has gone shows nothing.
        let _ = write!(io::stderr(), "{CLEAR}{line}");
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        if self.drawn.is_some() {
            let _ = write!(io::stderr(), "{CLEAR}");
        }
    }
}

/// Whether the terminal takes a line now. One that somebody has stopped must not hold up the work.
fn is_writable() -> bool {
    let stderr = io::stderr();
    let mut polled = [PollFd::new(&stderr, PollFlags::OUT)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut polled, Some(&now)).is_ok_and(|ready| ready > 0)
}

/// Percent and the time that is left, after this time.
fn in_words(share: f64, elapsed: Duration) -> String {
    let percent = (100.0 * share).floor();
    if share < LEAST_SHARE {
        return format!("{percent:3.0} %, ");
    }
    let left_s = (elapsed.as_secs_f64() * (1.0 - share) / share).ceil() as u64;
    format!("{percent:3.0} %, {} left, ", clock(left_s))
}

/// Minutes and seconds.
pub fn clock(seconds: u64) -> String {
    format!("{}:{:02}", seconds / 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_a_file_and_the_time_that_is_left_follow_what_was_read() {
        let share = ShareRead::of(400);
        let mut input = share.count(&[0; 400][..]);
        assert_eq!(input.fill_buf().unwrap().len(), 400);
        assert_eq!(share.share(), Some(0.0), "bytes count when they are taken");
        input.read_exact(&mut [0; 60]).unwrap();
        input.consume(40);
        assert_eq!(share.share(), Some(0.25));
        assert_eq!(in_words(0.25, Duration::from_secs(30)), " 25 %, 1:30 left, ");
        assert_eq!(in_words(0.01, Duration::from_secs(30)), "  1 %, ");
        assert_eq!(ShareRead::default().share(), None);
    }
}
