//! The terminal screen with the bars.

use std::{
    io::{self, Stdout, Write as _},
    time::Instant,
};

use crossterm::{
    cursor, execute, queue,
    style::{Color, Print, Stylize as _},
    terminal::{
        BeginSynchronizedUpdate, Clear, ClearType, DisableLineWrap, EnableLineWrap, EndSynchronizedUpdate,
        EnterAlternateScreen, LeaveAlternateScreen,
    },
};
use facewire_packet::{Packet, State};

use super::{bars, receiver::Endpoint, report, tally::Tally};

/// Space between the two columns.
const COLUMN_GAP: usize = 1;
/// Space at the left edge.
const MARGIN: usize = 1;
/// Widest column: longer bars are no easier to read.
const WIDEST_COLUMN: usize = 72;

/// The terminal in full-screen mode. It is restored when this is dropped.
pub struct Screen {
    out: Stdout,
}

impl Screen {
    /// Switches the terminal to full-screen mode.
    pub fn enter() -> io::Result<Self> {
        let mut out = io::stdout();
        execute!(out, EnterAlternateScreen, cursor::Hide, DisableLineWrap, Clear(ClearType::All))?;
        Ok(Self { out })
    }

    /// Draws the current state.
    pub fn draw(&mut self, listen: &Endpoint, tally: &Tally, now: Instant) -> io::Result<()> {
        let (width, height) = crossterm::terminal::size()?;
        let lines = picture(listen, tally, now, width.into());
        queue!(self.out, BeginSynchronizedUpdate)?;
        for (y, line) in (0..height).zip(lines) {
            let margin = " ".repeat(MARGIN);
            // The line is cleared first: after a full line, clearing would erase its last character.
            queue!(self.out, cursor::MoveTo(0, y), Clear(ClearType::UntilNewLine))?;
            queue!(self.out, Print(margin), Print(line))?;
        }
        queue!(self.out, EndSynchronizedUpdate)?;
        self.out.flush()
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // A terminal that has gone cannot be restored.
        let _ = execute!(self.out, EnableLineWrap, cursor::Show, LeaveAlternateScreen);
    }
}

/// Returns all lines from the top, with colours.
fn picture(listen: &Endpoint, tally: &Tally, now: Instant, width: usize) -> Vec<String> {
    let column = (width.saturating_sub(MARGIN + COLUMN_GAP) / 2).min(WIDEST_COLUMN);
    let gap = " ".repeat(COLUMN_GAP);
    let packet = tally.packets.newest.as_ref().map_or(Packet::NEUTRAL, |newest| newest.packet);
    let heading = bars::heading(column);
    let mut lines = vec![status(tally, now), counts(tally, now), format!("{heading}{gap}{heading}")];
    for (first, second) in bars::FIRST_COLUMN.iter().zip(bars::SECOND_COLUMN) {
        let [first, second] = [first, second].map(|name| bars::row(name, &packet, column));
        lines.push(format!("{first}{gap}{second}"));
    }
    lines.push(String::new());
    lines.push(footer(listen, tally).dim().to_string());
    lines
}

/// Describes the state of the sender.
fn status(tally: &Tally, now: Instant) -> String {
    let Some(newest) = tally.packets.newest.as_ref() else {
        return "○ waiting for packets".bold().to_string();
    };
    if let Some(silence) = tally.packets.silence(now) {
        let text = format!("○ silent for {:.1} s: the face is neutral by now", silence.as_secs_f64());
        return text.with(Color::Red).bold().to_string();
    }
    let colour = match newest.packet.state {
        State::Live => Color::Green,
        State::Hold | State::Decay => Color::Yellow,
        State::Neutral => Color::Blue,
    };
    format!("● {}", report::state(&newest.packet)).with(colour).bold().to_string()
}

/// Describes rates and counts.
fn counts(tally: &Tally, now: Instant) -> String {
    let Some(newest) = tally.packets.newest.as_ref() else {
        return String::new();
    };
    let [x, y, z] = newest.packet.position_mm;
    format!(
        "{:5.1} packets/s   lost {}   refused {}   age {:.1} ms   head at {x:.0} {y:.0} {z:.0} mm",
        tally.packets.rate_hz(now),
        tally.packets.lost,
        tally.packets.refused,
        f64::from(newest.packet.age_us) / 1000.0
    )
}

/// Names the sender, and the key that ends the monitor.
fn footer(listen: &Endpoint, tally: &Tally) -> String {
    match tally.packets.newest.as_ref() {
        Some(newest) => {
            format!("packet {} from {}   person's left, right   Ctrl-C ends", newest.packet.sequence, newest.from)
        }
        None => format!("at {listen}   Ctrl-C ends"),
    }
}

#[cfg(test)]
mod tests {
    use std::{
        net::{IpAddr, Ipv4Addr, SocketAddr},
        time::Duration,
    };

    use super::*;

    const LISTEN: Endpoint = Endpoint::Udp(SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), 5252));

    fn full_packet() -> Packet {
        Packet { state: State::Live, sequence: 65535, coefficients: [1.0; 52], ..Packet::NEUTRAL }
    }

    /// Returns the line without its colours.
    fn visible(line: &str) -> String {
        let mut parts = line.split('\u{1b}');
        let first = parts.next().unwrap_or_default().to_owned();
        parts.fold(first, |text, part| text + part.split_once('m').map_or("", |(_, rest)| rest))
    }

    #[test]
    fn the_picture_fits_80_by_24_characters_and_fills_wider_terminals() {
        let mut tally = Tally::default();
        let now = Instant::now();
        tally.count(&full_packet(), Endpoint::Udp(SocketAddr::from(([255; 4], 65535))), now);
        for width in [80, 120, 200] {
            let lines = picture(&LISTEN, &tally, now, width);
            assert!(lines.len() <= 24, "{} lines", lines.len());
            let widest = lines.iter().map(|line| MARGIN + visible(line).chars().count()).max();
            assert!(widest <= Some(width) && widest > Some(width * 2 / 3), "{widest:?} of {width}");
        }
    }

    #[test]
    fn a_tiny_terminal_does_no_harm() {
        let tally = Tally::default();
        for width in [0, 1, 20] {
            assert_eq!(picture(&LISTEN, &tally, Instant::now(), width).len(), 24);
        }
    }

    #[test]
    fn the_status_shows_waiting_state_with_reason_and_silence() {
        let mut tally = Tally::default();
        let now = Instant::now();
        assert_eq!(visible(&status(&tally, now)), "○ waiting for packets");
        let lost = Packet { state: State::Hold, reason: facewire_packet::Reason::NoFace, ..full_packet() };
        tally.count(&lost, LISTEN, now);
        assert_eq!(visible(&status(&tally, now)), "● hold: no face");
        let later = status(&tally, now + Duration::from_secs(2));
        assert_eq!(visible(&later), "○ silent for 2.0 s: the face is neutral by now");
    }
}
