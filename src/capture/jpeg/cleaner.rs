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
    pub const BASELINE: u8 = 0xc0;
    pub const EXTENDED_SEQUENTIAL: u8 = 0xc1;
    pub const HUFFMAN_TABLES: u8 = 0xc4;
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
/// Luma and two chroma components.
const MAX_COMPONENTS: usize = 3;
/// Pixels per side of a block, and its coefficients.
const BLOCK_SIDE: usize = 8;
const BLOCK_COEFFICIENTS: u8 = 64;
/// Longest Huffman code, bits.
const MAX_CODE_BITS: usize = 16;

/// Cleans images, one after the other, in memory of fixed capacity.
#[derive(Debug)]
pub(super) struct Cleaner {
    clean: Vec<u8>,
    /// The header that each image starts from.
    standard: Header,
}

impl Cleaner {
    /// Takes the memory for images of up to `max_bytes`.
    pub(super) fn new(max_bytes: usize) -> Self {
        let mut standard = Header::default();
        standard.read_tables(STANDARD_TABLES);
        Self { clean: Vec::with_capacity(max_bytes), standard }
    }

    /// Returns the image as the standard wants it. An image that conforms is returned as it is, up to its end marker.
    pub(super) fn clean(&mut self, jpeg: &[u8]) -> Result<&[u8], FrameFault> {
        self.clean.clear();
        let (mut input, mut header) = (Input { jpeg, at: 0 }, self.standard.clone());
        self.copy_header(&mut input, &mut header)?;
        self.copy_scan(&mut input, &header)?;
        match input.marker(MAX_STRAY_BYTES) {
            Ok(marker::END_OF_IMAGE) | Err(FrameFault::Incomplete) => self.push(END_OF_IMAGE)?,
            _ => return Err(FrameFault::Corrupt),
        }
        Ok(&self.clean)
    }

    fn copy_header(&mut self, input: &mut Input, header: &mut Header) -> Result<(), FrameFault> {
        self.push(START_OF_IMAGE)?;
        loop {
            let marker = input.marker(usize::MAX)?;
            if marker == marker::START_OF_IMAGE {
                continue;
            }
            let segment = input.segment()?;
            header.read(marker, segment).ok_or(FrameFault::Corrupt)?;
            // libjpeg-turbo would warn of another version of JFIF than 1.
            let version = segment.strip_prefix(b"JFIF\0").and_then(<[u8]>::first);
            if marker == marker::APP_0 && version.is_some_and(|version| *version != 1) {
                continue;
            }
            let length = u16::try_from(segment.len() + 2).map_err(|_| FrameFault::Corrupt)?;
            self.push(&[0xff, marker])?;
            self.push(&length.to_be_bytes())?;
            self.push(segment)?;
            if marker == marker::START_OF_SCAN {
                self.clean.truncate(self.clean.len().saturating_sub(SEQUENTIAL.len()));
                return self.push(&SEQUENTIAL);
            }
        }
    }

    /// Copies the entropy-coded data and its restart markers.
    fn copy_scan(&mut self, input: &mut Input, header: &Header) -> Result<(), FrameFault> {
        let mut left = header.units();
        let interval = if header.restart_interval == 0 { left } else { header.restart_interval };
        let mut restarts = (marker::RESTART_0..=marker::RESTART_7).cycle();
        loop {
            let mut bits = BitReader { bytes: input.jpeg, at: input.at, buffer: 0, left: 0 };
            for _ in 0..left.min(interval) {
                header.read_unit(&mut bits)?;
            }
            let end = bits.next_byte();
            self.push(input.jpeg.get(input.at..end).unwrap_or_default())?;
            input.at = end;
            left = left.saturating_sub(interval);
            if left == 0 {
                return Ok(());
            }
            let marker = input.marker(MAX_STRAY_BYTES)?;
            if restarts.next() != Some(marker) {
                return Err(FrameFault::Corrupt);
            }
            self.push(&[0xff, marker])?;
        }
    }

    /// Appends bytes without ever growing the memory.
    fn push(&mut self, bytes: &[u8]) -> Result<(), FrameFault> {
        if bytes.len() > self.clean.capacity() - self.clean.len() {
            return Err(FrameFault::TooLarge);
        }
        self.clean.extend_from_slice(bytes);
        Ok(())
    }
}

