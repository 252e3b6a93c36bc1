//! Bars of text: the rows of the screen, drawn in eighths of a character.

use crossterm::style::{Color, Stylize as _};
use facewire_packet::{BLENDSHAPES, Packet};

use super::report::yaw_pitch_roll_deg;

/// Width of the longest name and a space.
const NAME_WIDTH: usize = 16;
/// Width of the number after a bar: a space and three characters.
const NUMBER_WIDTH: usize = 4;
/// Space between the slots of the left and the right side.
const SLOT_GAP: usize = 1;
/// The angle of the head that fills a bar.
const HEAD_FULL_DEG: f32 = 45.0;
/// Colour of the empty part of a bar.
const TRACK: Color = Color::AnsiValue(236);
/// Colour of the filled part of a bar.
const FILL: Color = Color::Cyan;
/// Colour of the filled part while the face is not live.
const STALE_FILL: Color = Color::DarkGrey;

const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];

/// Rows of the first column. An empty name is an empty row.
pub const FIRST_COLUMN: [&str; 19] = [
    "head yaw",
    "head roll",
    "pitch up, down",
    "",
    "eyeBlink",
    "eyeSquint",
    "eyeWide",
    "eyeLookUp",
    "eyeLookDown",
    "eyeLookIn",
    "eyeLookOut",
    "",
    "browInnerUp",
    "browOuterUp",
    "browDown",
    "",
    "cheekSquint",
    "noseSneer",
    "cheekPuff",
];

/// Rows of the second column.
pub const SECOND_COLUMN: [&str; 19] = [
    "jawOpen",
    "jaw",
    "jawForward",
    "tongueOut",
    "mouthSmile",
    "mouthFrown",
    "mouth",
    "mouthUpperUp",
    "mouthLowerDown",
    "mouthStretch",
    "mouthDimple",
    "mouthPress",
    "mouthClose",
    "mouthFunnel",
    "mouthPucker",
    "mouthRollUpper",
    "mouthRollLower",
    "mouthShrugUpper",
    "mouthShrugLower",
];

/// Draws the row of this name, `width` characters wide.
pub fn row(name: &str, packet: &Packet, width: usize) -> String {
    let slot = slot_width(width);
    let [left, right] = cells(name, packet).map(|cell| match cell {
        Some(cell) => cell.drawn(slot, packet),
        None => " ".repeat(slot),
    });
    format!("{name:NAME_WIDTH$}{left}{:SLOT_GAP$}{right}", "")
}

/// Draws the heading of a column, which names the left and the right side.
pub fn heading(width: usize) -> String {
    let slot = slot_width(width);
    let text = format!("{:NAME_WIDTH$}{:slot$}{:SLOT_GAP$}{:slot$}", "", "left", "", "right");
    text.dim().to_string()
}

/// Returns the width of one slot, which holds a bar and its number.
fn slot_width(width: usize) -> usize {
    width.saturating_sub(NAME_WIDTH + SLOT_GAP) / 2
}

/// The content of one slot.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// The filled part of the bar, 0..=1.
    fill: f32,
    /// The number after the bar, three characters.
    number: String,
}

/// Returns the values of a row, left and right. A blendshape without sides uses the left slot.
pub fn cells(name: &str, packet: &Packet) -> [Option<Cell>; 2] {
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(packet.rotation);
    match name {
        "head yaw" => sides(yaw),
        "head roll" => sides(-roll),
        "pitch up, down" => sides(pitch),
        _ => match coefficient(name, "", packet) {
            Some(value) => [Some(value), None],
            None => ["Left", "Right"].map(|side| coefficient(name, side, packet)),
        },
    }
}

/// Shows a positive angle in the left slot, and a negative angle in the right one.
fn sides(degrees: f32) -> [Option<Cell>; 2] {
    [degrees, -degrees].map(|degrees| {
        Some(Cell {
            fill: (degrees / HEAD_FULL_DEG).clamp(0.0, 1.0),
            number: if degrees >= 0.5 { format!("{degrees:2.0}°") } else { String::new() },
        })
    })
}

/// Returns the coefficient of this name and side.
fn coefficient(name: &str, side: &str, packet: &Packet) -> Option<Cell> {
    let is_it = |known: &&str| known.strip_prefix(name) == Some(side);
    let index = BLENDSHAPES.iter().position(is_it)?;
    let fill = *packet.coefficients.get(index)?;
    let number = format!("{fill:.2}");
    let number = number.strip_prefix('0').map_or_else(|| "1.0".to_owned(), str::to_owned);
    Some(Cell { fill, number })
}

impl Cell {
    /// Draws the bar and its number in `slot` characters.
    fn drawn(&self, slot: usize, packet: &Packet) -> String {
        let live = packet.state == facewire_packet::State::Live;
        let colour = if live { FILL } else { STALE_FILL };
        let bar = bar(self.fill, slot.saturating_sub(NUMBER_WIDTH));
        let number = format!(" {:>3}", self.number);
        let number = if self.fill < 0.05 { number.dim() } else { number.stylize() };
        format!("{}{number}", bar.with(colour).on(TRACK))
    }
}

/// Draws a bar of `width` characters, filled in steps of an eighth of a character.
pub fn bar(fill: f32, width: usize) -> String {
    let eighths = (fill.clamp(0.0, 1.0) * (width * 8) as f32).round() as usize;
    let part = EIGHTHS.get(eighths % 8).copied().unwrap_or_default();
    let blocks = "█".repeat(eighths / 8) + part;
    format!("{blocks:width$}")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn every_coefficient_stands_in_exactly_one_row() {
        let mut shown = Vec::new();
        for name in FIRST_COLUMN.iter().chain(&SECOND_COLUMN) {
            for known in BLENDSHAPES {
                if ["", "Left", "Right"].contains(&known.strip_prefix(name).unwrap_or("-")) {
                    shown.push(known);
                }
            }
        }
        shown.sort_unstable();
        let mut all = BLENDSHAPES;
        all.sort_unstable();
        assert_eq!(shown, all);
    }

    #[test]
    fn bars_fill_by_eighths_and_keep_their_width() {
        assert_eq!(bar(0.0, 4), "    ");
        assert_eq!(bar(1.0, 4), "████");
        assert_eq!(bar(0.5 + 3.0 / 32.0, 4), "██▍ ");
        assert_eq!(bar(f32::NAN, 4).chars().count(), 4);
    }

    #[test]
    fn sides_are_the_persons_own() {
        let mut packet = Packet::NEUTRAL;
        packet.coefficients[0] = 1.0;
        let [left, right] = cells("eyeBlink", &packet).map(Option::unwrap);
        assert_eq!((left.number.as_str(), right.number.as_str()), ("1.0", ".00"));
        packet.rotation = [0.0, 0.25_f32.sin(), 0.0, 0.25_f32.cos()];
        let [left, right] = cells("head yaw", &packet).map(Option::unwrap);
        assert_eq!((left.number.as_str(), right.number.as_str()), ("29°", ""));
    }
}
