//! The terminal of `facewire servo`: single keys, and one line that is written over.

use std::io::{self, Stdout, Write as _};
use std::path::Path;
use std::time::Duration;

use crossterm::event::{self, KeyCode, KeyEvent, KeyModifiers};
use crossterm::terminal::{Clear, ClearType, disable_raw_mode, enable_raw_mode};
use crossterm::{cursor, execute, style::Print};

use super::finder::Key;
use facewire::cli::{Failure, STANDARD_OUTPUT};

/// A terminal that gives single keys. It is restored when this is dropped.
pub struct Terminal(Stdout);

impl Terminal {
    /// Makes the terminal give single keys.
    pub fn enter() -> Result<Self, Failure> {
        let mut terminal = Self(io::stdout());
        enable_raw_mode().and_then(|()| execute!(terminal.0, cursor::Hide)).map_err(|error| lost(&error))?;
        Ok(terminal)
    }

    /// Writes a line.
    pub fn say(&mut self, line: &str) -> Result<(), Failure> {
        execute!(self.0, Print(line), Print("\r\n")).map_err(|error| lost(&error))
    }

    /// Writes over the last line.
    pub fn show(&mut self, line: &str) -> Result<(), Failure> {
        execute!(self.0, Print("\r"), Print(line), Clear(ClearType::UntilNewLine)).map_err(|error| lost(&error))
    }
}

/// Waits for a key with a meaning.
pub fn key(wait: Duration) -> Result<Option<Key>, Failure> {
    let is_there = event::poll(wait).or_else(interrupted).map_err(|error| lost(&error))?;
    if !is_there {
        return Ok(None);
    }
    let event = event::read().map_err(|error| lost(&error))?;
    Ok(event.as_key_press_event().and_then(meaning))
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // A terminal that has gone cannot be restored.
        let _ = execute!(self.0, Print("\r\n"), cursor::Show);
        let _ = disable_raw_mode();
        let _ = self.0.flush();
    }
}

/// A signal is no failure of the terminal.
fn interrupted(error: io::Error) -> io::Result<bool> {
    if error.kind() == io::ErrorKind::Interrupted { Ok(false) } else { Err(error) }
}

fn lost(error: &io::Error) -> Failure {
    Failure::unwritable(Path::new(STANDARD_OUTPUT), error)
}

fn meaning(key: KeyEvent) -> Option<Key> {
    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        KeyCode::Char('c' | 'd') if is_control => Key::End,
        KeyCode::Char('q') | KeyCode::Esc => Key::End,
        KeyCode::Left => Key::Move(-1),
        KeyCode::Right => Key::Move(1),
        KeyCode::Down => Key::large(-1),
        KeyCode::Up => Key::large(1),
        KeyCode::Char('0') => Key::At0,
        KeyCode::Char('1') => Key::At1,
        KeyCode::Char('n') => Key::Neutral,
        KeyCode::Char(' ') => Key::Pulses,
        _ => return None,
    })
}
