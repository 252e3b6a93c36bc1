//! The terminal screen with a bar for each coefficient, drawn in eighths of a character.

use std::io::{self, Write as _};
use std::time::Instant;

use crossterm::style::{Color, Print, Stylize as _};
use crossterm::terminal::{
    BeginSynchronizedUpdate, Clear, ClearType, DisableLineWrap, EnableLineWrap, EndSynchronizedUpdate,
    EnterAlternateScreen, LeaveAlternateScreen,
};
use crossterm::{cursor, execute, queue};
use facewire_packet::{BLENDSHAPES, Packet, State, yaw_pitch_roll_deg};

use super::{Tally, state};
use crate::Restore;

/// Space at the left edge, between the two columns, and between the slots of the left and the right side of a row.
const GAP: usize = 1;
/// Longer bars are no easier to read.
const WIDEST_COLUMN: usize = 72;
/// Width of the longest name and a space.
const NAME_WIDTH: usize = 16;
/// Width of the number after a bar: a space and three characters.
const NUMBER_WIDTH: usize = 4;
/// The angle of the head that fills a bar.
const HEAD_FULL_DEG: f32 = 45.0;
/// Colour of the empty part of a bar.
const TRACK: Color = Color::AnsiValue(236);

const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];

/// The rows of both columns. An empty name is an empty row.
const ROWS: [[&str; 2]; 19] = [
    ["head yaw", "jawOpen"],
    ["head roll", "jaw"],
    ["pitch up, down", "jawForward"],
    ["", "tongueOut"],
    ["eyeBlink", "mouthSmile"],
    ["eyeSquint", "mouthFrown"],
    ["eyeWide", "mouth"],
    ["eyeLookUp", "mouthUpperUp"],
    ["eyeLookDown", "mouthLowerDown"],
    ["eyeLookIn", "mouthStretch"],
    ["eyeLookOut", "mouthDimple"],
    ["", "mouthPress"],
    ["browInnerUp", "mouthClose"],
    ["browOuterUp", "mouthFunnel"],
    ["browDown", "mouthPucker"],
    ["", "mouthRollUpper"],
    ["cheekSquint", "mouthRollLower"],
    ["noseSneer", "mouthShrugUpper"],
    ["cheekPuff", "mouthShrugLower"],
];

/// Takes the whole terminal until the returned guard is dropped.
pub fn enter() -> io::Result<Restore> {
    let restore = Restore(|| execute!(io::stdout(), EnableLineWrap, cursor::Show, LeaveAlternateScreen));
    execute!(io::stdout(), EnterAlternateScreen, cursor::Hide, DisableLineWrap, Clear(ClearType::All))?;
    Ok(restore)
}

pub fn draw(listen: &str, tally: &Tally, now: Instant) -> io::Result<()> {
    let mut out = io::stdout();
    let (width, height) = crossterm::terminal::size()?;
    queue!(out, BeginSynchronizedUpdate)?;
    for (y, line) in (0..height).zip(picture(listen, tally, now, width.into())) {
        // The line is cleared first: after a full line, clearing would erase its last character.
        queue!(out, cursor::MoveTo(0, y), Clear(ClearType::UntilNewLine), Print(" ".repeat(GAP)), Print(line))?;
    }
    queue!(out, EndSynchronizedUpdate)?;
    out.flush()
}

/// Returns all lines from the top, with colours.
fn picture(listen: &str, tally: &Tally, now: Instant, width: usize) -> Vec<String> {
    let column = (width.saturating_sub(2 * GAP) / 2).min(WIDEST_COLUMN);
    let slot = column.saturating_sub(NAME_WIDTH + GAP) / 2;
    let gap = " ".repeat(GAP);
    let packet = tally.packets.newest.as_ref().map_or(Packet::NEUTRAL, |newest| newest.packet);
    let heading = format!("{:NAME_WIDTH$}{:slot$}{gap}{:slot$}", "", "left", "right").dim().to_string();
    let [status, counts, footer] = texts(listen, tally, now);
    let mut lines = vec![status, counts, format!("{heading}{gap}{heading}")];
    lines.extend(ROWS.map(|names| names.map(|name| row(name, &packet, slot)).join(&gap)));
    lines.extend([String::new(), footer.dim().to_string()]);
    lines
}

/// Describes the state of the sender, rates and counts, and the sender and the key that ends the monitor.
fn texts(listen: &str, tally: &Tally, now: Instant) -> [String; 3] {
    let Some(newest) = &tally.packets.newest else {
        let status = "○ waiting for packets".bold().to_string();
        return [status, String::new(), format!("at {listen}   Ctrl-C ends")];
    };
    let packet = &newest.packet;
    let (status, colour) = match (tally.packets.silence(now), packet.state) {
        (Some(silence), _) => {
            (format!("○ silent for {:.1} s: the face is neutral by now", silence.as_secs_f64()), Color::Red)
        }
        (None, State::Live) => (format!("● {}", state(packet)), Color::Green),
        (None, State::Hold | State::Decay) => (format!("● {}", state(packet)), Color::Yellow),
        (None, State::Neutral) => (format!("● {}", state(packet)), Color::Blue),
    };
    let [x, y, z] = packet.position_mm;
    let counts = format!(
        "{:5.1} packets/s   lost {}   refused {}   age {:.1} ms   head at {x:.0} {y:.0} {z:.0} mm",
        tally.packets.rate_hz(now),
        tally.packets.lost,
        tally.packets.refused,
        f64::from(packet.age_us) / 1000.0
    );
    let footer = format!("packet {} from {}   person's left, right   Ctrl-C ends", packet.sequence, newest.from);
    [status.with(colour).bold().to_string(), counts, footer]
}

