//! Points from a `.npy` file.
//!
//! The header is looked at before it is parsed: nested brackets cost the parser time without bound, and a product of
//! lengths may go beyond 64 bits.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read as _};
use std::path::Path;

use npyz::{DType, NpyFile, TypeChar};

use super::super::Failure;
use crate::face::Landmarks;

/// What comes before the numbers; real files have 128 bytes.
const MAX_START_BYTES: u64 = 1024;
/// The header of a plain array is a dictionary, in which the shape is a tuple.
const MAX_BRACKETS: usize = 2;
/// Lengths of fewer digits have a product of 64 bits.
const MAX_DIGITS: usize = 19;

/// The numbers of a file, one after the other.
pub(super) type Values = Box<dyn Iterator<Item = io::Result<f64>>>;

/// Opens a file of points; says how many frames it states.
pub(super) fn open_points(path: &Path) -> Result<(Values, u64), Failure> {
    let file = File::open(path).map_err(|error| Failure::unreadable(path, &error))?;
    let refuse = |reason: &str| {
        let shown = path.display();
        Failure::data(format!("{shown} {reason}; it must hold frames x 478 x 3 floating-point numbers in C order"))
    };
    let mut reader = BufReader::new(file);
    let mut start = Vec::new();
    reader.by_ref().take(MAX_START_BYTES).read_to_end(&mut start).map_err(|error| Failure::unreadable(path, &error))?;
    let other = || refuse("is not a .npy file of plain numbers");
    if !is_plain(&start) {
        return Err(other());
    }
    let npy = NpyFile::new(Cursor::new(start).chain(reader)).map_err(|_| other())?;
    let [frames, 478, 3] = *npy.shape() else { return Err(refuse(&format!("has shape {:?}", npy.shape()))) };
    if npy.order() != npyz::Order::C {
        return Err(refuse("is in Fortran order"));
    }
    let DType::Plain(kind) = npy.dtype() else { return Err(refuse("holds records")) };
    match (kind.type_char(), kind.size_field()) {
        (TypeChar::Float, 4) => {
            let values = npy.data::<f32>().map_err(|error| refuse(&error.to_string()))?;
            Ok((Box::new(values.map(|value| value.map(f64::from))), frames))
        }
        (TypeChar::Float, 8) => {
            let values = npy.data::<f64>().map_err(|error| refuse(&error.to_string()))?;
            Ok((Box::new(values), frames))
        }
        _ => Err(refuse("holds numbers of another kind")),
    }
}

/// Whether a file that begins so has the header of an array of numbers.
fn is_plain(start: &[u8]) -> bool {
    let header = match start.strip_prefix(b"\x93NUMPY") {
        Some([1, _, a, b, rest @ ..] | [2 | 3, _, a, b, 0, 0, rest @ ..]) => {
            rest.get(..usize::from(u16::from_le_bytes([*a, *b])))
        }
        _ => None,
    };
    let count = |header: &[u8], of: &[u8]| header.iter().filter(|byte| of.contains(byte)).count();
    header.is_some_and(|header| count(header, b"([{") <= MAX_BRACKETS && count(header, b"0123456789") <= MAX_DIGITS)
}

#[expect(clippy::cast_possible_truncation, reason = "landmarks are kept as f32")]
pub(super) fn next_points(values: &mut Values, number: u64) -> Result<Box<Landmarks>, Failure> {
    let hint = "the frames before it were used, write it again for the rest";
    let cut = || Failure::data(format!("the .npy file is cut short in frame {number}; {hint}"));
    let mut landmarks = Box::new(Landmarks::zero());
    for slot in landmarks.0.as_flattened_mut() {
        *slot = values.next().and_then(Result::ok).ok_or_else(cut)? as f32;
    }
    Ok(landmarks)
}
