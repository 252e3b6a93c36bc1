//! What a frame shows of the wearer, whether it meets the conditions of a take, and the hold: the part of a take in which
//! the wearer holds still and the frames are averaged.

use facewire_face::stages::{Coefficients, FaceMean, Features, Reference, keep_in_view, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, Camera, EyeValues, Face, HeadPose, Model, MouthValues, Neutral, Wears};
use facewire_packet::control::{Refusal, Take};

use super::take::{LIDS, Seen, Takes, expected, mean_of, strength};

/// How far the head may be turned from the camera in the neutral take (yaw, pitch, roll), and in the other takes from where
/// it was in the neutral one.
const FACING_DEG: [f32; 3] = [15.0, 20.0, 15.0];
const TURNED_DEG: f32 = 12.0;
/// Replaces [`FACING_DEG`] under a headset, where the angles may be wrong by 20 degrees or more.
const FACING_IN_HEADSET_DEG: [f32; 3] = [45.0, f32::MAX, f32::MAX];
/// Coefficients, measured from the mean of many people, above which a face is not at rest. Faces at rest stay below.
const SHUT: f32 = 0.65;
const SMILES: f32 = 0.5;
const OPEN: f32 = 0.4;

const LEAST_FRAMES: u32 = 3;
/// How far the head may turn during a hold, degrees.
const STILL_DEG: f32 = 4.0;
/// How far a coefficient of the resting face may move during the neutral take. Speech moves the mouth further.
const REST_MOVES: f32 = 0.25;
/// Change of the lids from which on a frame of the neutral take shows a blink.
const BLINK: f32 = 0.25;
/// Factor by which a pose may grow during a hold, and share of its peak below which it counts as released.
const GROWS: f32 = 1.2;
const RELEASED: f32 = 0.7;

/// What one frame shows of the wearer. Has a fixed size, so that it can be handed from thread to thread without allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    pub time_us: u64,
    /// The face, or what hinders every take: there is no picture, too little light, or no face that can be read.
    pub sight: Result<Seen, Refusal>,
}

impl Observation {
    /// There is no frame: the camera is silent or gone.
    pub fn nothing(time_us: u64) -> Self {
        Self { time_us, sight: Err(Refusal::NoPicture) }
    }

    /// Observes the face of a frame that was captured at `time_us`, `None` if the frame shows none. Does not allocate.
    pub fn new(model: &Model, face: Option<Face<'_>>, camera: &Camera, time_us: u64, is_dark: bool) -> Self {
        let seen = || face.and_then(|face| Seen::new(model, face, camera)).ok_or(Refusal::NoFace);
        Self { time_us, sight: if is_dark { Err(Refusal::TooDark) } else { seen() } }
    }
}

impl Seen {
    fn new(model: &Model, Face { landmarks, appearance }: Face<'_>, camera: &Camera) -> Option<Self> {
        let face = normalise(landmarks).ok()?;
        let head_deg = HeadPose::new(&face, camera).yaw_pitch_roll_deg();
        let residual = |known| Some(model.residual(appearance, known).ok()?.unwrap_or(Coefficients([0.0; COEFFS])));
        let eyes = appearance.map(|it| it.looks.eyes);
        let mouth = appearance.map(|it| it.looks.mouth);
        Some(Self { residuals: [residual(0.0)?, residual(1.0)?], eyes, mouth, face, head_deg })
    }

    /// What the regression and the pictures of the eyes give for this face, and under a headset the picture of the mouth. Without a
    /// neutral face it is measured from the mean of many people. `None` if the model makes nothing of it.
    pub fn raw(&self, model: &Model, neutral: Option<&Neutral>, wears: Wears) -> Option<[f32; COEFFS]> {
        let [unknown, known] = &self.residuals;
        let residual = if neutral.is_some() { known } else { unknown };
        let mut raw = model.process(&Features::new(&self.face, neutral)).ok()?.plus(residual);
        model.look(&mut raw, &Features::new(&self.face, Reference::MEAN), self.eyes.as_ref());
        keep_in_view(wears, &mut raw, self.mouth.as_ref());
        Some(raw.0)
    }
}

/// A face under fair conditions: its coefficients, and how strongly it shows the pose.
pub(super) struct View<'a> {
    pub(super) seen: &'a Seen,
    pub(super) coefficients: [f32; COEFFS],
    /// In this frame, and smoothed.
    pub(super) strength_now: f32,
    pub(super) strength: f32,
    /// Whether the angles of the head are right: under a headset they are not.
    has_true_angles: bool,
}

impl<'a> View<'a> {
    pub(super) fn new(model: &Model, takes: &Takes, take: Take, observation: &'a Observation) -> Result<Self, Refusal> {
        let seen = observation.sight.as_ref().map_err(|hindrance| *hindrance)?;
        let known = takes.neutral.as_ref().filter(|_| take != Take::Neutral);
        let has_true_angles = takes.wears != Wears::Headset;
        let facing_deg = if has_true_angles { FACING_DEG } else { FACING_IN_HEADSET_DEG };
        let (from, limits) = known.map_or(([0.0; 3], facing_deg), |known| (known.head_deg, [TURNED_DEG; 3]));
        let mut angles = seen.head_deg.iter().zip(from).zip(limits);
        // An angle that is not a number is refused, too.
        if !angles.all(|((angle, from), limit)| (angle - from).abs() <= limit) {
            return Err(Refusal::HeadTurned);
        }
        let coefficients = seen.raw(model, known.map(|known| &known.neutral), takes.wears).ok_or(Refusal::NoFace)?;
        let strength = known.map_or(0.0, |known| strength(take, &coefficients) - strength(take, &known.raw));
        Ok(Self { seen, coefficients, strength_now: strength, strength, has_true_angles })
    }

