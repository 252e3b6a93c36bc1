//! The file form of a network, written by `models/networks/to_native.py` and `models/eyes/train.py`.
//!
//! All numbers are little-endian. `port` is a tensor (u16), the length of its name (u8) and the name (ASCII).
//!
//! | field | type |
//! |---|---|
//! | `fwnet` and three zero bytes | 8 bytes |
//! | version, 2 | u32 |
//! | CRC-32 of all bytes that follow (IEEE 802.3, as zlib and PNG) | u32 |
//! | number of tensors, of operators, of outputs | 3 x u16 |
//! | for each tensor: rows, columns, channels | 3 x u16 |
//! | the input | port |
//! | for each output | port |
//! | for each operator: kind, window size, stride, rows above, columns left, number of inputs | 6 x u8 |
//! | ... its inputs and its output | u16 each |
//! | ... its arrays: a format (1: float16, 2: float32), then as many values as the shapes imply | u8, values |
//!
//! Kinds: 0 convolution (weights, bias), 1 depthwise convolution (weights, bias), 2 PReLU (slopes), 3 ReLU, 4 sum,
//! 5 maximum, 6 channel padding, 7 concatenation. Nothing follows the last operator.
//!
//! The reader takes no more memory than a small multiple of the file's size: all counts are checked against what is
//! left of the file before memory is taken.

#![deny(clippy::indexing_slicing)]

use std::fs::File;
use std::io::{self, Read as _};
use std::ops::Deref;
use std::path::Path;

use crate::error::Error;
use crate::graph::{Graph, Kind, Operator, Port, Shape, Window};
use crate::values::Values;

const MAGIC: &[u8; 8] = b"fwnet\0\0\0";
const CUT_SHORT: Error = Error::Damaged("it ends too early");
const VERSION: u32 = 2;

/// Reads a file into a memory map of its own, which goes back to the system as a whole, unlike memory of the heap (`arena.rs`).
///
/// # Errors
/// Fails if the file cannot be read, or if there is not enough memory.
pub fn load(path: &Path) -> io::Result<impl Deref<Target = [u8]> + use<>> {
    let mut file = File::open(path)?;
    let length = usize::try_from(file.metadata()?.len()).map_err(io::Error::other)?;
    let mut content = memmap2::MmapMut::map_anon(length)?;
    file.read_exact(&mut content)?;
    Ok(content)
}

/// Reads a network, whose numbers stay where they are in `content`.
///
/// # Errors
/// [`Error::Damaged`] if the content is not an intact network, or [`Error::Unsupported`] if it has another version.
pub fn read(content: &[u8]) -> Result<Graph<'_>, Error> {
    let mut rest = Reader(content);
    if rest.bytes(MAGIC.len())? != MAGIC {
        return Err(Error::Damaged("it does not begin with the signature of a network file"));
    }
    if u32::from_le_bytes(rest.array()?) != VERSION {
        return Err(Error::Unsupported("the file was written by another version of the converter"));
    }
    if u32::from_le_bytes(rest.array()?) != checksum(rest.0) {
        return Err(Error::Damaged("its checksum does not match: it was cut short or changed"));
    }
    let [tensors, operators, outputs] = [rest.number()?, rest.number()?, rest.number()?];
    let tensors = (0..tensors).map(|_| rest.shape()).collect::<Result<Vec<_>, _>>()?;
    let input = rest.port()?;
    let outputs = (0..outputs).map(|_| rest.port()).collect::<Result<Vec<_>, _>>()?;
    let operators = (0..operators).map(|_| rest.operator(&tensors)).collect::<Result<Vec<_>, _>>()?;
    if !rest.0.is_empty() {
        return Err(Error::Damaged("bytes follow the last operator"));
    }
    Graph::new(tensors, operators, input, outputs)
}

