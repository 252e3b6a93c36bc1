//! Removes from a JPEG image what some webcams add to it against the standard, and restores what they leave out.
//!
//! Removed are stray bytes before a marker, a second start marker, and a JFIF segment of an unknown version. Unusual
//! parameters of the scan are set right, and an end marker is added where it is missing. Logitech C270, C510 and C910
//! cameras, for example, put 1 to 10 stray bytes before many restart markers.
//!
//! libjpeg-turbo passes over all of this by itself, but its warning does not tell an image that lacks only its end marker
//! from one that lacks blocks, and every warning costs an allocation. Counting markers does not tell either. The cleaner
//! therefore reads every Huffman code, and refuses an image that lacks a block.
//!
//! Limits: sequential Huffman-coded images with all components in one scan, as Motion-JPEG requires.

use super::{END_OF_IMAGE, FrameFault, START_OF_IMAGE};

/// Markers of ITU-T T.81, table B.1.
mod marker {
    pub const TEMPORARY: u8 = 0x01;
    pub const BASELINE: u8 = 0xc0;
    pub const EXTENDED_SEQUENTIAL: u8 = 0xc1;
    pub const HUFFMAN_TABLES: u8 = 0xc4;
    pub const JPEG_EXTENSION: u8 = 0xc8;
    pub const ARITHMETIC_CONDITIONING: u8 = 0xcc;
    pub const LAST_FRAME: u8 = 0xcf;
    pub const RESTART_0: u8 = 0xd0;
    pub const RESTART_7: u8 = 0xd7;
    pub const START_OF_IMAGE: u8 = 0xd8;
    pub const END_OF_IMAGE: u8 = 0xd9;
    pub const START_OF_SCAN: u8 = 0xda;
    pub const RESTART_INTERVAL: u8 = 0xdd;
    pub const APP_0: u8 = 0xe0;
}

/// The tables of T.81, K.3.3, as a segment. They apply to images that bring none of their own.
const STANDARD_TABLES: &[u8] = include_bytes!("standard_tables.dht");
/// Largest number of stray bytes that are removed between the codes and a marker. If there are more, it is likely that
/// the codes were damaged and ended at the wrong place.
const MAX_STRAY_BYTES: usize = 32;
/// Parameters of a sequential scan: first and last coefficient, and no successive approximation.
const SEQUENTIAL: [u8; 3] = [0, 63, 0];
const BLOCK_SIDE: usize = 8;
const BLOCK_COEFFICIENTS: u8 = 64;
const MAX_CODE_BITS: usize = 16;

/// Writes the image to `clean` as the standard wants it, up to its end marker. An image that conforms is copied as it is.
/// Never grows the memory of `clean`.
pub(super) fn clean(jpeg: &[u8], clean: &mut Vec<u8>) -> Result<(), FrameFault> {
    clean.clear();
    let mut image = Image { jpeg, ..Image::default() };
    image.read_tables(STANDARD_TABLES).ok_or(FrameFault::Corrupt)?;
    image.copy_header(clean)?;
    image.copy_scan(clean)?;
    match image.marker(MAX_STRAY_BYTES) {
        Ok(marker::END_OF_IMAGE) | Err(FrameFault::Incomplete) => push(clean, END_OF_IMAGE),
        _ => Err(FrameFault::Corrupt),
    }
}

/// Returns the width and height that the header of an image states.
pub(in super::super) fn image_size(jpeg: &[u8]) -> Option<[usize; 2]> {
    jpeg.starts_with(START_OF_IMAGE).then_some(())?;
    let mut image = Image { jpeg, ..Image::default() };
    loop {
        let marker = image.marker(usize::MAX).ok()?;
        if matches!(marker, marker::TEMPORARY | marker::RESTART_0..=marker::START_OF_IMAGE) {
            continue;
        }
        let segment = image.segment().ok()?;
        match marker {
            marker::HUFFMAN_TABLES | marker::JPEG_EXTENSION | marker::ARITHMETIC_CONDITIONING => {}
            // The headers of all kinds of frames begin alike.
            marker::BASELINE..=marker::LAST_FRAME => {
                let &[_, _, _, h1, h0, w1, w0] = segment.first_chunk()?;
                return Some([[w1, w0], [h1, h0]].map(|side| u16::from_be_bytes(side).into()));
            }
            marker::END_OF_IMAGE | marker::START_OF_SCAN => return None,
            _ => {}
        }
    }
}

