//! Bars of text: the rows of the screen, and how a value becomes eighths of blocks.

use crossterm::style::{Color, Stylize as _};
use facewire_packet::{BLENDSHAPES, Packet};

use super::report::yaw_pitch_roll_deg;

/// Widest name and a space.
const NAME_WIDTH: usize = 16;
/// A space and three digits after a bar.
const NUMBER_WIDTH: usize = 4;
/// Between the slots of the left and of the right side.
const SLOT_GAP: usize = 1;
/// A full bar of the head.
const HEAD_FULL_DEG: f32 = 45.0;
/// What is not filled of a bar.
const TRACK: Color = Color::AnsiValue(236);
/// A coefficient that is filled.
const FILL: Color = Color::Cyan;
/// The same where the packet is not live.
const STALE_FILL: Color = Color::DarkGrey;

const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];

/// Rows of the first column; an empty name is an empty row.
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

/// The row of this name, `width` characters wide.
pub fn row(name: &str, packet: &Packet, width: usize) -> String {
    let slot = slot_width(width);
    let [left, right] = cells(name, packet).map(|cell| match cell {
        Some(cell) => cell.drawn(slot, packet),
        None => " ".repeat(slot),
    });
    format!("{name:NAME_WIDTH$}{left}{:SLOT_GAP$}{right}", "")
}

/// The heading of a column: where left and right are.
pub fn heading(width: usize) -> String {
    let slot = slot_width(width);
    let text = format!("{:NAME_WIDTH$}{:slot$}{:SLOT_GAP$}{:slot$}", "", "left", "", "right");
    text.dim().to_string()
}

/// Characters of one slot, bar and number.
fn slot_width(width: usize) -> usize {
    width.saturating_sub(NAME_WIDTH + SLOT_GAP) / 2
}

/// A value in its slot.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Part of the bar that is filled, 0..=1.
    fill: f32,
    /// Three characters.
    number: String,
}

/// The values of a row, left and right. A blendshape without sides stands in the first.
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

/// An angle: one that is positive to the first side, a negative one to the second.
fn sides(degrees: f32) -> [Option<Cell>; 2] {
    [degrees, -degrees].map(|degrees| {
        Some(Cell {
            fill: (degrees / HEAD_FULL_DEG).clamp(0.0, 1.0),
            number: if degrees >= 0.5 { format!("{degrees:2.0}°") } else { String::new() },
        })
    })
}

/// The coefficient of this name and side.
fn coefficient(name: &str, side: &str, packet: &Packet) -> Option<Cell> {
    let is_it = |known: &&str| known.strip_prefix(name) == Some(side);
    let index = BLENDSHAPES.iter().position(is_it)?;
    let fill = *packet.coefficients.get(index)?;
    let number = format!("{fill:.2}");
    let number = number.strip_prefix('0').map_or_else(|| "1.0".to_owned(), str::to_owned);
    Some(Cell { fill, number })
}

impl Cell {
    /// Bar and number in `slot` characters.
    fn drawn(&self, slot: usize, packet: &Packet) -> String {
        let live = packet.state == facewire_packet::State::Live;
        let colour = if live { FILL } else { STALE_FILL };
        let bar = bar(self.fill, slot.saturating_sub(NUMBER_WIDTH));
        let number = format!(" {:>3}", self.number);
        let number = if self.fill < 0.05 { number.dim() } else { number.stylize() };
        format!("{}{number}", bar.with(colour).on(TRACK))
    }
}

/// A bar of `width` characters, filled by eighths of them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "0..=1 times a width in characters"
)]
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