/// An image that is being read.
struct Input<'a> {
    jpeg: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
    /// Reads the next marker, passing over fill bytes (0xff) and up to `max_stray_bytes` other bytes before it.
    fn marker(&mut self, max_stray_bytes: usize) -> Result<u8, FrameFault> {
        let (mut stray_bytes, mut last) = (0, 0);
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

    /// Reads the content of a segment, whose length comes first and counts itself.
    fn segment(&mut self) -> Result<&'a [u8], FrameFault> {
        let rest = self.jpeg.get(self.at..).unwrap_or_default();
        let (length, _) = rest.split_first_chunk().ok_or(FrameFault::Incomplete)?;
        let length = usize::from(u16::from_be_bytes(*length));
        let segment = rest.get(..length).ok_or(FrameFault::Incomplete)?;
        self.at += length;
        segment.get(2..).ok_or(FrameFault::Corrupt)
    }
}

/// What the header of a sequential image says about its scan.
#[derive(Debug, Clone, Default)]
struct Header {
    /// Tables of DC and of AC coefficients.
    tables: [[HuffmanTable; 2]; 2],
    /// Minimum coded units between two restart markers; 0 if there are none.
    restart_interval: usize,
    /// Width and height in pixels.
    size: [usize; 2],
    components: heapless::Vec<Component, MAX_COMPONENTS>,
}

#[derive(Debug, Clone)]
struct Component {
    id: u8,
    /// How often the component is sampled in each direction within a unit.
    factors: [usize; 2],
    /// Indices of its tables for DC and AC coefficients.
    tables: [usize; 2],
}

impl Header {
    /// Reads the content of a segment; `None` if a sequential image has no such segment.
    fn read(&mut self, marker: u8, segment: &[u8]) -> Option<()> {
        match marker {
            marker::BASELINE | marker::EXTENDED_SEQUENTIAL => self.read_frame(segment),
            marker::HUFFMAN_TABLES => self.read_tables(segment),
            marker::START_OF_SCAN => self.read_scan(segment),
            marker::RESTART_INTERVAL => {
                self.restart_interval = u16::from_be_bytes(segment.try_into().ok()?).into();
                Some(())
            }
            // Not of other kinds of frames, and markers without a segment.
            _ => (marker > marker::START_OF_SCAN).then_some(()),
        }
    }

    fn read_frame(&mut self, segment: &[u8]) -> Option<()> {
        let (&[8, h1, h0, w1, w0, count], components) = segment.split_first_chunk()? else { return None };
        self.size = [[w1, w0], [h1, h0]].map(|side| u16::from_be_bytes(side).into());
        self.components.clear();
        for component in components.chunks_exact(3).take(count.into()) {
            let &[id, sampling, _] = component else { return None };
            let factors = [sampling >> 4, sampling & 15].map(usize::from);
            factors.iter().all(|factor| (1..=4).contains(factor)).then_some(())?;
            self.components.push(Component { id, factors, tables: [0; 2] }).ok()?;
        }
        (count > 0 && self.components.len() == usize::from(count)).then_some(())
    }

    fn read_tables(&mut self, mut segment: &[u8]) -> Option<()> {
        while let Some(([kind, counts @ ..], rest)) = segment.split_first_chunk::<17>() {
            let length = counts.iter().map(|count| usize::from(*count)).sum();
            let (values, rest) = rest.split_at_checked(length)?;
            let table = self.tables.get_mut(usize::from(kind >> 4))?.get_mut(usize::from(kind & 15))?;
            *table = HuffmanTable::new(counts, values);
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
            component.tables = [tables >> 4, tables & 15].map(usize::from);
            selected += usize::from(id == component.id);
        }
        (selected == self.components.len() && selected == usize::from(*count)).then_some(())
    }

    /// Number of minimum coded units in the scan.
    fn units(&self) -> usize {
        let most = |axis: usize| match self.components.as_slice() {
            [_] => 1,
            components => {
                components.iter().filter_map(|component| component.factors.get(axis)).copied().max().unwrap_or(1)
            }
        };
        let [width, height] = self.size;
        width.div_ceil(BLOCK_SIDE * most(0)) * height.div_ceil(BLOCK_SIDE * most(1))
    }

    fn read_unit(&self, bits: &mut BitReader) -> Result<(), FrameFault> {
        let [dc_tables, ac_tables] = &self.tables;
        for Component { factors, tables: [dc, ac], .. } in &self.components {
            let (Some(dc), Some(ac)) = (dc_tables.get(*dc), ac_tables.get(*ac)) else {
                return Err(FrameFault::Corrupt);
            };
            // A scan of one component has one block in each unit, whatever its sampling.
            let blocks = if self.components.len() == 1 { 1 } else { factors.iter().product() };
            for _ in 0..blocks {
                bits.block(dc, ac)?;
            }
        }
        Ok(())
    }
}