/// The filled part of a bar, 0..=1, and the number after it, three characters.
type Cell = (f32, String);

/// Draws the row of this name, with two slots of this width.
fn row(name: &str, packet: &Packet, slot: usize) -> String {
    let colour = if packet.state == State::Live { Color::Cyan } else { Color::DarkGrey };
    let drawn = |cell: Option<Cell>| {
        let Some((fill, number)) = cell else { return " ".repeat(slot) };
        let bar = bar(fill, slot.saturating_sub(NUMBER_WIDTH)).with(colour).on(TRACK);
        let number = format!(" {number:>3}");
        format!("{bar}{}", if fill < 0.05 { number.dim() } else { number.stylize() })
    };
    format!("{name:NAME_WIDTH$}{}", cells(name, packet).map(drawn).join(&" ".repeat(GAP)))
}

/// Returns the values of a row, left and right. A blendshape without sides uses the left slot.
fn cells(name: &str, packet: &Packet) -> [Option<Cell>; 2] {
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(packet.rotation);
    match name {
        "head yaw" => angle(yaw),
        "head roll" => angle(-roll),
        "pitch up, down" => angle(pitch),
        _ => match coefficient(name, "", packet) {
            Some(value) => [Some(value), None],
            None => ["Left", "Right"].map(|side| coefficient(name, side, packet)),
        },
    }
}

/// Shows a positive angle in the left slot, and a negative angle in the right one.
fn angle(degrees: f32) -> [Option<Cell>; 2] {
    [degrees, -degrees].map(|degrees| {
        let number = if degrees >= 0.5 { format!("{degrees:2.0}°") } else { String::new() };
        Some(((degrees / HEAD_FULL_DEG).clamp(0.0, 1.0), number))
    })
}

fn coefficient(name: &str, side: &str, packet: &Packet) -> Option<Cell> {
    let index = BLENDSHAPES.iter().position(|known| known.strip_prefix(name) == Some(side))?;
    let fill = *packet.coefficients.get(index)?;
    let number = format!("{fill:.2}");
    Some((fill, number.strip_prefix('0').map_or_else(|| "1.0".to_owned(), str::to_owned)))
}

/// Draws a bar of `width` characters, filled in steps of an eighth of a character.
fn bar(fill: f32, width: usize) -> String {
    let eighths = (fill.clamp(0.0, 1.0) * (width * 8) as f32).round() as usize;
    let part = EIGHTHS.get(eighths % 8).copied().unwrap_or_default();
    format!("{:width$}", "█".repeat(eighths / 8) + part)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn every_coefficient_stands_in_exactly_one_row_on_the_persons_own_side() {
        let sides = |name: &&str| ["", "Left", "Right"].map(|side| format!("{name}{side}"));
        let named = ROWS.as_flattened().iter().flat_map(sides).filter(|name| BLENDSHAPES.contains(&name.as_str()));
        let mut shown: Vec<String> = named.collect();
        shown.sort_unstable();
        let mut all = BLENDSHAPES;
        all.sort_unstable();
        assert_eq!(shown, all);

        let mut packet = Packet::NEUTRAL;
        packet.coefficients[0] = 1.0;
        packet.rotation = [0.0, 0.25_f32.sin(), 0.0, 0.25_f32.cos()];
        let numbers = |name| cells(name, &packet).map(|cell| cell.unwrap().1);
        assert_eq!(numbers("eyeBlink"), ["1.0", ".00"]);
        assert_eq!(numbers("head yaw"), ["29°", ""]);
    }

    #[test]
    fn bars_fill_by_eighths_and_keep_their_width() {
        assert_eq!([0.0, 1.0, 0.5 + 3.0 / 32.0].map(|fill| bar(fill, 4)), ["    ", "████", "██▍ "]);
        assert_eq!(bar(f32::NAN, 4).chars().count(), 4);
    }

    /// Returns the line without its colours.
    fn visible(line: &str) -> String {
        let mut parts = line.split('\u{1b}');
        let first = parts.next().unwrap().to_owned();
        parts.fold(first, |text, part| text + part.split_once('m').map_or("", |(_, rest)| rest))
    }

    #[test]
    fn the_picture_fits_80_by_24_characters_fills_wider_terminals_and_shows_state_and_silence() {
        let mut tally = Tally::default();
        let now = Instant::now();
        let status = |tally: &Tally, now| visible(&picture("", tally, now, 80)[0]);
        assert_eq!(status(&tally, now), "○ waiting for packets");
        let full = Packet { state: State::Live, sequence: 65535, coefficients: [1.0; 52], ..Packet::NEUTRAL };
        tally.count(&full, "255.255.255.255:65535".to_owned(), now);
        for width in [0, 1, 20, 80, 120, 200] {
            let lines = picture("0.0.0.0:5252", &tally, now, width);
            assert_eq!(lines.len(), 24);
            let widest = lines.iter().map(|line| GAP + visible(line).chars().count()).max().unwrap();
            assert!(width < 80 || (widest <= width && widest > width * 2 / 3), "{widest} of {width}");
        }
        let lost = Packet { state: State::Hold, reason: facewire_packet::Reason::NoFace, ..full };
        tally.count(&lost, String::new(), now);
        assert_eq!(status(&tally, now), "● hold: no face");
        assert!(status(&tally, now + Duration::from_secs(2)).starts_with("○ silent for 2.0 s"));
    }
}
