//! What tracking a film gives, and how far it is from what the undisturbed film gives.

use facewire::capture::{Content, Frame};
use facewire::config::Settings;
use facewire::pipeline::Pipeline;
use facewire::watch::{FaceLook, Look, Watch};
use facewire_board::ImpairmentSet;
use facewire_face::{COEFFS, Camera, Face, Landmarks, MESH};

use super::photo::Photo;

/// A coefficient that deviates less than this does not move, and has no correlation.
const MOVES: f32 = 0.03;
/// Time for which an impairment must last. The shortest film has 2.4 s.
const HOLD_US: u64 = 2_000_000;
const PERIOD_US: usize = 33_333;

pub struct Track {
    /// Number of frames of the film from one frame of the track to the next.
    pub step: usize,
    pub coefficients: Vec<Option<[f32; COEFFS]>>,
    pub looks: Vec<Look>,
    /// The box around the face, or where it was last.
    pub boxes: Vec<[f32; 4]>,
    pub landmarks: Landmarks,
}

impl Track {
    pub fn of(photos: &[Photo], step: usize, alter: impl Fn(&Photo, usize) -> Photo) -> Self {
        let settings = Settings::default();
        let mut pipeline = Pipeline::load(&settings, true).unwrap_or_else(|error| panic!("{error}"));
        let (coefficients, looks, boxes) = (Vec::new(), Vec::new(), Vec::new());
        let mut track = Self { step, coefficients, looks, boxes, landmarks: Landmarks::zero() };
        for (number, photo) in photos.iter().enumerate() {
            let altered = alter(photo, number);
            let content = Content::Picture(altered.picture());
            let frame = Frame { content, captured_us: (number * step * PERIOD_US) as u64, number: number as u64 };
            let found = pipeline.find(&frame).unwrap();
            let (landmarks, appearance) = found.map(|face| (face.landmarks.clone(), face.appearance.cloned())).unzip();
            let camera = Camera::new(frame.size_px(), settings.camera.horizontal_fov_deg);
            let appearance = appearance.flatten();
            let face = landmarks.as_ref().map(|landmarks| Face { landmarks, appearance: appearance.as_ref() });
            let solution = face.and_then(|face| pipeline.solver.solve(face, &camera, frame.captured_us).ok());
            track.coefficients.push(solution.map(|solution| solution.smoothed.0));
            track.looks.push(Look::at(frame.picture().unwrap(), face));
            track.landmarks = landmarks.unwrap_or(track.landmarks);
            track.boxes.push(bounds(&track.landmarks));
        }
        track
    }

    pub fn told(&self) -> ImpairmentSet {
        let mut watch = Watch::new(HOLD_US);
        for (number, look) in self.looks.iter().enumerate() {
            watch.look(look, false, (number * self.step * PERIOD_US) as u64);
        }
        watch.present()
    }

    pub fn keeping(&self, mut keeps: impl FnMut(usize) -> bool) -> Self {
        let kept = self.coefficients.iter().enumerate().map(|(number, row)| row.filter(|_| keeps(number)));
        let (looks, boxes, landmarks) = (self.looks.clone(), self.boxes.clone(), self.landmarks.clone());
        Self { step: self.step, coefficients: kept.collect(), looks, boxes, landmarks }
    }

    /// The coefficients of each frame. A frame without a face repeats the last one.
    fn held(&self) -> Vec<[f32; COEFFS]> {
        let mut last = [0.0; COEFFS];
        let mut hold = |row: &Option<[f32; COEFFS]>| {
            last = row.unwrap_or(last);
            last
        };
        self.coefficients.iter().map(&mut hold).collect()
    }

    pub fn row(&self, whole: &Self) -> String {
        let r = agreement(whole, self);
        let brightness = mean(self.looks.iter().map(|look| look.picture.brightness));
        let face =
            |value: fn(&FaceLook) -> f32| mean(self.looks.iter().filter_map(|look| look.face.as_ref()).map(value));
        format!(
            "r {r:.3} | brightness {brightness:3.0} | face {:3.0}, around {:3.0}, \
             contrast {:4.1}, noise {:4.1}, {:3.0} px, {:.3}, cut off {:.2}, score {:4.1} | {}",
            face(|face| face.light.brightness),
            face(|face| face.surroundings),
            face(|face| face.light.contrast),
            face(|face| face.light.noise),
            face(|face| face.size_px),
            face(|face| face.size),
            face(|face| face.cut_off),
            face(|face| face.score),
            self.told(),
        )
    }
}

fn bounds(landmarks: &Landmarks) -> [f32; 4] {
    landmarks.0.iter().take(MESH).fold([f32::MAX, f32::MAX, f32::MIN, f32::MIN], |[left, top, right, bottom], point| {
        [left.min(point[0]), top.min(point[1]), right.max(point[0]), bottom.max(point[1])]
    })
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// Mean Pearson correlation of the coefficients that move in the undisturbed film, in this and in a disturbed one.
pub fn agreement(whole: &Track, poor: &Track) -> f32 {
    let [ours, theirs] = [whole, poor].map(Track::held);
    let pair = |index: usize| ours.iter().zip(&theirs).map(move |(a, b)| [a[index], b[index]]);
    mean((0..COEFFS).filter_map(|index| correlation(&pair(index).collect::<Vec<_>>())))
}

/// Pearson's correlation, or `None` if the first of the two does not move. It is 0 if only the second does not.
fn correlation(pairs: &[[f32; 2]]) -> Option<f32> {
    let means = [0, 1].map(|side: usize| mean(pairs.iter().map(|pair| pair[side])));
    let product = |one: usize, other: usize| {
        mean(pairs.iter().map(|pair| (pair[one] - means[one]) * (pair[other] - means[other])))
    };
    let [first, second] = [product(0, 0), product(1, 1)];
    (first.sqrt() > MOVES).then(|| product(0, 1) / (first * second).sqrt().max(f32::MIN_POSITIVE))
}