/// One Huffman table, in the form of ITU-T T.81, F.2.2.3.
#[derive(Debug, Clone)]
struct HuffmanTable {
    /// For each code length: the smallest 16-bit value, with the code in its high bits, that lies above all codes of this
    /// length and of shorter lengths.
    ends: [u32; MAX_CODE_BITS],
    /// For each code length: what to add to a code of this length to get the index of its value.
    offsets: [i32; MAX_CODE_BITS],
    values: [u8; 256],
}

impl Default for HuffmanTable {
    fn default() -> Self {
        Self { ends: [0; MAX_CODE_BITS], offsets: [0; MAX_CODE_BITS], values: [0; 256] }
    }
}

impl HuffmanTable {
    /// Builds the table from the number of codes of each length and the values in order of their codes.
    fn new(counts: &[u8; MAX_CODE_BITS], values: &[u8]) -> Self {
        let mut table = Self::default();
        table.values.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        let (mut code, mut index) = (0, 0);
        for (bits, ((count, end), offset)) in (1..).zip(counts.iter().zip(&mut table.ends).zip(&mut table.offsets)) {
            *offset = index - code;
            code += i32::from(*count);
            index += i32::from(*count);
            *end = code.cast_unsigned() << (MAX_CODE_BITS - bits);
            code *= 2;
        }
        table
    }

    /// The code at the start of `bits`, 16 bits of the stream: its length and its value.
    fn decode(&self, bits: u32) -> Option<(u32, u8)> {
        let shorter = self.ends.iter().take_while(|end| bits >= **end).count();
        let code = i32::try_from(bits >> (MAX_CODE_BITS - 1).checked_sub(shorter)?).ok()?;
        let value = self.values.get(usize::try_from(code + self.offsets.get(shorter)?).ok()?)?;
        Some((u32::try_from(shorter + 1).ok()?, *value))
    }
}

/// Reads the bits of entropy-coded data up to the next marker.
struct BitReader<'a> {
    bytes: &'a [u8],
    /// Index of the next byte to be loaded.
    at: usize,
    buffer: u64,
    /// Bits of `buffer` that were not consumed yet.
    left: u32,
}

impl BitReader<'_> {
    /// Reads past the coefficients of one block.
    fn block(&mut self, dc: &HuffmanTable, ac: &HuffmanTable) -> Result<(), FrameFault> {
        let bits = self.code(dc)?;
        self.consume(bits.into())?;
        let mut coefficient = 1;
        while coefficient < BLOCK_COEFFICIENTS {
            let code = self.code(ac)?;
            let (zeros, bits) = (code >> 4, code & 15);
            // A code without a value ends the block, except for a run of 16 zeros.
            if bits == 0 && zeros < 15 {
                break;
            }
            self.consume(bits.into())?;
            coefficient += zeros + 1;
        }
        if coefficient > BLOCK_COEFFICIENTS { Err(FrameFault::Corrupt) } else { Ok(()) }
    }

    /// Index of the first byte of which no bit was consumed.
    fn next_byte(&self) -> usize {
        (0..self.left / 8).fold(self.at, |at, _| {
            let is_stuffed = at >= 2 && self.bytes.get(at - 2..at) == Some(&[0xff, 0]);
            at.saturating_sub(if is_stuffed { 2 } else { 1 })
        })
    }

    fn code(&mut self, table: &HuffmanTable) -> Result<u8, FrameFault> {
        self.load();
        let bits = if self.left >= 16 { self.buffer >> (self.left - 16) } else { self.buffer << (16 - self.left) };
        let (length, value) = table.decode((bits & 0xffff) as u32).ok_or(FrameFault::Corrupt)?;
        self.consume(length)?;
        Ok(value)
    }

    fn consume(&mut self, bits: u32) -> Result<(), FrameFault> {
        if self.left < bits {
            self.load();
        }
        let at_end = if self.at < self.bytes.len() { FrameFault::Corrupt } else { FrameFault::Incomplete };
        self.left = self.left.checked_sub(bits).ok_or(at_end)?;
        Ok(())
    }

    /// Loads whole bytes up to the next marker. A data byte 0xff is followed by a stuffed 0.
    fn load(&mut self) {
        while self.left <= 32 {
            let (byte, length) = match self.bytes.get(self.at..) {
                Some([0xff, 0, ..]) => (0xff, 2),
                Some([byte, ..]) if *byte != 0xff => (*byte, 1),
                _ => return,
            };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.left += 8;
            self.at += length;
        }
    }
}
