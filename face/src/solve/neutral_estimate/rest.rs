//! How sure it is that a face is at rest.
//!
//! At rest, the model reads about 0 even of a face that it does not know: in films of 20 people, the root sum square of
//! the outputs is at most 0.15 at rest, and rarely below 0.4 otherwise. On real faces at rest it is about 0.1.

use crate::solve::{COEFFS, affine::Normalised};

/// Sines of yaw and pitch at which a face no longer counts as frontal. A camera is often above or below the face.
const MOST_TURN: [f32; 2] = [0.3, 0.4];
/// Root sum square of the outputs at which a face no longer counts as at rest.
const MOST_OUTPUT: f32 = 0.45;
/// Output of `eyeBlink` at which an eye no longer counts as open.
const MOST_SHUT: f32 = 0.3;
/// Least weight that counts. Frames with a lower weight are ignored, because many of them would add up: a speaking mouth
/// comes close to rest again and again.
const LEAST_WEIGHT: f32 = 0.05;
/// `eyeBlinkLeft` and `eyeBlinkRight`.
const LIDS: [usize; 2] = [0, 7];
/// Distance of the outputs from their recent average at which a face no longer counts as still.
const MOST_MOTION: f32 = 0.2;
/// Time constant of that average, seconds.
const RECENT_S: f32 = 0.3;
/// Time after which 63 % of a motion is forgotten, seconds. A mouth that speaks passes its average again and again.
const CALM_S: f32 = 0.8;

/// The recent outputs.
#[derive(Debug, Clone, Default)]
pub(super) struct RestWatch {
    recent: Option<[f32; COEFFS]>,
    motion: f32,
}

impl RestWatch {
    /// Returns from 0 to 1 how sure it is that this face is at rest, `dt_s` seconds after the last one.
    pub(super) fn weight(&mut self, face: &Normalised, outputs: &[f32; COEFFS], dt_s: f32) -> f32 {
        let motion = self.motion(outputs, dt_s);
        let [yaw, pitch] = face.turns();
        let output = strength(outputs);
        let shut = LIDS.iter().filter_map(|lid| outputs.get(*lid)).fold(0.0, |most: f32, lid| most.max(*lid));
        let parts = [
            (yaw, MOST_TURN[0]),
            (pitch, MOST_TURN[1]),
            (output, MOST_OUTPUT),
            (shut, MOST_SHUT),
            (motion, MOST_MOTION),
        ];
        let weight = parts.iter().map(|(value, most)| sureness(value / most)).product();
        if weight < LEAST_WEIGHT { 0.0 } else { weight }
    }

    /// The largest recent distance of the outputs from their average, which fades. The first frame counts as moving.
    fn motion(&mut self, outputs: &[f32; COEFFS], dt_s: f32) -> f32 {
        let Some(recent) = &mut self.recent else {
            self.recent = Some(*outputs);
            return MOST_MOTION;
        };
        let passed = 1.0 - (-dt_s / RECENT_S).exp();
        let mut squares = 0.0;
        for (recent, output) in recent.iter_mut().zip(outputs) {
            let difference = output - *recent;
            squares += difference * difference;
            *recent += passed * difference;
        }
        self.motion = squares.sqrt().max(self.motion * (-dt_s / CALM_S).exp());
        self.motion
    }
}

/// Returns from 0 to 1 how far a face with these outputs can be taken as neutral.
pub(super) fn quality(outputs: &[f32; COEFFS]) -> f32 {
    let ratio = strength(outputs) / MOST_OUTPUT;
    (1.0 - ratio * ratio).max(0.0)
}

/// Root sum square of the outputs. Those below 0 are no expression.
fn strength(outputs: &[f32; COEFFS]) -> f32 {
    outputs.iter().map(|value| value.max(0.0).powi(2)).sum::<f32>().sqrt()
}

/// From 1 at 0 to 0 at 1 and beyond, smoothly.
fn sureness(ratio: f32) -> f32 {
    (1.0 - ratio * ratio).max(0.0).powi(3)
}
