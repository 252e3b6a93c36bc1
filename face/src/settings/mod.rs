//! Settings in TOML: tables that name their keys, a file that is laid over them, and its faults; and the tables that shape the
//! output. Texts come from the caller.

mod overlay;
mod shaping;
mod takes;
mod value;

pub use overlay::{Entry, Faults, Field, Fields, Objection, Overlay, Read, Reader, Section, field};
pub use shaping::{ShapingSettings, SmoothingSettings, shaping};
pub use takes::Takes;
pub use value::{Table, TableOf, Value, flag, keys, number, one_of, quoted, whole};

pub use crate::section;
