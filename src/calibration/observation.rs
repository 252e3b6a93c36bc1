//! What one frame shows of the wearer.

use crate::face::Face;
use crate::solve::{COEFFS, Camera, FaceMean, Features, HeadPose, Model, Neutral, Normalised, Residual, normalise};

/// What one frame shows of the wearer. Has a fixed size, so that it can be handed from thread to thread without allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// When the frame was captured.
    pub time_us: u64,
    /// Whether the light is too poor for a calibration.
    pub is_dark: bool,
    /// The face, or what there is instead.
    pub sight: Sight,
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "observations live in a triple buffer, none on the heap")]
pub enum Sight {
    /// There is no frame: the camera is silent or gone.
    NoPicture,
    /// The frame shows no face, or none that can be read.
    NoFace,
    /// A face.
    Face(Seen),
}

/// A face as it was seen, without a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// The face in its own basis.
    pub face: Normalised,
    /// What the look of the face adds to the coefficients: first while the neutral face is unknown, then once it is
    /// known.
    pub residuals: [Residual; 2],
    /// Yaw, pitch and roll of the head.
    pub head_deg: [f32; 3],
}

impl Observation {
    /// A time without a frame.
    #[must_use]
    pub fn nothing(time_us: u64) -> Self {
        Self { time_us, is_dark: false, sight: Sight::NoPicture }
    }

    /// Observes the face of a frame that was captured at `time_us`, `None` if the frame shows none. Does not allocate.
    #[must_use]
    pub fn new(model: &Model, face: Option<Face<'_>>, camera: &Camera, time_us: u64, is_dark: bool) -> Self {
        let seen = face.and_then(|face| Seen::new(model, face, camera));
        Self { time_us, is_dark, sight: seen.map_or(Sight::NoFace, Sight::Face) }
    }
}

impl Observation {
    /// Whether the frame shows a face that can be read.
    #[must_use]
    pub fn shows_face(&self) -> bool {
        matches!(self.sight, Sight::Face(_))
    }
}

impl Seen {
    fn new(model: &Model, Face { landmarks, appearance }: Face<'_>, camera: &Camera) -> Option<Self> {
        let face = normalise(landmarks).ok()?;
        let head = HeadPose::new(&face, camera);
        let residual = |known| model.residual(appearance, known);
        let nothing = Residual([0.0; COEFFS]);
        let residuals = [residual(0.0).ok()?.unwrap_or(nothing), residual(1.0).ok()?.unwrap_or(nothing)];
        Some(Self { face, residuals, head_deg: [head.yaw_deg, head.pitch_deg, head.roll_deg] })
    }

    /// Output of the regression for this face. Without a neutral face it is measured from the mean of many people. `None`
    /// if the model makes nothing of it.
    #[must_use]
    pub fn raw(&self, model: &Model, neutral: Option<&Neutral>) -> Option<[f32; COEFFS]> {
        let [unknown, known] = &self.residuals;
        let raw = model.process(&Features::new(&self.face, neutral)).ok()?;
        Some(raw.plus(if neutral.is_some() { known } else { unknown }).0)
    }
}

/// Averages faces as they were seen.
#[derive(Debug, Clone)]
pub(super) struct SeenMean {
    faces: FaceMean,
    /// Sums over the faces.
    residuals: [Residual; 2],
    head_deg: [f32; 3],
}

impl Default for SeenMean {
    fn default() -> Self {
        Self { faces: FaceMean::default(), residuals: [Residual([0.0; COEFFS]); 2], head_deg: [0.0; 3] }
    }
}

impl SeenMean {
    pub(super) fn add(&mut self, seen: &Seen) {
        self.faces.add(&seen.face);
        for (sums, residual) in self.residuals.iter_mut().zip(&seen.residuals) {
            sums.0.iter_mut().zip(&residual.0).for_each(|(sum, value)| *sum += value);
        }
        self.head_deg.iter_mut().zip(seen.head_deg).for_each(|(sum, value)| *sum += value);
    }

    pub(super) fn frames(&self) -> u32 {
        self.faces.frames()
    }

    /// Returns the mean, or `None` if there was no face.
    pub(super) fn finish(&self) -> Option<Seen> {
        let count = self.frames() as f32;
        let residuals = self.residuals.map(|sums| Residual(sums.0.map(|sum| sum / count)));
        Some(Seen { face: self.faces.finish()?, residuals, head_deg: self.head_deg.map(|sum| sum / count) })
    }
}