/// The CRC-32 of a network file, over all bytes after the checksum itself.
#[must_use]
pub fn checksum(content: &[u8]) -> u32 {
    /// The reversed form of the polynomial 0x04c11db7.
    const POLYNOMIAL: u32 = 0xedb8_8320;
    let mut table = [0_u32; 256];
    for (entry, index) in table.iter_mut().zip(0_u32..) {
        *entry = (0..8).fold(index, |rest, _| if rest & 1 == 1 { rest >> 1 ^ POLYNOMIAL } else { rest >> 1 });
    }
    let step = |crc: u32, byte: &u8| {
        let [low, ..] = crc.to_le_bytes();
        table.get(usize::from(low ^ byte)).map_or(crc, |entry| crc >> 8 ^ entry)
    };
    !content.iter().fold(!0, step)
}

/// What is left of the file.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], Error> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(CUT_SHORT)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let (taken, rest) = self.0.split_first_chunk().ok_or(CUT_SHORT)?;
        self.0 = rest;
        Ok(*taken)
    }

    /// A u16.
    fn number(&mut self) -> Result<usize, Error> {
        Ok(usize::from(u16::from_le_bytes(self.array()?)))
    }

    fn shape(&mut self) -> Result<Shape, Error> {
        Ok(Shape { rows: self.number()?, columns: self.number()?, channels: self.number()? })
    }

    fn port(&mut self) -> Result<Port, Error> {
        let tensor = self.number()?;
        let [length] = self.array()?;
        let name = self.bytes(usize::from(length))?;
        let name = str::from_utf8(name).map_err(|_| Error::Damaged("the name of an input or output is not text"))?;
        Ok(Port { name: name.to_owned(), tensor })
    }

    fn operator(&mut self, tensors: &[Shape]) -> Result<Operator<'a>, Error> {
        let [kind, size, stride, top, left, inputs] = self.array()?;
        let [size, stride, top, left] = [size, stride, top, left].map(usize::from);
        let inputs = (0..inputs).map(|_| self.number()).collect::<Result<Vec<_>, _>>()?;
        let output = self.number()?;
        let channels = |tensor: Option<&usize>| {
            let shape = tensor.and_then(|&tensor| tensors.get(tensor));
            shape.map(|shape| shape.channels).ok_or(Error::Damaged("an operator names a tensor that does not exist"))
        };
        let (from, to) = (channels(inputs.first())?, channels(Some(&output))?);
        let window = Window { size, stride, top, left };
        let kind = match kind {
            0 => {
                Kind::Convolution { window, weights: self.values(&[size, size, from, to])?, bias: self.values(&[to])? }
            }
            1 => Kind::Depthwise { window, weights: self.values(&[size, size, to])?, bias: self.values(&[to])? },
            2 => Kind::Prelu { slopes: self.values(&[to])? },
            3 => Kind::Relu,
            4 => Kind::Add,
            5 => Kind::MaxPool { window },
            6 => Kind::PadChannels,
            7 => Kind::Concatenation,
            _ => return Err(Error::Damaged("the kind of an operator is unknown")),
        };
        Ok(Operator { kind, inputs, output })
    }

    /// An array of finite numbers. Their count is the product of `sides`.
    fn values(&mut self, sides: &[usize]) -> Result<Values<'a>, Error> {
        // Where `usize` has 32 bits, the product of the sides in a hostile file can overflow.
        let bytes_of = |value: usize| sides.iter().try_fold(value, |count, side| count.checked_mul(*side));
        let values = match self.array()? {
            [1] => Values::half(self.bytes(bytes_of(2).ok_or(CUT_SHORT)?)?),
            [2] => Values::single(self.bytes(bytes_of(4).ok_or(CUT_SHORT)?)?),
            _ => return Err(Error::Damaged("the format of an array is unknown")),
        };
        if values.iter().all(f32::is_finite) {
            Ok(values)
        } else {
            Err(Error::Damaged("a weight is not a finite number"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zlib() {
        // The check value of CRC-32/ISO-HDLC in the catalogue of parametrised CRC algorithms.
        assert_eq!(checksum(b"123456789"), 0xcbf4_3926);
        assert_eq!(checksum(b""), 0);
    }
}