/// Returns the length of the image with which these bytes begin, up to its end marker or to the start marker of another image;
/// `None` if neither is there yet.
pub(in super::super) fn image_length(bytes: &[u8]) -> Option<usize> {
    let mut image = Image { jpeg: bytes, ..Image::default() };
    // Some cameras begin an image twice.
    let mut has_segments = false;
    loop {
        match image.marker(usize::MAX).ok()? {
            marker::END_OF_IMAGE => return Some(image.at),
            marker::START_OF_IMAGE if has_segments => return Some(image.at - START_OF_IMAGE.len()),
            marker::TEMPORARY | marker::RESTART_0..=marker::START_OF_IMAGE => {}
            _ => {
                image.segment().ok()?;
                has_segments = true;
            }
        }
    }
}

fn push(clean: &mut Vec<u8>, bytes: &[u8]) -> Result<(), FrameFault> {
    if bytes.len() > clean.capacity() - clean.len() {
        return Err(FrameFault::TooLarge);
    }
    clean.extend_from_slice(bytes);
    Ok(())
}

/// A sequential image that is being read, and what its header says about its scan.
#[derive(Default)]
struct Image<'a> {
    jpeg: &'a [u8],
    at: usize,
    /// Entropy-coded bits that were read. The last `bits_left` of them were not consumed yet.
    bits: u64,
    bits_left: u32,
    tables: [[HuffmanTable<'a>; 2]; 2],
    /// Minimum coded units between two restart markers; 0 if there are none.
    restart_interval: usize,
    size: [usize; 2],
    /// Luma, or luma and two chroma components.
    components: heapless::Vec<Component<'a>, 3>,
}

#[derive(Clone, Copy)]
struct Component<'a> {
    id: u8,
    /// How many blocks of the component are side by side, and how many below each other, in a minimum coded unit.
    blocks: [usize; 2],
    /// Its tables for DC and AC coefficients.
    tables: [HuffmanTable<'a>; 2],
}

/// The number of codes of each length, and the values in order of their codes.
#[derive(Default, Clone, Copy)]
struct HuffmanTable<'a> {
    counts: [u8; MAX_CODE_BITS],
    values: &'a [u8],
}

impl<'a> Image<'a> {
    fn copy_header(&mut self, clean: &mut Vec<u8>) -> Result<(), FrameFault> {
        push(clean, START_OF_IMAGE)?;
        loop {
            let marker = self.marker(usize::MAX)?;
            if marker == marker::START_OF_IMAGE {
                continue;
            }
            let segment = self.segment()?;
            let content = segment.get(2..).ok_or(FrameFault::Corrupt)?;
            self.read_segment(marker, content).ok_or(FrameFault::Corrupt)?;
            // libjpeg-turbo would warn of another version of JFIF than 1.
            let version = content.strip_prefix(b"JFIF\0").and_then(<[u8]>::first);
            if marker == marker::APP_0 && version.is_some_and(|version| *version != 1) {
                continue;
            }
            push(clean, &[0xff, marker])?;
            push(clean, segment)?;
            if marker == marker::START_OF_SCAN {
                clean.truncate(clean.len().saturating_sub(SEQUENTIAL.len()));
                return push(clean, &SEQUENTIAL);
            }
        }
    }