    /// Why the face is not what the take asks for. In the neutral take, it is measured from the mean of many people.
    pub(super) fn unfit(&self, take: Take) -> Option<Refusal> {
        let shows = |names: &[&str], limit: f32| mean_of(names, &self.coefficients) > limit;
        match take {
            Take::Neutral if shows(&LIDS, SHUT) => Some(Refusal::EyesShut),
            Take::Neutral if shows(expected(Take::Smile).raises, SMILES) => Some(Refusal::Smiling),
            Take::Neutral if shows(expected(Take::JawOpen).raises, OPEN) => Some(Refusal::MouthOpen),
            Take::Neutral => None,
            _ => (self.strength < expected(take).threshold).then_some(Refusal::NotSeen),
        }
    }

    pub(super) fn is_blink(&self, take: Take) -> bool {
        mean_of(&LIDS, &self.coefficients) > expected(take).lids
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    Belongs,
    /// The frame shows a blink and is left out.
    Blink,
    /// The hold begins anew with this frame, because the wearer was still moving into the pose.
    Anew,
    Broken(Refusal),
}

pub(super) struct Hold {
    faces: FaceMean,
    /// Sums over the frames.
    residuals: [[f32; COEFFS]; 2],
    eyes: Option<EyeValues>,
    mouth: Option<MouthValues>,
    coefficients: [f32; COEFFS],
    head_deg: [f32; 3],
    /// The angles of the head and the strength at the beginning, and the greatest strength since.
    first_head_deg: [f32; 3],
    begun: f32,
    peak: f32,
    held_s: f32,
    /// For how long the blink has lasted that the newest frames show.
    pub(super) blink_s: f32,
}

impl Hold {
    pub(super) fn begin(view: &View<'_>) -> Self {
        let mut hold = Self {
            faces: FaceMean::default(),
            residuals: [[0.0; COEFFS]; 2],
            eyes: view.seen.eyes.map(|_| EyeValues::default()),
            mouth: view.seen.mouth.map(|_| MouthValues::default()),
            coefficients: [0.0; COEFFS],
            head_deg: [0.0; 3],
            first_head_deg: view.seen.head_deg,
            begun: view.strength,
            peak: view.strength,
            held_s: 0.0,
            blink_s: 0.0,
        };
        hold.add(view, 0.0);
        hold
    }

    pub(super) fn add(&mut self, View { seen, coefficients, strength, .. }: &View<'_>, step_s: f32) {
        let add = |sums: &mut [f32], values: &[f32]| sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        self.faces.add(&seen.face);
        self.residuals.iter_mut().zip(&seen.residuals).for_each(|(sums, residual)| add(sums, &residual.0));
        self.eyes.iter_mut().zip(&seen.eyes).for_each(|(sums, eyes)| add(sums.as_flattened_mut(), eyes.as_flattened()));
        self.mouth.iter_mut().zip(&seen.mouth).for_each(|(sums, mouth)| add(sums, mouth));
        add(&mut self.coefficients, coefficients);
        add(&mut self.head_deg, &seen.head_deg);
        self.peak = self.peak.max(*strength);
        self.held_s += step_s;
        self.blink_s = 0.0;
    }

    pub(super) fn judge(&self, take: Take, view: &View<'_>) -> Fit {
        let mut angles = self.first_head_deg.iter().zip(view.seen.head_deg);
        let is_head_still = !view.has_true_angles || angles.all(|(before, now)| (now - before).abs() <= STILL_DEG);
        if take != Take::Neutral {
            return match view.strength {
                _ if view.is_blink(take) => Fit::Blink,
                _ if !is_head_still => Fit::Broken(Refusal::HeadMoves),
                strength if strength > GROWS * self.begun => Fit::Anew,
                strength if strength < RELEASED * self.peak => Fit::Broken(Refusal::TooShort),
                _ => Fit::Belongs,
            };
        }
        let before = self.coefficients.map(|sum| sum / self.faces.frames() as f32);
        let lids = mean_of(&LIDS, &view.coefficients) - mean_of(&LIDS, &before);
        let rests = |(name, _): &(&&str, _)| !name.starts_with("eye");
        let resting = BLENDSHAPES.iter().zip(view.coefficients.iter().zip(&before)).filter(rests);
        let moved = resting.map(|(_, (value, before))| (value - before).abs()).fold(0.0, f32::max);
        match is_head_still {
            _ if lids > BLINK => Fit::Blink,
            _ if lids < -BLINK => Fit::Anew,
            false => Fit::Broken(Refusal::HeadMoves),
            true if moved > REST_MOVES => Fit::Broken(Refusal::FaceMoves),
            true => Fit::Belongs,
        }
    }

    /// How much of a hold of `wanted_s` is done, 0 to 1.
    pub(super) fn done(&self, wanted_s: f32) -> f32 {
        let frames = self.faces.frames() as f32 / LEAST_FRAMES as f32;
        (self.held_s / wanted_s).min(frames).clamp(0.0, 1.0)
    }

    pub(super) fn finish(&self) -> Option<Seen> {
        let mean = |sum: f32| sum / self.faces.frames() as f32;
        let residuals = self.residuals.map(|sums| Coefficients(sums.map(mean)));
        let eyes = self.eyes.map(|sums| sums.map(|values| values.map(mean)));
        let mouth = self.mouth.map(|sums| sums.map(mean));
        Some(Seen { face: self.faces.finish()?, residuals, eyes, mouth, head_deg: self.head_deg.map(mean) })
    }
}
