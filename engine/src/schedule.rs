//! In which order the layers compute strips of rows, and how many rows of each map must be kept.
//!
//! A strip is computed as late as possible: when the layer after it needs it. Maps that are read soon after they are
//! written then fit into the cache, and all but the last rows of a large map can be forgotten.

use std::ops::Range;

/// A layer, as far as its order matters.
#[derive(Debug, Clone)]
pub(crate) struct Rows {
    /// The maps that the layer reads.
    pub inputs: Vec<usize>,
    /// The map that the layer writes.
    pub output: usize,
    /// Rows of the output.
    pub height: usize,
    /// Rows of a strip.
    pub strip: usize,
    /// The input rows that a strip needs.
    pub needs: Needs,
}

/// The input rows that output rows need.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Needs {
    /// Every row of all inputs.
    All,
    /// Rows of a window of `size` rows, the first one `above` rows above the input.
    Window { size: usize, stride: usize, above: usize },
}

impl Needs {
    fn of(self, strip: &Range<usize>, rows: usize) -> Range<usize> {
        match self {
            Self::All => 0..rows,
            Self::Window { size, stride, above } => {
                let end = (strip.end - 1) * stride + size;
                (strip.start * stride).saturating_sub(above)..end.saturating_sub(above).min(rows)
            }
        }
    }
}

/// One strip of one layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Step {
    pub layer: usize,
    pub rows: Range<usize>,
}

/// The order of all strips, and the rows of each map that must be kept at a time.
#[derive(Debug)]
pub(crate) struct Schedule {
    pub steps: Vec<Step>,
    pub kept_rows: Vec<usize>,
}

impl Schedule {
    /// Orders the strips of `layers` so that the maps `wanted` are complete at the end. `maps` holds the number of rows
    /// of every map; a map that no layer writes is complete from the start. A map keeps all its rows, or a number of rows
    /// that is a multiple of `multiple` and of the strips in which the map is written. A strip must be a whole map, or its
    /// number of rows must be a divisor or a multiple of `multiple`.
    pub(crate) fn new(layers: &[Rows], maps: &[usize], wanted: &[usize], multiple: usize) -> Self {
        let mut order = Order { layers, maps, done: vec![0; layers.len()], steps: Vec::new() };
        for &map in wanted {
            order.require(map, maps[map]);
        }
        let mut kept_rows = order.kept_rows();
        for (map, kept) in kept_rows.iter_mut().enumerate() {
            let strip = layers.iter().find(|layer| layer.output == map).map_or(1, |layer| layer.strip);
            let rounded = kept.next_multiple_of(multiple.max(strip));
            let whole = wanted.contains(&map) || rounded >= maps[map];
            *kept = if whole { maps[map] } else { rounded };
        }
        Self { steps: order.steps, kept_rows }
    }
}

struct Order<'a> {
    layers: &'a [Rows],
    maps: &'a [usize],
    /// Rows that each layer has computed.
    done: Vec<usize>,
    steps: Vec<Step>,
}

impl Order<'_> {
    /// Computes the first `end` rows of a map.
    fn require(&mut self, map: usize, end: usize) {
        let Some(index) = self.layers.iter().position(|layer| layer.output == map) else { return };
        let layer = &self.layers[index];
        while self.done[index] < end {
            let start = self.done[index];
            let strip = start..(start + layer.strip).min(layer.height);
            for &input in &layer.inputs {
                self.require(input, layer.needs.of(&strip, self.maps[input]).end);
            }
            self.done[index] = strip.end;
            self.steps.push(Step { layer: index, rows: strip });
        }
    }

    /// For each map, the largest distance from the end of a strip back to the first row that is read at that time or
    /// later.
    fn kept_rows(&self) -> Vec<usize> {
        let mut first_needed = self.maps.to_vec();
        let mut kept = vec![0; self.maps.len()];
        for step in self.steps.iter().rev() {
            let layer = &self.layers[step.layer];
            let output = layer.output;
            kept[output] = kept[output].max(step.rows.end - first_needed[output].min(step.rows.start));
            for &input in &layer.inputs {
                let needed = layer.needs.of(&step.rows, self.maps[input]).start;
                first_needed[input] = first_needed[input].min(needed);
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three_by_three(input: usize, rows: usize, strip: usize, stride: usize) -> Rows {
        let needs = Needs::Window { size: 3, stride, above: 2 - stride };
        Rows { inputs: vec![input], output: input + 1, height: rows, strip, needs }
    }

    #[test]
    fn a_strip_runs_once_the_rows_it_reads_are_there_and_keeps_them_until_then() {
        let layers = [three_by_three(0, 12, 2, 1), three_by_three(1, 12, 2, 1), three_by_three(2, 6, 2, 2)];
        let maps = [12, 12, 12, 6];
        let schedule = Schedule::new(&layers, &maps, &[3], 2);
        let mut stored: Vec<Vec<Option<usize>>> = schedule.kept_rows.iter().map(|rows| vec![None; *rows]).collect();
        stored[0] = (0..12).map(Some).collect();
        for Step { layer, rows } in &schedule.steps {
            let layer = &layers[*layer];
            for input in &layer.inputs {
                for row in layer.needs.of(rows, maps[*input]) {
                    assert_eq!(stored[*input][row % stored[*input].len()], Some(row), "row of map {input}");
                }
            }
            for row in rows.clone() {
                let kept = stored[layer.output].len();
                stored[layer.output][row % kept] = Some(row);
            }
        }
        assert_eq!(stored[3], (0..6).map(Some).collect::<Vec<_>>());
        assert!(schedule.kept_rows[1] <= 6 && schedule.kept_rows[2] <= 8, "{:?}", schedule.kept_rows);
    }
}
