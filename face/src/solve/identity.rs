//! Tells people apart by the rigid shape of their faces.
//!
//! Measures that expressions hardly change are averaged over 6 s of frames in which the head faces the camera, and compared
//! with their mean over the last minute. Widths and mean heights of pairs of landmarks do not depend on the head's yaw at
//! first order. What another distance to the camera does to them (scale and perspective) does not count as a difference.
//!
//! In films of 13 people, the distance of the same person is at most 2.8. When one takes the place of another, that is
//! noticed in 2 of 3 pairs within half a minute. Limits: people whose faces have similar proportions count as one person.

use super::Normalised;
use super::filter::{approach, difference};

const MOST_TURN: [f32; 2] = [0.26, 0.35];
/// Times over which the measures of the person in the picture and of the wearer are averaged, seconds.
const RECENT_S: f32 = 6.0;
const WEARER_S: f32 = 60.0;
/// An average counts as one over at least this time, seconds.
const LEAST_SUM_S: f32 = 0.1;
/// Time before the average of the person in the picture says something, seconds.
const LEAST_RECENT_S: f32 = 1.5;
/// A face farther away than `ANOTHER` for `ANOTHER_S` seconds is another person's; one farther than `DOUBTFUL` may be.
const ANOTHER: f32 = 3.3;
const ANOTHER_S: f32 = 1.5;
const DOUBTFUL: f32 = 2.5;

const X: usize = 0;
const Y: usize = 1;
const Z: usize = 2;

/// A measure of the rigid shape: the distance of two landmarks along x, or their mean along y or z.
struct Measure {
    landmarks: [usize; 2],
    axis: usize,
    /// Standard deviation of averages of the same person.
    deviation: f32,
    value: f32,
    /// Mean depth of the landmarks, by which perspective changes the measure.
    depth: f32,
}

/// Number of measures of a shape.
pub(crate) const SHAPE: usize = 14;
/// The measures that told people in films apart best. All lengths are eye distances.
#[rustfmt::skip]
const MEASURES: [Measure; SHAPE] = [
    Measure { landmarks: [389, 162], axis: X, deviation: 0.0151, value: 2.187, depth: -0.687 },
    Measure { landmarks: [288, 58], axis: Y, deviation: 0.0068, value: -1.074, depth: -0.751 },
    Measure { landmarks: [417, 193], axis: X, deviation: 0.0037, value: 0.248, depth: 0.233 },
    Measure { landmarks: [357, 128], axis: X, deviation: 0.0063, value: 0.455, depth: 0.154 },
    Measure { landmarks: [10, 10], axis: Z, deviation: 0.0132, value: 0.196, depth: 0.196 },
    Measure { landmarks: [293, 63], axis: X, deviation: 0.0140, value: 1.617, depth: 0.048 },
    Measure { landmarks: [4, 4], axis: Y, deviation: 0.0070, value: -0.509, depth: 0.684 },
    Measure { landmarks: [263, 33], axis: X, deviation: 0.0128, value: 1.436, depth: -0.050 },
    Measure { landmarks: [361, 132], axis: X, deviation: 0.0211, value: 2.057, depth: -0.849 },
    Measure { landmarks: [465, 245], axis: Y, deviation: 0.0051, value: -0.046, depth: 0.182 },
    Measure { landmarks: [251, 21], axis: X, deviation: 0.0140, value: 2.094, depth: -0.494 },
    Measure { landmarks: [361, 132], axis: Y, deviation: 0.0081, value: -0.799, depth: -0.849 },
    Measure { landmarks: [340, 111], axis: X, deviation: 0.0098, value: 1.827, depth: -0.137 },
    Measure { landmarks: [454, 234], axis: Z, deviation: 0.0138, value: -0.899, depth: -0.899 },
];

pub(crate) type Shape = [f32; SHAPE];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    Same,
    Doubtful,
    /// Another person's, who is the wearer from now on.
    Another,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Identity {
    recent: Average,
    wearer: Average,
    different_s: f32,
    /// Whether the face may be another person's since a gap. Until that is decided, the wearer's average stays.
    is_open: bool,
}

#[derive(Debug, Clone, Default)]
struct Average {
    shape: Shape,
    seconds: f32,
}

impl Identity {
    pub(super) fn gap(&mut self) {
        self.recent = Average::default();
        self.different_s = 0.0;
        self.is_open = self.wearer.seconds > 0.0;
    }

    pub(super) fn update(&mut self, face: &Normalised, dt_s: f32) -> Verdict {
        if !is_frontal(face) {
            return if self.different_s > 0.0 { Verdict::Doubtful } else { Verdict::Same };
        }
        let shape = shape(face);
        self.recent.add(&shape, dt_s, RECENT_S);
        if self.is_open && self.recent.seconds < LEAST_RECENT_S {
            return Verdict::Doubtful;
        }
        let distance = self.distance();
        if self.wearer.seconds <= 0.0 || distance <= ANOTHER {
            self.different_s = 0.0;
            self.is_open &= self.recent.seconds < RECENT_S;
            if !self.is_open {
                self.wearer.add(&shape, dt_s, WEARER_S);
            }
            return if distance <= DOUBTFUL { Verdict::Same } else { Verdict::Doubtful };
        }
        self.different_s += dt_s;
        if self.different_s < ANOTHER_S {
            return Verdict::Doubtful;
        }
        self.wearer = self.recent.clone();
        self.different_s = 0.0;
        self.is_open = false;
        Verdict::Another
    }

    /// Mean square difference of both averages, without what another distance to the camera explains, in units of the
    /// variance that it has for the same person: that of an average falls with its time.
    fn distance(&self) -> f32 {
        let mut difference = difference(self.recent.shape, self.wearer.shape);
        let scale = MEASURES.each_ref().map(|measure| measure.value / measure.deviation);
        let mut perspective = MEASURES.each_ref().map(|measure| measure.value * measure.depth / measure.deviation);
        remove(&mut perspective, &scale);
        remove(&mut difference, &scale);
        remove(&mut difference, &perspective);
        let [recent, wearer] = [&self.recent, &self.wearer].map(|average| average.seconds.max(LEAST_SUM_S));
        dot(&difference, &difference) / (SHAPE - 2) as f32 / (RECENT_S / recent + RECENT_S / wearer)
    }
}

impl Average {
    fn add(&mut self, shape: &Shape, dt_s: f32, longest_s: f32) {
        self.seconds = (self.seconds + dt_s).min(longest_s);
        // The first frame has no time step.
        let passed = if self.seconds > 0.0 { dt_s / self.seconds } else { 1.0 };
        approach(&mut self.shape, shape, passed);
    }
}

/// The measures in units of their deviations, of a face that faces the camera.
pub(crate) fn shape_of_frontal(face: &Normalised) -> Option<Shape> {
    is_frontal(face).then(|| shape(face))
}

fn is_frontal(face: &Normalised) -> bool {
    face.turns().iter().zip(MOST_TURN).all(|(turn, most)| turn.abs() <= most)
}

fn shape(face: &Normalised) -> Shape {
    MEASURES.each_ref().map(|Measure { landmarks, axis, deviation, .. }| {
        let [a, b] = landmarks
            .map(|landmark| face.points.get(landmark).and_then(|point| point.get(*axis)).copied().unwrap_or_default());
        (if *axis == X { a - b } else { 0.5 * (a + b) }) / deviation
    })
}

fn remove(vector: &mut Shape, along: &Shape) {
    let share = dot(vector, along) / dot(along, along);
    vector.iter_mut().zip(along).for_each(|(value, along)| *value -= share * along);
}

fn dot(a: &Shape, b: &Shape) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
