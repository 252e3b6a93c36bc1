//! The wearer's neutral face, from which displacements are measured.

use thiserror::Error;

use super::{
    affine::Normalised,
    features::{FEATURES, measure},
};
use crate::face::LANDMARKS;

/// Largest coordinate of a stored neutral face, eye distances.
const MAX_COORDINATE: f32 = 10.0;

/// A neutral face that cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum NeutralError {
    /// No frame was added.
    #[error(
        "no face was seen while the neutral face was recorded; look at the camera and record again"
    )]
    NoFrames,
    /// A stored coordinate is not a number or not of a face.
    #[error("the stored neutral face is damaged; record it again")]
    Damaged,
}

/// The mean normalised face of a wearer at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Neutral {
    points: Box<[[f32; 3]; LANDMARKS]>,
    pub(super) features: Box<[f32; FEATURES]>,
}

impl Neutral {
    /// From stored points, in the basis of [`Normalised::points`].
    ///
    /// # Errors
    /// [`NeutralError::Damaged`] if a coordinate is not finite or far outside a face.
    pub fn from_points(points: &[[f32; 3]; LANDMARKS]) -> Result<Self, NeutralError> {
        if !points
            .iter()
            .flatten()
            .all(|value| value.abs() < MAX_COORDINATE)
        {
            return Err(NeutralError::Damaged);
        }
        Ok(Self {
            points: Box::new(*points),
            features: Box::new(measure(points)),
        })
    }

    /// The points, in the basis of [`Normalised::points`].
    #[must_use]
    pub fn points(&self) -> &[[f32; 3]; LANDMARKS] {
        &self.points
    }
}

/// Gathers frames of a face at rest into a [`Neutral`].
#[derive(Debug, Clone)]
pub struct NeutralMean {
    sums: Box<[[f64; 3]; LANDMARKS]>,
    frames: u32,
}

impl Default for NeutralMean {
    fn default() -> Self {
        Self {
            sums: Box::new([[0.0; 3]; LANDMARKS]),
            frames: 0,
        }
    }
}

impl NeutralMean {
    /// Adds a frame. Does not allocate.
    pub fn add(&mut self, face: &Normalised) {
        let sums = self.sums.iter_mut().flatten();
        sums.zip(face.points.iter().flatten())
            .for_each(|(sum, value)| *sum += f64::from(*value));
        self.frames = self.frames.saturating_add(1);
    }

    /// How many frames were added.
    #[must_use]
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// The mean of the frames.
    ///
    /// # Errors
    /// [`NeutralError::NoFrames`] if none was added.
    pub fn finish(&self) -> Result<Neutral, NeutralError> {
        if self.frames == 0 {
            return Err(NeutralError::NoFrames);
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32 values")]
        let mean = |sum: f64| (sum / f64::from(self.frames)) as f32;
        Neutral::from_points(&self.sums.map(|point| point.map(mean)))
    }
}
