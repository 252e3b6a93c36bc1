//! Which parts of a face are in view.
//!
//! A small network of facewire's own reads the feature map of the mesh network at its landmarks, which looks different where
//! something covers the face. `models/covered/train.py` makes it.

use crate::infer::{InferError, Network, built_in};
use crate::model::APPEARANCE_CHANNELS;

/// Number of regions.
pub const REGIONS: usize = 5;
pub(crate) const LEFT_EYE: usize = 0;
pub(crate) const RIGHT_EYE: usize = 1;
pub(crate) const BROWS: usize = 2;
pub(crate) const MOUTH: usize = 3;

/// For each region, the log-odds that it is in view: left eye, right eye, brows, mouth and jaw, cheeks and nose.
pub type InView = [f32; REGIONS];

/// Returns for each region the probability that it is in view. What is not a number becomes 0.
pub(crate) fn likely_in_view(odds: &InView) -> [f32; REGIONS] {
    odds.map(|odds| (1.0 / (1.0 + (-odds).exp())).max(0.0))
}

/// Returns the mean probability that eyes and brows are in view.
pub(crate) fn upper_half(likely: &[f32; REGIONS]) -> f32 {
    let [left_eye, right_eye, brows, ..] = likely;
    (left_eye + right_eye + brows) / 3.0
}

const FILE: &[u8] = include_bytes!("../../models/visible.fwnet");

/// The network.
pub struct Visible(Box<dyn Network>);

impl Visible {
    /// Loads the network.
    pub fn load() -> Result<Self, InferError> {
        Ok(Self(built_in(FILE)?))
    }

    /// Returns the log-odds that each region is in view, by the values of the feature map at its landmarks.
    pub fn read(&mut self, skin: &[[f32; APPEARANCE_CHANNELS]]) -> Result<InView, InferError> {
        let inputs = self.0.input_row(0).iter_mut().zip(skin.as_flattened());
        inputs.for_each(|(input, value)| *input = *value);
        self.0.run()?;
        let mut in_view = InView::default();
        in_view.iter_mut().zip(self.0.output(0)).for_each(|(odds, output)| *odds = *output);
        Ok(in_view)
    }
}
