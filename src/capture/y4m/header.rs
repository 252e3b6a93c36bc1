//! Parses the first line of a y4m stream.

use super::super::{CaptureError, FrameRate, MAX_SIDE_PX, Pixels};

/// The format of the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    pub width: usize,
    pub height: usize,
    pub rate: Option<FrameRate>,
    /// Powers of two by which chroma is narrower and lower than luma; `None` without chroma.
    pub chroma_shift: Option<[u8; 2]>,
    pub full_range: bool,
}

impl Header {
    /// Parses the fields behind the magic word. Ignores aspect ratio, interlacing and comments.
    pub fn parse(fields: &[u8]) -> Result<Self, CaptureError> {
        let mut header = Self { width: 0, height: 0, rate: None, chroma_shift: Some([1, 1]), full_range: false };
        for field in fields.split(|&byte| byte == b' ') {
            match field {
                [b'W', value @ ..] => header.width = number(value).unwrap_or(0) as usize,
                [b'H', value @ ..] => header.height = number(value).unwrap_or(0) as usize,
                [b'F', value @ ..] => header.rate = rate(value),
                [b'C', value @ ..] => header.chroma_shift = chroma_shift(value)?,
                b"XCOLORRANGE=FULL" => header.full_range = true,
                _ => {}
            }
        }
        let Self { width, height, .. } = header;
        let fits = |side| (1..=MAX_SIDE_PX).contains(&side);
        if fits(width) && fits(height) { Ok(header) } else { Err(CaptureError::PictureSize { width, height }) }
    }

    /// Columns and rows of each chroma plane.
    fn chroma_size(&self) -> [usize; 2] {
        let shrink = |side: usize, shift: u8| side.div_ceil(1 << shift);
        self.chroma_shift.map_or([0, 0], |[x, y]| [shrink(self.width, x), shrink(self.height, y)])
    }

    pub fn frame_bytes(&self) -> usize {
        let [columns, rows] = self.chroma_size();
        self.width * self.height + 2 * columns * rows
    }

    pub fn pixels<'a>(&self, samples: &'a [u8]) -> Option<Pixels<'a>> {
        let stride = self.width;
        let Some(chroma_shift) = self.chroma_shift else {
            return Some(Pixels::Grey { data: samples, stride });
        };
        let [columns, rows] = self.chroma_size();
        let (luma, chroma) = samples.split_at_checked(stride * self.height)?;
        let (cb, cr) = chroma.split_at_checked(columns * rows)?;
        Some(Pixels::Planar { planes: [luma, cb, cr], strides: [stride, columns], chroma_shift })
    }
}

/// Parses the colour layout. Ignores the siting of chroma samples, which differs by a fraction of a pixel.
fn chroma_shift(name: &[u8]) -> Result<Option<[u8; 2]>, CaptureError> {
    match name {
        b"420" | b"420jpeg" | b"420mpeg2" | b"420paldv" => Ok(Some([1, 1])),
        b"422" => Ok(Some([1, 0])),
        b"444" => Ok(Some([0, 0])),
        b"411" => Ok(Some([2, 0])),
        b"mono" => Ok(None),
        [.., b'p', b'1', _] | [.., b'p', b'9'] | [b'm', b'o', b'n', b'o', ..] => {
            Err(CaptureError::Y4m("has more than 8 bits a sample"))
        }
        _ => Err(CaptureError::Y4m("has a colour layout that is not supported")),
    }
}

fn number(digits: &[u8]) -> Option<u32> {
    std::str::from_utf8(digits).ok()?.parse().ok()
}

/// Parses a rate such as `30000:1001`. `0:0` stands for an unknown rate.
fn rate(value: &[u8]) -> Option<FrameRate> {
    let colon = value.iter().position(|&byte| byte == b':')?;
    let (frames, seconds) = value.split_at_checked(colon)?;
    FrameRate::new(number(frames)?, number(seconds.get(1..)?)?)
}
