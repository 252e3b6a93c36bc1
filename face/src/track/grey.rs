//! Grey pictures of parts of a face, which small networks of facewire's own read.

use super::landmarks::FaceBox;
use super::{Block, Border, CropShape, Rows, crop};
use crate::infer::{InferError, Network};
use crate::picture::Picture;

/// What is added to the deviation of the brightness, so that noise in an even picture stays small.
const LEAST_CONTRAST: f32 = 4.0;

/// Takes square pictures of `side` rows and columns.
pub(super) struct GreyCamera {
    side: usize,
    samples: Samples,
}

struct Samples {
    values: Vec<f32>,
    row: usize,
}

impl Rows for Samples {
    fn row(&mut self, row: usize) -> &mut [f32] {
        self.values.get_mut(row * self.row..(row + 1) * self.row).unwrap_or_default()
    }
}

impl GreyCamera {
    pub(super) fn new(side: usize) -> Self {
        Self { side, samples: Samples { values: vec![0.0; 3 * side * side], row: 3 * side } }
    }

    /// Writes the brightness of each pixel of the place, 0 to 255, row by row.
    pub(super) fn take(&mut self, picture: &Picture, place: &FaceBox, block: &mut Block, pixels: &mut [f32]) {
        let shape = CropShape { side: self.side, range: [0.0, 255.0], border: Border::Replicate };
        crop(picture, place, shape, block, &mut self.samples);
        for (pixel, [red, green, blue]) in pixels.iter_mut().zip(self.samples.values.as_chunks().0) {
            // ITU-R BT.601.
            *pixel = (0.299 * red + 0.587 * green + 0.114 * blue).round();
        }
    }
}

/// Runs a network on a picture of `side` rows, which is made even in brightness and contrast.
pub(super) fn read<'a>(network: &'a mut dyn Network, pixels: &[f32], side: usize) -> Result<&'a [f32], InferError> {
    let count = pixels.len() as f32;
    let mean = pixels.iter().sum::<f32>() / count;
    let squares = pixels.iter().map(|pixel| (pixel - mean).powi(2)).sum::<f32>();
    let scale = 1.0 / ((squares / count).sqrt() + LEAST_CONTRAST);
    for (number, row) in pixels.chunks_exact(side).enumerate() {
        let inputs = network.input_row(number).iter_mut().zip(row);
        inputs.for_each(|(input, pixel)| *input = (pixel - mean) * scale);
    }
    network.run()?;
    Ok(network.output(0))
}
