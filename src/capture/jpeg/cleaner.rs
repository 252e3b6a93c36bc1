//! Removes from a JPEG image what some webcams add to it against the standard, and restores what they leave out.
//!
//! Removed are stray bytes before a marker, a second start marker, and a JFIF segment of an unknown version. Unusual
//! parameters of the scan are set right, and an end marker is added where it is missing. Logitech C270, C510 and C910
//! cameras, for example, put 1 to 10 stray bytes before many restart markers.
//!
//! libjpeg-turbo passes over all of this by itself, but it reports only its first warning, which may hide a later one
//! about lost blocks. The cleaner therefore reads every Huffman code, and refuses an image that lacks a block.
//!
//! Limits: sequential Huffman-coded images with all components in one scan, as Motion-JPEG requires.

use super::header::{Header, Scan, marker};
use super::huffman::BitReader;
use super::standard_tables::standard_tables;
use super::{END_OF_IMAGE, FrameFault, START_OF_IMAGE};

/// Largest number of stray bytes that are removed between the codes and a marker. If there are more, it is likely that
/// the codes were damaged and ended at the wrong place.
const MAX_STRAY_BYTES: usize = 32;
/// Parameters of a sequential scan: first and last coefficient, and no successive approximation.
const SEQUENTIAL: [u8; 3] = [0, 63, 0];

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
        Self { clean: Vec::with_capacity(max_bytes), standard: Header::new(standard_tables()) }
    }

    /// Returns the image as the standard wants it. An image that conforms is returned as it is, up to its end marker.
    ///
    /// # Errors
    /// [`FrameFault::Incomplete`] for an image that is cut off, [`FrameFault::TooLarge`], and [`FrameFault::Corrupt`]
    /// for one that has missing or undefined blocks or more than a few stray bytes, or is not sequential.
    pub(super) fn clean(&mut self, jpeg: &[u8]) -> Result<&[u8], FrameFault> {
        self.clean.clear();
        let mut input = Input { jpeg, at: 0 };
        let mut header = self.standard.clone();
        let scan = self.copy_header(&mut input, &mut header)?;
        self.copy_scan(&mut input, &header, &scan)?;
        match input.marker(MAX_STRAY_BYTES) {
            Ok(marker::END_OF_IMAGE) | Err(FrameFault::Incomplete) => self.push(END_OF_IMAGE)?,
            _ => return Err(FrameFault::Corrupt),
        }
        Ok(&self.clean)
    }

    fn copy_header(&mut self, input: &mut Input, header: &mut Header) -> Result<Scan, FrameFault> {
        self.push(START_OF_IMAGE)?;
        loop {
            let marker = input.marker(usize::MAX)?;
            if marker == marker::START_OF_IMAGE {
                continue;
            }
            let segment = input.segment()?;
            if marker == marker::START_OF_SCAN {
                let scan = header.scan(segment).ok_or(FrameFault::Corrupt)?;
                self.push_segment(marker, segment)?;
                self.clean.truncate(self.clean.len().saturating_sub(SEQUENTIAL.len()));
                self.push(&SEQUENTIAL)?;
                return Ok(scan);
            }
            header.read(marker, segment)?;
            if !is_unknown_jfif(marker, segment) {
                self.push_segment(marker, segment)?;
            }
        }
    }

    /// Copies the entropy-coded data and its restart markers.
    fn copy_scan(&mut self, input: &mut Input, header: &Header, scan: &Scan) -> Result<(), FrameFault> {
        let interval = if header.restart_interval == 0 { scan.units } else { header.restart_interval };
        let mut restarts = (marker::RESTART_0..=marker::RESTART_7).cycle();
        let mut left = scan.units;
        loop {
            let mut bits = BitReader::new(input.jpeg, input.at);
            for _ in 0..left.min(interval) {
                read_unit(&mut bits, header, scan)?;
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

    fn push_segment(&mut self, marker: u8, segment: &[u8]) -> Result<(), FrameFault> {
        let length = u16::try_from(segment.len() + 2).map_err(|_| FrameFault::Corrupt)?;
        self.push(&[0xff, marker])?;
        self.push(&length.to_be_bytes())?;
        self.push(segment)
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

/// Whether libjpeg-turbo would warn of the version of this JFIF segment.
fn is_unknown_jfif(marker: u8, segment: &[u8]) -> bool {
    marker == marker::APP_0 && segment.strip_prefix(b"JFIF\0").is_some_and(|version| version.first() != Some(&1))
}

fn read_unit(bits: &mut BitReader, header: &Header, scan: &Scan) -> Result<(), FrameFault> {
    for component in &scan.components {
        let [dc, ac] = header.tables_of(component).ok_or(FrameFault::Corrupt)?;
        for _ in 0..component.blocks {
            bits.block(dc, ac)?;
        }
    }
    Ok(())
}

/// An image that is being read.
struct Input<'a> {
    jpeg: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
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
