//! When a receiver is asked, and how long its answer is waited for.

use std::time::{Duration, Instant};

use crate::link::Inquiry;
use crate::retry::LoggedReasons;

/// Time between two questions.
const PERIOD: Duration = Duration::from_secs(1);
/// A receiver that has not answered by then does not answer.
const PATIENCE: Duration = Duration::from_millis(500);

/// The questions since a port was opened, and their answers.
#[derive(Debug)]
pub struct Dialogue {
    /// When the last question was asked, or the port was opened.
    asked_at: Instant,
    is_waiting: bool,
    /// The problems that have been logged.
    pub told: LoggedReasons,
}

/// What to do now.
#[derive(Debug, PartialEq, Eq)]
pub enum Turn {
    /// Nothing.
    Wait,
    /// Ask.
    Ask,
    /// Read the answer, which is there.
    Hear,
    /// Log that no answer came.
    GiveUp,
}

impl Default for Dialogue {
    fn default() -> Self {
        Self { asked_at: Instant::now(), is_waiting: false, told: LoggedReasons::default() }
    }
}

impl Dialogue {
    /// Whether an answer is on its way.
    pub fn is_waiting(&self) -> bool {
        self.is_waiting
    }

    /// Returns what to do while `there` bytes can be read.
    pub fn next(&mut self, there: usize, inquiry: &Inquiry, now: Instant) -> Turn {
        let elapsed = now.saturating_duration_since(self.asked_at);
        if !self.is_waiting && elapsed >= PERIOD {
            (self.asked_at, self.is_waiting) = (now, inquiry.answer_bytes > 0);
            return Turn::Ask;
        }
        let turn = match there >= inquiry.answer_bytes {
            _ if !self.is_waiting => Turn::Wait,
            true => Turn::Hear,
            false if elapsed >= PATIENCE => Turn::GiveUp,
            false => Turn::Wait,
        };
        self.is_waiting &= turn == Turn::Wait;
        turn
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inquiry(answer_bytes: usize) -> Inquiry {
        Inquiry { question: vec![1], answer_bytes, troubles: |_| Vec::new(), silence: "silent" }
    }

    /// What is done at these times after the opening, with this number of bytes to be read.
    fn turns(inquiry: &Inquiry, times: &[(u64, usize)]) -> Vec<Turn> {
        let mut dialogue = Dialogue::default();
        let opened = dialogue.asked_at;
        times.iter().map(|(ms, there)| dialogue.next(*there, inquiry, opened + Duration::from_millis(*ms))).collect()
    }

    #[test]
    fn a_receiver_is_asked_once_a_second_and_its_answer_is_read_when_it_is_whole() {
        let times = [(0, 0), (999, 2), (1000, 0), (1020, 1), (1040, 2), (1060, 0), (2000, 0)];
        assert_eq!(
            turns(&inquiry(2), &times),
            [Turn::Wait, Turn::Wait, Turn::Ask, Turn::Wait, Turn::Hear, Turn::Wait, Turn::Ask]
        );
    }

    #[test]
    fn an_answer_that_does_not_come_is_given_up_after_half_a_second_and_the_question_is_asked_again() {
        let times = [(1000, 0), (1499, 1), (1500, 1), (1600, 0), (2000, 0)];
        assert_eq!(turns(&inquiry(2), &times), [Turn::Ask, Turn::Wait, Turn::GiveUp, Turn::Wait, Turn::Ask]);
    }

    #[test]
    fn a_receiver_that_cannot_answer_is_not_waited_for() {
        assert_eq!(turns(&inquiry(0), &[(1000, 0), (1600, 0), (2000, 0)]), [Turn::Ask, Turn::Wait, Turn::Ask]);
    }
}
