//! The mean of some normalised faces.

use super::affine::Normalised;

/// Averages normalised faces.
#[derive(Debug, Clone, Default)]
pub struct FaceMean {
    /// Sums of all numbers of the faces.
    sums: Option<Box<Normalised>>,
    frames: u32,
}

impl FaceMean {
    /// Adds a face. Allocates only for the first.
    pub fn add(&mut self, face: &Normalised) {
        self.frames = self.frames.saturating_add(1);
        let Some(sums) = &mut self.sums else {
            self.sums = Some(Box::new(face.clone()));
            return;
        };
        sums.points
            .as_flattened_mut()
            .iter_mut()
            .zip(face.points.as_flattened())
            .for_each(|(sum, value)| *sum += value);
        sums.rotation += face.rotation;
        sums.scale_px += face.scale_px;
        sums.origin_px.iter_mut().zip(face.origin_px).for_each(|(sum, value)| *sum += value);
    }

    /// Number of faces.
    #[must_use]
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Returns the mean, or `None` if no face was added.
    #[must_use]
    pub fn finish(&self) -> Option<Normalised> {
        let mut mean = Normalised::clone(self.sums.as_ref()?);
        let count = self.frames as f32;
        mean.points.as_flattened_mut().iter_mut().for_each(|value| *value /= count);
        mean.rotation /= count;
        mean.scale_px /= count;
        mean.origin_px.iter_mut().for_each(|value| *value /= count);
        Some(mean)
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{Features, normalise, test_face::face};

    #[test]
    fn mean_of_two_faces_lies_half_way() {
        let [a, b] = [10.0, -2.0].map(|yaw| normalise(&face([yaw, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face"));
        let mut mean = FaceMean::default();
        assert!(mean.finish().is_none());
        mean.add(&a);
        mean.add(&b);
        let mean = mean.finish().expect("two faces");
        let [a, b, mean] = [&a, &b, &mean].map(|face| Features::new(face, None).values().to_vec());
        let half_way = a.iter().zip(&b).map(|(a, b)| (a + b) / 2.0);
        assert!(half_way.zip(&mean).all(|(want, got)| (want - got).abs() < 1e-5));
        assert!(a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 0.1));
    }
}
