//! The wearer's neutral face, from which displacements are measured.

use super::{SolveError, affine::Normalised, canonical::RIGID, features::measure};
use crate::model::MEASURES;
use crate::track::LANDMARKS;

/// Largest coordinate of a face, eye distances. Faces stay below 3.
const MAX_COORDINATE: f32 = 10.0;
/// Largest root-mean-square distance of the rigid points from those of the mean face, eye distances. That of a face that
/// was just normalised stays below 0.15.
const MAX_MISFIT: f64 = 0.4;

/// The neutral face of a wearer: the mean normalised face at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Neutral {
    pub(super) measures: Box<[f32; MEASURES]>,
}

impl Neutral {
    /// Measures a face whose points are in the basis of [`Normalised::points`].
    ///
    /// # Errors
    /// [`SolveError::NoMean`] if a coordinate is not finite, or larger than that of any face.
    pub fn from_points(points: &[[f32; 3]; LANDMARKS]) -> Result<Self, SolveError> {
        if !points.iter().flatten().all(|value| value.abs() < MAX_COORDINATE) {
            return Err(SolveError::NoMean);
        }
        Ok(Self { measures: Box::new(measure(points)) })
    }

    /// Like [`Neutral::from_points`], for points whose source is not trusted.
    /// The rigid points must be where those of a normalised face are.
    pub fn of_face(points: &[[f32; 3]; LANDMARKS]) -> Result<Self, SolveError> {
        let squared = |(index, canonical): &(usize, [f64; 3])| {
            let point = points.get(*index).copied().unwrap_or_default();
            point.iter().zip(canonical).map(|(seen, want)| (f64::from(*seen) - want).powi(2)).sum::<f64>()
        };
        let misfit = RIGID.iter().map(squared).sum::<f64>() / RIGID.len() as f64;
        if misfit.sqrt() <= MAX_MISFIT { Self::from_points(points) } else { Err(SolveError::NoMean) }
    }

    /// The points of the face, in the basis of [`Normalised::points`].
    pub fn points(&self) -> impl Iterator<Item = [f32; 3]> {
        self.measures.as_chunks().0.iter().take(LANDMARKS).copied()
    }
}

/// Averages frames of a face at rest into a [`Neutral`].
#[derive(Debug, Clone)]
pub struct NeutralMean {
    sums: Box<[[f64; 3]; LANDMARKS]>,
    frames: u32,
}

impl Default for NeutralMean {
    fn default() -> Self {
        Self { sums: Box::new([[0.0; 3]; LANDMARKS]), frames: 0 }
    }
}

impl NeutralMean {
    /// Adds a frame. Does not allocate.
    pub fn add(&mut self, face: &Normalised) {
        let sums = self.sums.iter_mut().flatten();
        sums.zip(face.points.iter().flatten()).for_each(|(sum, value)| *sum += f64::from(*value));
        self.frames = self.frames.saturating_add(1);
    }

    /// Returns the mean of the frames.
    pub fn finish(&self) -> Result<Neutral, SolveError> {
        if self.frames == 0 {
            return Err(SolveError::NoFrames);
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32 values")]
        let mean = |sum: f64| (sum / f64::from(self.frames)) as f32;
        Neutral::from_points(&self.sums.map(|point| point.map(mean)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::normalise;
    use crate::testing::face;

    #[test]
    fn mean_of_two_frames_lies_half_way() {
        let mut frames = [0, 1].map(|_| normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face"));
        (frames[0].points[13], frames[1].points[13]) = ([0.1, 0.2, 0.3], [0.3, 0.4, 0.7]);
        let mut mean = NeutralMean::default();
        assert_eq!(mean.finish(), Err(SolveError::NoFrames));
        for frame in &frames {
            mean.add(frame);
        }
        let mut half_way = frames[0].points;
        half_way[13] = [0.2, 0.3, 0.5];
        let (mean, want) = (mean.finish().expect("two frames").measures, measure(&half_way));
        assert!(mean.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(mean.iter().zip(&measure(&frames[0].points)).any(|(a, b)| (a - b).abs() > 0.05));
    }

    #[test]
    fn coordinate_that_no_face_has_is_refused() {
        for value in [f32::NAN, f32::INFINITY, 1e6] {
            let mut points = [[0.0; 3]; LANDMARKS];
            points[477][2] = value;
            assert_eq!(Neutral::from_points(&points), Err(SolveError::NoMean));
        }
    }
}