    /// Copies the entropy-coded data and its restart markers.
    fn copy_scan(&mut self, clean: &mut Vec<u8>) -> Result<(), FrameFault> {
        let blocks = self.components.iter().map(|component| component.blocks);
        let [columns, rows] = blocks.fold([1; 2], |most, [x, y]| [most[0].max(x), most[1].max(y)]);
        let [width, height] = self.size;
        let mut left = width.div_ceil(BLOCK_SIDE * columns) * height.div_ceil(BLOCK_SIDE * rows);
        let interval = if self.restart_interval == 0 { left } else { self.restart_interval };
        let mut restarts = (marker::RESTART_0..=marker::RESTART_7).cycle();
        loop {
            let start = self.at;
            self.bits = 0;
            self.bits_left = 0;
            for _ in 0..left.min(interval) {
                self.read_unit()?;
            }
            self.unread_whole_bytes();
            push(clean, self.jpeg.get(start..self.at).unwrap_or_default())?;
            left = left.saturating_sub(interval);
            if left == 0 {
                return Ok(());
            }
            let marker = self.marker(MAX_STRAY_BYTES)?;
            if restarts.next() != Some(marker) {
                return Err(FrameFault::Corrupt);
            }
            push(clean, &[0xff, marker])?;
        }
    }

    /// Reads the next marker, passing over fill bytes (0xff) and up to `max_stray_bytes` other bytes before it.
    fn marker(&mut self, max_stray_bytes: usize) -> Result<u8, FrameFault> {
        let mut stray_bytes = 0;
        let mut last = 0;
        while let Some(byte) = self.jpeg.get(self.at) {
            self.at += 1;
            match byte {
                0xff => {}
                1.. if last == 0xff => return Ok(*byte),
                _ => stray_bytes += 1,
            }
            if stray_bytes > max_stray_bytes {
                return Err(FrameFault::Corrupt);
            }
            last = *byte;
        }
        Err(FrameFault::Incomplete)
    }

