//! Tries which way a camera is mounted, by how surely the networks see an upright face after each turn of its pictures.
//!
//! The networks also find a face that is upside down, and give it wrong landmarks; [`Tracker::upright_score`] is then half of
//! that of the upright face.

use facewire_face::{InferError, Picture, Rotation, Tracker};

/// Pictures on which each turn is tried.
const ROUNDS: usize = 4;
/// Least mean score of a turn that is proposed. With the eyes covered, an upright face has 10.
const LEAST_SCORE: f32 = 8.0;
/// Least lead over the second best turn. With a mask over the mouth, an upright face leads by 3.6.
const LEAST_LEAD: f32 = 2.5;

#[derive(Debug, Clone, Copy, Default)]
pub struct MountTrial {
    sums: [f32; Rotation::ALL.len()],
    /// A round before the first face, in whatever direction, does not count.
    tries: usize,
}

impl MountTrial {
    /// Tries one turn on this picture, in about the time of two frames.
    pub fn add(&mut self, tracker: &mut Tracker, picture: &Picture) -> Result<(), InferError> {
        let turn = self.tries % self.sums.len();
        self.tries += 1;
        if let Some((rotation, sum)) = Rotation::ALL.into_iter().zip(&mut self.sums).nth(turn) {
            *sum += tracker.upright_score(&picture.rotated(rotation))?;
        }
        if self.tries == self.sums.len() && !self.has_seen_a_face() {
            self.tries = 0;
        }
        Ok(())
    }

    pub fn has_seen_a_face(&self) -> bool {
        self.sums.iter().any(|sum| *sum > 0.0)
    }

    pub fn is_complete(&self) -> bool {
        self.tries >= ROUNDS * self.sums.len()
    }

    /// The turn after which the face clearly stands upright, if there is one.
    pub fn best(&self) -> Option<Rotation> {
        let scores = self.sums.map(|sum| sum / ROUNDS as f32);
        let (best, score) =
            Rotation::ALL.into_iter().zip(scores).max_by(|(_, one), (_, other)| one.total_cmp(other))?;
        let rivals = scores.iter().filter(|other| score - **other < LEAST_LEAD).count();
        (score >= LEAST_SCORE && rivals == 1).then_some(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Clip, Source as _};
    use crate::config::NetworkSettings;
    use crate::pipeline::load_tracker;

    #[test]
    fn the_face_of_the_clip_is_upright_as_it_is() {
        let mut tracker = load_tracker(&NetworkSettings::default()).unwrap();
        let mut clip = Clip::once().unwrap();
        let mut trial = MountTrial::default();
        while !trial.is_complete() {
            let frame = clip.next().unwrap().unwrap();
            trial.add(&mut tracker, frame.picture().unwrap()).unwrap();
        }
        assert_eq!(trial.best(), Some(Rotation::None), "{trial:?}");
    }

    #[test]
    fn only_a_turn_that_is_clearly_better_than_all_others_is_proposed() {
        let best = |scores: [f32; 4]| MountTrial { sums: scores.map(|score| score * ROUNDS as f32), tries: 16 }.best();
        assert_eq!(best([11.0, 0.0, 25.0, 0.0]), Some(Rotation::Half));
        assert_eq!(best([0.0, 0.0, 0.0, 10.0]), Some(Rotation::ThreeQuarters));
        assert_eq!([[7.0, 0.0, 0.0, 0.0], [14.0, 0.0, 15.0, 0.0], [0.0; 4]].map(best), [None; 3]);
    }
}
