//! Which parts of a face are in view.
//!
//! A small network of facewire's own reads the feature map of the mesh network at its landmarks, which looks different where
//! something covers the face. `models/parts/train.py` makes it.

use crate::LANDMARKS;
use crate::infer::{InferError, Network, built_in};
use crate::model::APPEARANCE_CHANNELS;

/// Number of regions.
pub const REGIONS: usize = 5;
pub(crate) const LEFT_EYE: usize = 0;
pub(crate) const RIGHT_EYE: usize = 1;
pub(crate) const BROWS: usize = 2;
pub(crate) const MOUTH: usize = 3;
pub(crate) const CHEEKS: usize = 4;
/// What lies between the eyes, which is in view if both are. It is no region of its own.
pub(crate) const BRIDGE: usize = 5;

/// For each region, the log-odds that it is in view: left eye, right eye, brows, mouth and jaw, cheeks and nose.
pub type InView = [f32; REGIONS];

/// The region of each landmark, by the place of that landmark in the mean face.
const REGION_OF: &[u8; LANDMARKS] = b"\
    344544515223333333344211111221113141433333334424444422221334433242222222333433343333333333333443\
    344444422232221111144444115414441414314334343444113433323111411111413343533331533433333333345113\
    353555433334343334333333344441222114111111444444444115115042000002220030404333333344244444222203\
    344332422222223334333433333333333334334444442223222000004404400540444040430433434344400343330000\
    0000040343333305343333333334500335354334343334333333344440222004000000444444444005001111100000";

/// The region of a landmark.
pub(crate) fn region_of(landmark: usize) -> usize {
    REGION_OF.get(landmark).map_or(CHEEKS, |digit| usize::from(digit - b'0'))
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
