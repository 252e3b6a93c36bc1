//! What the header of a sequential JPEG image says about its scan.

use heapless::Vec;

use super::FrameFault;
use super::huffman::HuffmanTable;

/// Luma and two chroma components.
const MAX_COMPONENTS: usize = 3;
/// Pixels per side of a block.
const BLOCK_SIDE: usize = 8;

/// Markers of ITU-T T.81, table B.1.
pub(super) mod marker {
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

/// One component of a scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Component {
    /// Blocks in one minimum coded unit.
    pub(super) blocks: usize,
    /// Index of its table for DC coefficients.
    dc: usize,
    /// Index of its table for AC coefficients.
    ac: usize,
}

/// How the blocks of a scan follow each other.
#[derive(Debug)]
pub(super) struct Scan {
    pub(super) components: Vec<Component, MAX_COMPONENTS>,
    /// Number of minimum coded units.
    pub(super) units: usize,
}

/// What was read of a header so far.
#[derive(Debug, Clone)]
pub(super) struct Header {
    /// Tables of DC and of AC coefficients.
    tables: [[HuffmanTable; 2]; 2],
    /// Minimum coded units between two restart markers; 0 if there are none.
    pub(super) restart_interval: usize,
    /// Width and height in pixels.
    size: [usize; 2],
    /// Identifier and sampling factors of each component.
    components: Vec<(u8, [usize; 2]), MAX_COMPONENTS>,
}

impl Header {
    /// An empty header with the tables that apply to an image without tables.
    pub(super) fn new(tables: [[HuffmanTable; 2]; 2]) -> Self {
        Self { tables, restart_interval: 0, size: [0; 2], components: Vec::new() }
    }

    /// Reads the content of a segment.
    ///
    /// # Errors
    /// [`FrameFault::Corrupt`] for a segment that is too short or that a sequential Huffman-coded image cannot have.
    pub(super) fn read(&mut self, marker: u8, segment: &[u8]) -> Result<(), FrameFault> {
        let is_understood = match (marker, segment) {
            (marker::BASELINE | marker::EXTENDED_SEQUENTIAL, segment) => self.read_frame(segment).is_some(),
            (marker::HUFFMAN_TABLES, segment) => self.read_tables(segment).is_some(),
            (marker::RESTART_INTERVAL, [high, low]) => {
                self.restart_interval = u16::from_be_bytes([*high, *low]).into();
                true
            }
            (marker::RESTART_INTERVAL, _) => false,
            // Other kinds of frames, and markers without a segment.
            (marker, _) => marker > marker::START_OF_SCAN,
        };
        is_understood.then_some(()).ok_or(FrameFault::Corrupt)
    }

    fn read_frame(&mut self, segment: &[u8]) -> Option<()> {
        let (&[8, h1, h0, w1, w0, count], components) = segment.split_first_chunk()? else { return None };
        (count > 0).then_some(())?;
        self.size = [[w1, w0], [h1, h0]].map(|side| u16::from_be_bytes(side).into());
        self.components.clear();
        for component in components.chunks_exact(3).take(count.into()) {
            let &[id, sampling, _] = component else { return None };
            let factors = [sampling >> 4, sampling & 15].map(usize::from);
            factors.iter().all(|factor| (1..=4).contains(factor)).then_some(())?;
            self.components.push((id, factors)).ok()?;
        }
        (self.components.len() == usize::from(count)).then_some(())
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

    /// The scan of all components that a start-of-scan segment describes; `None` if it describes another one.
    pub(super) fn scan(&self, segment: &[u8]) -> Option<Scan> {
        let (count, selectors) = segment.split_first()?;
        let mut components = Vec::new();
        for (selector, (id, factors)) in selectors.chunks_exact(2).zip(&self.components) {
            let &[selected, tables] = selector else { return None };
            let [dc, ac] = [tables >> 4, tables & 15].map(usize::from);
            // A scan of one component has one block in each unit, whatever its sampling.
            let blocks = if self.components.len() == 1 { 1 } else { factors.iter().product() };
            (selected == *id).then_some(())?;
            components.push(Component { blocks, dc, ac }).ok()?;
        }
        let is_whole = components.len() == self.components.len() && components.len() == usize::from(*count);
        is_whole.then(|| Scan { components, units: self.units() })
    }

    /// The tables of a component for DC and AC coefficients.
    pub(super) fn tables_of(&self, component: &Component) -> Option<[&HuffmanTable; 2]> {
        let [dc, ac] = &self.tables;
        Some([dc.get(component.dc)?, ac.get(component.ac)?])
    }

    /// Number of minimum coded units in a scan of all components.
    fn units(&self) -> usize {
        let most = |axis: usize| match self.components.as_slice() {
            [_] => 1,
            components => components.iter().filter_map(|(_, factors)| factors.get(axis)).copied().max().unwrap_or(1),
        };
        let [width, height] = self.size;
        width.div_ceil(BLOCK_SIDE * most(0)) * height.div_ceil(BLOCK_SIDE * most(1))
    }
}