    /// Returns a segment. Its length comes first and counts itself.
    fn segment(&mut self) -> Result<&'a [u8], FrameFault> {
        let rest = self.jpeg.get(self.at..).unwrap_or_default();
        let length = rest.first_chunk().ok_or(FrameFault::Incomplete)?;
        let length = usize::from(u16::from_be_bytes(*length));
        self.at += length;
        rest.get(..length).ok_or(FrameFault::Incomplete)
    }

    /// Reads the content of a segment; `None` if a sequential image has no such segment.
    fn read_segment(&mut self, marker: u8, segment: &'a [u8]) -> Option<()> {
        match marker {
            marker::BASELINE | marker::EXTENDED_SEQUENTIAL => self.read_frame(segment),
            marker::HUFFMAN_TABLES => self.read_tables(segment),
            marker::START_OF_SCAN => self.read_scan(segment),
            marker::RESTART_INTERVAL => {
                self.restart_interval = u16::from_be_bytes(segment.try_into().ok()?).into();
                Some(())
            }
            // The other markers below it belong to other kinds of frames, or have no segment.
            _ => (marker > marker::START_OF_SCAN).then_some(()),
        }
    }

    fn read_frame(&mut self, segment: &[u8]) -> Option<()> {
        let (&[8, h1, h0, w1, w0, count], components) = segment.split_first_chunk()? else { return None };
        self.size = [[w1, w0], [h1, h0]].map(|side| u16::from_be_bytes(side).into());
        self.components.clear();
        for component in components.chunks_exact(3).take(count.into()) {
            let &[id, sampling, _] = component else { return None };
            let sampling = [sampling >> 4, sampling & 15].map(usize::from);
            sampling.iter().all(|factor| (1..=4).contains(factor)).then_some(())?;
            // A scan of one component has one block in each unit, whatever its sampling.
            let blocks = if count == 1 { [1; 2] } else { sampling };
            self.components.push(Component { id, blocks, tables: Default::default() }).ok()?;
        }
        (count > 0 && self.components.len() == usize::from(count)).then_some(())
    }

    fn read_tables(&mut self, mut segment: &'a [u8]) -> Option<()> {
        while let Some((&[kind, ref counts @ ..], rest)) = segment.split_first_chunk::<{ 1 + MAX_CODE_BITS }>() {
            let length = counts.iter().map(|count| usize::from(*count)).sum();
            let (values, rest) = rest.split_at_checked(length)?;
            let table = self.tables.get_mut(usize::from(kind >> 4))?.get_mut(usize::from(kind & 15))?;
            *table = HuffmanTable { counts: *counts, values };
            segment = rest;
        }
        segment.is_empty().then_some(())
    }

    /// Reads the tables of the components; `None` unless all components are in this scan, in their order.
    fn read_scan(&mut self, segment: &[u8]) -> Option<()> {
        let (count, selectors) = segment.split_first()?;
        let mut selected = 0;
        for (selector, component) in selectors.chunks_exact(2).zip(&mut self.components) {
            let &[id, tables] = selector else { return None };
            let [dc, ac] = &self.tables;
            component.tables = [*dc.get(usize::from(tables >> 4))?, *ac.get(usize::from(tables & 15))?];
            selected += usize::from(id == component.id);
        }
        (selected == self.components.len() && selected == usize::from(*count)).then_some(())
    }

    fn read_unit(&mut self) -> Result<(), FrameFault> {
        for number in 0..self.components.len() {
            let Some(Component { blocks, tables: [dc, ac], .. }) = self.components.get(number).copied() else { break };
            for _ in 0..blocks.iter().product() {
                self.read_block(&dc, &ac)?;
            }
        }
        Ok(())
    }

    fn read_block(&mut self, dc: &HuffmanTable, ac: &HuffmanTable) -> Result<(), FrameFault> {
        let bits = self.read_code(dc)?;
        self.consume(bits.into())?;
        let mut coefficient = 1;
        while coefficient < BLOCK_COEFFICIENTS {
            let code = self.read_code(ac)?;
            let zeros = code >> 4;
            let bits = code & 15;
            // A code without a value ends the block, except for a run of 16 zeros.
            if bits == 0 && zeros < 15 {
                break;
            }
            self.consume(bits.into())?;
            coefficient += zeros + 1;
        }
        if coefficient > BLOCK_COEFFICIENTS { Err(FrameFault::Corrupt) } else { Ok(()) }
    }

    /// Reads a Huffman code and returns its value. Codes of a length are consecutive numbers, which follow those of the
    /// next shorter length with a 0 behind them (T.81, C.2).
    fn read_code(&mut self, table: &HuffmanTable) -> Result<u8, FrameFault> {
        self.load();
        let next = (self.bits << 16 >> self.bits_left) as u32 & 0xffff;
        let mut first = 0;
        let mut index = 0;
        for (length, count) in (1..).zip(table.counts) {
            let code = next >> (16 - length);
            let count = u32::from(count);
            if code < first + count {
                self.consume(length)?;
                return table.values.get((index + code - first) as usize).copied().ok_or(FrameFault::Corrupt);
            }
            first = 2 * (first + count);
            index += count;
        }
        Err(FrameFault::Corrupt)
    }

    fn consume(&mut self, bits: u32) -> Result<(), FrameFault> {
        if self.bits_left < bits {
            self.load();
        }
        let at_end = if self.at < self.jpeg.len() { FrameFault::Corrupt } else { FrameFault::Incomplete };
        self.bits_left = self.bits_left.checked_sub(bits).ok_or(at_end)?;
        Ok(())
    }

    /// Loads whole bytes up to the next marker. A data byte 0xff is followed by a stuffed 0.
    fn load(&mut self) {
        while self.bits_left <= 32 {
            let (byte, length) = match self.jpeg.get(self.at..) {
                Some([0xff, 0, ..]) => (0xff, 2),
                Some([byte, ..]) if *byte != 0xff => (*byte, 1),
                _ => return,
            };
            self.bits = self.bits << 8 | u64::from(byte);
            self.bits_left += 8;
            self.at += length;
        }
    }

    /// Goes back to the first byte of which no bit was consumed.
    fn unread_whole_bytes(&mut self) {
        for _ in 0..self.bits_left / 8 {
            let is_stuffed = self.at >= 2 && self.jpeg.get(self.at - 2..self.at) == Some(&[0xff, 0]);
            self.at = self.at.saturating_sub(if is_stuffed { 2 } else { 1 });
        }
    }
}
