//! What settings take, for the sentences that refuse other values and for the schema.

use std::fmt;

use super::quoted;

/// What a setting takes. Numbers are given with their bounds.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Takes {
    Flag,
    Whole {
        least: i64,
        most: i64,
        unit: &'static str,
    },
    Number {
        least: f32,
        most: f32,
        unit: &'static str,
    },
    OneOf(Vec<&'static str>),
    OneOfNumbers([u32; 4]),
    /// A text that this describes.
    Text(String),
    /// A table with these keys.
    Table(Vec<(&'static str, Takes)>),
    /// The tables of a link's servos, or the only one.
    Channels,
    Links,
}

/// What follows "give".
impl fmt::Display for Takes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag => f.write_str("true or false"),
            Self::Whole { least, most, unit } => write!(f, "a whole number from {least} to {most}{}", InBrackets(unit)),
            Self::Number { least, most, unit } => write!(f, "a number from {least:?} to {most:?}{}", InBrackets(unit)),
            Self::OneOf(names) => {
                write!(f, "one of {}", names.iter().map(|name| quoted(name)).collect::<Vec<_>>().join(", "))
            }
            Self::OneOfNumbers([first, second, third, fourth]) => {
                write!(f, "one of {first}, {second}, {third}, {fourth}")
            }
            Self::Text(text) => f.write_str(text),
            Self::Table(_) | Self::Channels => f.write_str("a table"),
            Self::Links => f.write_str("each link under its own [[link]]"),
        }
    }
}

/// A unit after its number.
struct InBrackets<'a>(&'a str);

impl fmt::Display for InBrackets<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() { Ok(()) } else { write!(f, " ({})", self.0) }
    }
}
