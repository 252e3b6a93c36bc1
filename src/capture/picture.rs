//! A picture in the format the camera gave it, borrowed from its source.

/// A borrowed picture, `width` x `height` pixels.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The samples.
    pub pixels: Pixels<'a>,
    /// Whether luma runs 0..=255 (JPEG) rather than 16..=235 (video).
    pub full_range: bool,
}

/// The samples of a picture. Strides are in bytes. Every constructor of a source checks the lengths once,
/// so that each row and column inside the picture lies inside its slice.
#[derive(Debug, Clone, Copy)]
pub enum Pixels<'a> {
    /// Packed 4:2:2, `Y0 Cb Y1 Cr`.
    Yuyv {
        /// All rows.
        data: &'a [u8],
        /// Bytes from one row to the next.
        stride: usize,
    },
    /// Luma plane, then one plane of interleaved `Cb Cr` at half size.
    Nv12 {
        /// Luma rows.
        luma: &'a [u8],
        /// Chroma rows.
        chroma: &'a [u8],
        /// Bytes from one row to the next, in both planes.
        stride: usize,
    },
    /// Three planes, the chroma ones smaller by powers of two (Motion-JPEG, y4m).
    Planar {
        /// Luma, Cb, Cr.
        planes: [&'a [u8]; 3],
        /// Bytes from one row to the next of luma and of both chroma planes.
        strides: [usize; 2],
        /// Chroma is `1 << x` narrower and `1 << y` lower than luma.
        chroma_shift: [u8; 2],
    },
    /// Luma only.
    Grey {
        /// All rows.
        data: &'a [u8],
        /// Bytes from one row to the next.
        stride: usize,
    },
}
