//! Shows a calibration: three lines that are drawn anew on a terminal, and a line for each change otherwise.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::Path;

use rustix::termios::tcgetwinsize;

use super::super::failure::{Failure, STANDARD_OUTPUT};
use crate::calibration::{Phase, Progress, Take};

const BAR: usize = 24;
const LINES: u16 = 3;

/// Shows progress on standard output.
pub struct Display {
    is_terminal: bool,
    last: Option<Progress>,
}

impl Display {
    pub fn new() -> Self {
        Self { is_terminal: io::stdout().is_terminal(), last: None }
    }

    pub fn show(&mut self, progress: &Progress) -> Result<(), Failure> {
        let shown = if self.is_terminal { self.draw(progress) } else { self.tell(progress) };
        self.last = Some(progress.clone());
        shown.map_err(|error| Failure::unwritable(Path::new(STANDARD_OUTPUT), &error))
    }

    /// Draws over the lines of the last time.
    fn draw(&self, progress: &Progress) -> io::Result<()> {
        let mut out = io::stdout().lock();
        if self.last.is_some() {
            write!(out, "\x1b[{LINES}F")?; // to the beginning of the line so many lines above
        } else {
            writeln!(out, "Sit as usual, face the camera, and keep your head still.")?;
        }
        // A line that does not fit would be wrapped, and the next picture would be drawn a line too low.
        let width = tcgetwinsize(&out).map_or(80, |size| usize::from(size.ws_col).max(20) - 1);
        for line in lines(progress) {
            let line: String = line.chars().take(width).collect();
            writeln!(out, "\x1b[2K{line}")?; // clears the line first
        }
        out.flush()
    }

    /// Writes a line if something has changed other than the measures.
    fn tell(&self, progress: &Progress) -> io::Result<()> {
        if self.last.as_ref().is_some_and(|last| last.says_the_same(progress)) {
            return Ok(());
        }
        let [task, _, state] = lines(progress);
        let mut out = io::stdout();
        writeln!(out, "{task}: {}", state.trim_start())?;
        out.flush()
    }
}

/// The three lines: what to do, how far it is measured and seen, and what the guide waits for.
fn lines(progress: &Progress) -> [String; LINES as usize] {
    let Progress { take, done, of, phase, measured, seen, .. } = progress;
    let task = format!("[{:2}/{of}] {}", (done + 1).min(*of), take.instruction());
    let bars = match take {
        Take::Neutral => format!("        measured {}", bar(*measured)),
        _ => format!("        measured {}  seen {}", bar(*measured), bar(*seen)),
    };
    let last = progress.last_refusal.filter(|_| progress.refused > 0);
    let refused = last.map_or_else(String::new, |why| format!("   (refused {}: {why})", progress.refused));
    let state = match (phase, progress.waits_for) {
        (Phase::Measure, _) => "hold it".to_owned(),
        (Phase::Ended, _) => "done".to_owned(),
        (Phase::GetReady, None) => "get ready".to_owned(),
        (_, Some(why)) => format!("waiting. {why}"),
        (Phase::Wait, None) => "waiting".to_owned(),
    };
    [task, bars, format!("        {state}{refused}")]
}

/// A bar for a share from 0 to 1.
fn bar(share: f32) -> String {
    let full = (share.clamp(0.0, 1.0) * BAR as f32).round() as usize;
    "█".repeat(full) + &"░".repeat(BAR - full)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Refusal;

    const PROGRESS: Progress = Progress {
        take: Take::JawOpen,
        done: 2,
        of: 11,
        phase: Phase::Wait,
        measured: 0.0,
        seen: 0.5,
        waits_for: Some(Refusal::NotSeen),
        refused: 1,
        last_refusal: Some(Refusal::HeadMoves),
    };

    #[test]
    fn lines_say_what_to_do_what_is_seen_and_what_is_missing() {
        let [task, bars, state] = lines(&PROGRESS);
        assert_eq!(task, "[ 3/11] Open your mouth wide");
        assert!(bars.ends_with("seen ████████████░░░░░░░░░░░░"), "{bars}");
        assert!(state.contains("waiting. No such movement is seen") && state.contains("refused 1: The head moves"));
    }

    #[test]
    fn share_beyond_its_range_fills_the_bar_and_no_more() {
        assert_eq!([f32::NAN, -1.0, 9.0].map(|share| bar(share).chars().filter(|c| *c == '█').count()), [0, 0, BAR]);
    }
}
