//! From the landmarks of a frame to its coefficients and the head's pose: every stage in order.
//!
//! Each part of a running solver can be replaced while the others, and the history of the filters, keep their values.

use facewire_packet::{NeutralFace, Pose, Visibility};
use thiserror::Error;

use super::{
    Adjustments, COEFFS, Camera, Coefficients, Features, Filters, FiltersState, HeadPose, Model, Neutral, NeutralMode,
    Reference, Rules, correct,
    gaze::Offset,
    halves::{Half, half_of},
    mirror_image,
    neutral_estimate::NeutralEstimate,
    normalise,
    output::Crossfade,
    plausible::GazeState,
    turned,
    view::View,
};
use crate::track::{Appearance, Face};

/// Share of the wearer's own face in the reference from which on the neutral face counts as estimated.
const ESTIMATED: f32 = 0.25;

/// The results of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Output of the regression.
    pub raw: Coefficients,
    /// Coefficients after the corrective terms.
    pub corrected: Coefficients,
    /// Coefficients after the rules of anatomy, the filters and the adjustments: these are sent.
    pub smoothed: Coefficients,
    /// Pose of the head as it was seen.
    pub raw_head: HeadPose,
    /// Pose of the head after filter and adjustments: this is sent.
    pub head: HeadPose,
    /// The neutral face from which the coefficients are measured.
    pub neutral_face: NeutralFace,
    /// How much of each part of the face is in view. Left and right are those of the coefficients.
    pub visibility: Visibility,
    /// Whether the face is turned so far from the camera that its pose and coefficients are not to be trusted.
    pub is_turned_away: bool,
}

impl From<&Solution> for Pose {
    fn from(solution: &Solution) -> Self {
        let Solution { smoothed, head, neutral_face, visibility, .. } = *solution;
        let HeadPose { rotation_xyzw: rotation, position_mm } = head;
        Self { rotation, position_mm, coefficients: smoothed.0, neutral_face, visibility }
    }
}

/// Why landmarks give no solution. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the messages say it")]
#[non_exhaustive]
pub enum SolveError {
    #[error("a landmark is not a number; the landmark network or its input is damaged")]
    NotFinite,
    #[error("the face is too small to be read; move closer or choose a larger picture")]
    TooSmall,
    #[error("the landmarks do not form a face; check the picture for glare or covering")]
    NotAFace,
    #[error("the blendshape model gave a value that no face has; leave solver.model empty for the built-in model")]
    Absurd,
    #[error("none of these frames shows a face; give frames in which the wearer looks at the camera")]
    NoFrames,
    #[error("the mean of these frames is not a face; give frames in which the wearer looks at the camera")]
    NoMean,
}

/// Turns landmarks into coefficients and remembers what its filters need between frames.
#[derive(Debug)]
#[allow(missing_docs, reason = "the types say it")]
pub struct Solver {
    model: Model,
    pub profile: Profile,
    pub shaping: Shaping,
    /// What is done about the neutral face while the profile has none.
    pub neutral_mode: NeutralMode,
    wears: Wears,
    /// The distance between the wearer's pupils, above 0: positions of the head are in proportion to it.
    pub eye_distance_mm: f32,
    history: History,
}

/// What the wearer has on the face.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wears {
    /// Nothing that covers a part of it for long.
    #[default]
    Nothing,
    /// A headset over eyes and brows.
    Headset,
    /// A mask over mouth and nose.
    Mask,
}

impl Wears {
    /// Every kind with its name in settings and profiles.
    pub const NAMES: &[(&str, Self)] = &[("nothing", Self::Nothing), ("headset", Self::Headset), ("mask", Self::Mask)];

    /// Its name in settings and profiles.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, wears)| *wears == self).map_or("", |(name, _)| name)
    }
}

/// What is known of the wearer. The default is a wearer of whom nothing is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Profile {
    /// The neutral face, from which displacements are measured; `None` measures from the mean of many people.
    pub neutral: Option<Neutral>,
    /// The output of the regression, plus the model's shift, for the face at rest; 0 where unknown.
    pub rest: [f32; COEFFS],
    /// The factor that brings the wearer's full expression to the full range; 1 where unknown.
    pub gain: [f32; COEFFS],
    /// What the wearer had on the face when this was learned.
    pub wears: Wears,
}

impl Profile {
    /// A wearer of whom nothing is known.
    const UNKNOWN: Self = Self { neutral: None, rest: [0.0; COEFFS], gain: [1.0; COEFFS], wears: Wears::Nothing };

    /// Whether it holds for a wearer who has this on the face. What is known of a bare face holds under a mask, too. A headset
    /// hides the landmarks that a bare face is measured from; the mouth is then read from its picture.
    #[must_use]
    pub fn fits(&self, wears: Wears) -> bool {
        self.wears == wears || (self.wears == Wears::Nothing && wears == Wears::Mask)
    }

    /// What it says of a wearer who has this on the face.
    fn or_unknown(&self, wears: Wears) -> &Self {
        if self.fits(wears) { self } else { &Self::UNKNOWN }
    }
}

/// A wearer of whom the neutral face alone is known.
impl From<Neutral> for Profile {
    fn from(neutral: Neutral) -> Self {
        Self { neutral: Some(neutral), ..Self::default() }
    }
}

impl Default for Profile {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

/// What settings make of corrected coefficients and of the head's pose.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the types say it")]
#[non_exhaustive]
pub struct Shaping {
    pub rules: Rules,
    pub filters: Filters,
    pub adjustments: Adjustments,
}

impl Shaping {
    /// Filters alone.
    pub fn only(filters: Filters) -> Self {
        Self { rules: Rules::OFF, filters, adjustments: Adjustments::default() }
    }
}

#[derive(Debug, Default)]
struct History {
    view: View,
    estimate: NeutralEstimate,
    gaze_offset: Offset,
    gaze: GazeState,
    away: turned::Away,
    filters: FiltersState,
    crossfade: Crossfade,
    last_us: Option<u64>,
}

impl Solver {
    /// A solver that has not seen any frame.
    pub fn new(model: Model, profile: Profile, shaping: Shaping) -> Self {
        Self {
            model,
            profile,
            shaping,
            neutral_mode: NeutralMode::Off,
            wears: Wears::default(),
            eye_distance_mm: HeadPose::EYE_DISTANCE_MM,
            history: History::default(),
        }
    }

    /// Solves the face of a frame that `camera` captured at `time_us`. Does not allocate.
    pub fn solve<'a>(
        &mut self,
        face: impl Into<Face<'a>>,
        camera: &Camera,
        time_us: u64,
    ) -> Result<Solution, SolveError> {
        let Face { landmarks, appearance } = face.into();
        let view = self.history.view.next(
            appearance.map(|appearance| &appearance.looks.in_view),
            self.wears,
            self.history.since_s(time_us).unwrap_or(0.0),
        );
        let counts = view.counts();
        let face = normalise(landmarks)?;
        // Without a picture, nothing counts as covered.
        let wears = appearance.map_or(Wears::Nothing, |_| self.wears);
        let profile = self.profile.or_unknown(wears);
        let calibrated = profile.neutral.as_ref().map(|neutral| Reference::between(neutral, 1.0));
        let reference = calibrated.unwrap_or_else(|| self.estimated());
        let known = reference.known;
        let from_mean = Features::from_mean(&face);
        let turns_deg = self.model.map_of_gaze(&from_mean);
        let mut raw = self.raw(&from_mean, reference, appearance)?;
        if let Some(Appearance { looks, .. }) = appearance {
            self.model.look(&mut raw, &from_mean, Some(&looks.eyes));
            counts.look_at_mouth(&mut raw, &looks.mouth);
        }
        let neutral_face = match calibrated {
            Some(_) => NeutralFace::Calibrated,
            None if reference.known.mean() >= ESTIMATED => NeutralFace::Estimated,
            None => NeutralFace::Mean,
        };
        // A rejected frame does not get here: the time of the filters goes on until the next good frame.
        let step_s = self.history.step_s(time_us);
        self.history.view = view;
        // Only what is in view is learned.
        let is_whole = counts.are_whole();
        let neutral_mode = match self.neutral_mode {
            NeutralMode::Auto if !is_whole => NeutralMode::Frozen,
            mode => mode,
        };
        if calibrated.is_none() {
            self.history.estimate.update(neutral_mode, &face, &raw, known, step_s);
        }
        if let Some(turns_deg) = turns_deg.filter(|_| is_whole) {
            self.history.gaze_offset.step(turns_deg, &mut raw, step_s);
        }
        let mut corrected = correct(&raw, &self.model.correction, profile);
        if profile.wears != Wears::Headset && counts.share_of_mouth_from_picture() > 0.0 {
            let without_profile = correct(&raw, &self.model.correction, &Profile::UNKNOWN);
            counts.leave_mouth_from_picture_to(&without_profile, &mut corrected);
        }
        counts.rest(&mut corrected);
        let raw_head = HeadPose::new(&face, camera).with_eye_distance(self.eye_distance_mm);
        let Shaping { rules, filters, adjustments } = &self.shaping;
        let history = &mut self.history;
        let [yaw_deg, ..] = raw_head.yaw_pitch_roll_deg();
        let is_turned_away = history.away.step(yaw_deg, step_s);
        let mut plausible = rules.step(&mut history.gaze, corrected, step_s);
        turned::fade(&mut plausible.0, yaw_deg);
        let (mut smoothed, mut head) = filters.step(&mut history.filters, &plausible, &raw_head, step_s);
        rules.close_mouth(&mut smoothed.0);
        adjustments.apply(&mut smoothed.0);
        let mut visibility = view.visibility();
        if adjustments.mirror {
            visibility = visibility.mirrored();
            (head.rotation_xyzw, head.position_mm) = mirror_image(head.rotation_xyzw, head.position_mm);
        }
        history.crossfade.step(&mut smoothed, &mut head, step_s);
        adjustments.limit(&mut smoothed.0);
        Ok(Solution { raw, corrected, smoothed, raw_head, head, neutral_face, visibility, is_turned_away })
    }

    /// Computes the coefficients of a face whose halves may be known unlike.
    fn raw(
        &self,
        from_mean: &Features,
        reference: Reference,
        appearance: Option<&Appearance>,
    ) -> Result<Coefficients, SolveError> {
        // What is known of eyes and brows alone would mislead the regression of the mouth.
        let mut raw = self.model.solve(from_mean, reference.of_lower_half())?;
        if reference.known.upper > reference.known.lower {
            // If it misleads it beyond all bounds, nothing is taken from it.
            let upper = self.model.solve(from_mean, reference).unwrap_or(raw);
            for (place, (value, upper)) in raw.0.iter_mut().zip(upper.0).enumerate() {
                if half_of(place) == Half::Upper {
                    *value = upper;
                }
            }
        }
        let residual = self.model.residual_by_halves(appearance, reference.known)?;
        Ok(residual.map_or(raw, |residual| raw.plus(&residual)))
    }

    /// The estimated neutral face, as far as the model can measure from it.
    fn estimated(&self) -> Reference<'_> {
        self.model.reference_for(self.history.estimate.reference())
    }

    /// Sets what the wearer has on the face. The output does not jump.
    pub fn set_wears(&mut self, wears: Wears) {
        if self.wears != wears {
            self.wears = wears;
            self.crossfade();
        }
    }

    /// Forgets the wearer and all frames, but not the profile. Does not allocate.
    pub fn forget(&mut self) {
        let History { view, estimate, gaze_offset, gaze, away, filters, crossfade, last_us } = &mut self.history;
        estimate.reset();
        (*view, *gaze_offset, *gaze, *away) = Default::default();
        (*filters, *crossfade, *last_us) = Default::default();
    }

    /// What the wearer has on the face.
    pub fn wears(&self) -> Wears {
        self.wears
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Replaces the model. The new one evaluates the learned face at rest again, and the gaze is learned anew. The output does
    /// not jump.
    pub fn set_model(&mut self, model: Model) {
        self.history.estimate.read_again(&model, self.neutral_mode);
        self.history.gaze_offset = Offset::default();
        self.model = model;
        self.crossfade();
    }

    /// Replaces the profile. The output does not jump.
    pub fn set_profile(&mut self, profile: Profile) {
        self.profile = profile;
        self.crossfade();
    }

    /// Makes the next output begin where the last one ended, after any part was replaced.
    pub fn crossfade(&mut self) {
        self.history.crossfade.is_due = true;
    }

    /// Share of the estimated neutral face in the reference, from 0 to 1, in the mean of the upper and the lower half of the face.
    /// It is 0 with a calibrated one.
    pub fn neutral_share(&self) -> f32 {
        if self.profile.or_unknown(self.wears).neutral.is_some() { 0.0 } else { self.estimated().known.mean() }
    }

    /// What is known of the wearer now: the profile, or the estimated neutral face once it makes up at least half of the
    /// reference. `None` while there is neither.
    pub fn known_profile(&self) -> Option<Profile> {
        let estimated = || self.history.estimate.known();
        let profile = self.profile.or_unknown(self.wears);
        if profile.neutral.is_some() {
            return Some(profile.clone());
        }
        let neutral = estimated()?.clone();
        Some(Profile { neutral: Some(neutral), wears: self.wears, ..profile.clone() })
    }

    /// How often the estimate was forgotten, because another person sat down.
    pub fn neutral_forgotten(&self) -> u64 {
        self.history.estimate.forgotten
    }
}

impl History {
    /// Returns the seconds since the last frame that was filtered. `None` if there was none, or if the clock ran backwards.
    fn since_s(&self, time_us: u64) -> Option<f32> {
        let step_us = time_us.checked_sub(self.last_us?)?;
        Some(step_us as f32 / 1e6)
    }

    /// Returns the seconds since the last frame that was filtered, or 0 if they are not known, and then clears the history.
    fn step_s(&mut self, time_us: u64) -> f32 {
        let since_s = self.since_s(time_us);
        if since_s.is_none() {
            self.gaze = GazeState::default();
            self.filters = FiltersState::default();
            self.crossfade = Crossfade::default();
        }
        self.last_us = Some(time_us);
        since_s.unwrap_or(0.0)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::model::Regression;
    use crate::solve::halves::Halves;
    use crate::solve::plausible::JAW_OPEN;
    use crate::solve::{FilterKind, MAX_REST};
    use crate::testing::face;
    use crate::track::{LANDMARKS, Landmarks};

    const CAMERA: Camera = Camera { width_px: 640.0, height_px: 480.0, horizontal_fov_deg: 60.0 };
    const FRAME_US: u64 = 33_333;

    fn turned(yaw_deg: f32) -> Landmarks {
        face([yaw_deg, 0.0, 0.0], 80.0, [320.0, 240.0])
    }

    fn solver() -> Solver {
        let neutral = Neutral::from_points(&normalise(&turned(3.0)).expect("a face").points).ok();
        let shaping = Shaping::only(Filters::uniform(FilterKind::GatedAverage, 0.18));
        Solver::new(Model::embedded(), Profile { neutral, ..Profile::default() }, shaping)
    }

    /// A model with small weights. With larger ones, the solver finds no solution for the test's face, which is not that of a person.
    fn faint_model() -> Model {
        let mut model = Model::embedded();
        let Regression::HiddenLayer(layer) = &mut model.regression else { panic!("the shipped model is a layer") };
        layer.output.weights.iter_mut().for_each(|weight| *weight *= 1e-3);
        model
    }

    /// Solutions of a head that turns, 30 a second; `change` is called before frame 10.
    fn solutions(change: impl Fn(&mut Solver, &mut Camera)) -> Vec<Solution> {
        let mut solver = solver();
        let mut camera = CAMERA;
        let frame = |number: u16| {
            if number == 10 {
                change(&mut solver, &mut camera);
            }
            solver.solve(&turned(0.3 * f32::from(number)), &camera, FRAME_US * u64::from(number)).expect("a face")
        };
        (0..45).map(frame).collect()
    }

    #[test]
    fn replaced_parts_change_what_they_stand_for_and_keep_the_wearer_and_the_history() {
        let want = solutions(|_, _| ());
        let mut got = solutions(|solver, camera| {
            *camera = Camera::new([640.0, 480.0], 90.0);
            solver.model = Model::embedded();
            solver.shaping = Shaping::only(Filters::uniform(FilterKind::GatedAverage, 0.18));
        });
        assert_ne!(got[10].head.position_mm, want[10].head.position_mm);
        for (got, want) in got.iter_mut().zip(&want) {
            got.head.position_mm = want.head.position_mm;
            got.raw_head.position_mm = want.raw_head.position_mm;
        }
        assert_eq!(got, want);
        assert_ne!(want, solutions(|solver, _| solver.profile.rest = [MAX_REST; COEFFS]));
        assert_ne!(want, solutions(|solver, _| solver.history = History::default()));
    }

    #[test]
    fn what_was_learned_without_a_headset_says_nothing_with_one_and_the_other_way_round() {
        let seen = turned(3.0);
        let neutral = Neutral::from_points(&normalise(&seen).expect("a face").points).ok();
        let looks = Box::new(Appearance::zero());
        let shows = |profile: Profile, wears: Wears| {
            let mut solver = Solver::new(faint_model(), profile, Shaping::only(Filters::OFF));
            solver.set_wears(wears);
            let face = Face { landmarks: &seen, appearance: Some(&looks) };
            let Solution { corrected, neutral_face, .. } = solver.solve(face, &CAMERA, FRAME_US).expect("a face");
            (corrected, neutral_face, solver.neutral_share(), solver.known_profile().is_some())
        };
        let [nothing, headset, mask] = [Wears::Nothing, Wears::Headset, Wears::Mask];
        // So low a rest that every coefficient in view is raised by it.
        let learned =
            |wears| Profile { neutral: neutral.clone(), rest: [-MAX_REST; COEFFS], wears, ..Profile::default() };
        for [made, used] in [[nothing, headset], [headset, nothing], [mask, headset], [headset, mask], [mask, nothing]]
        {
            assert_eq!(shows(learned(made), used), shows(Profile::default(), used), "{made:?}, {used:?}");
        }
        let mut solver = Solver::new(faint_model(), learned(nothing), Shaping::only(Filters::OFF));
        solver.set_wears(nothing);
        assert!(!solver.history.crossfade.is_due);
        solver.set_wears(headset);
        assert!(solver.history.crossfade.is_due, "the output crossfades");
        let of_landmarks = solver.solve(&seen, &CAMERA, FRAME_US).expect("a face");
        assert_eq!(of_landmarks.neutral_face, NeutralFace::Calibrated, "landmarks alone do not tell what is covered");
        for [made, used] in [[nothing, nothing], [nothing, mask], [mask, mask], [headset, headset]] {
            let (corrected, neutral_face, _, is_known) = shows(learned(made), used);
            assert!(neutral_face == NeutralFace::Calibrated && is_known, "{made:?}, {used:?}");
            assert_ne!(corrected, shows(Profile::default(), used).0, "{made:?}, {used:?}");
        }
    }

    #[test]
    fn the_profile_of_a_bare_face_changes_no_mouth_that_is_read_from_its_picture_under_a_headset() {
        let seen = turned(3.0);
        let mut looks = Box::new(Appearance::zero());
        let mut jaw = |odds_of_upper_half: f32, profile: Profile| {
            looks.looks.in_view = [odds_of_upper_half, odds_of_upper_half, odds_of_upper_half, 8.0, 8.0];
            let mut solver = Solver::new(faint_model(), profile, Shaping::only(Filters::OFF));
            let face = Face { landmarks: &seen, appearance: Some(&looks) };
            solver.solve(face, &CAMERA, FRAME_US).expect("a face").corrected.0[JAW_OPEN]
        };
        let learned = Profile { rest: [-MAX_REST; COEFFS], gain: [2.0; COEFFS], ..Profile::default() };
        let [covered, partly, in_view] = [-8.0, -1.5, 8.0].map(|odds| {
            let learned = jaw(odds, learned.clone());
            learned - jaw(odds, Profile::default())
        });
        assert!(covered.abs() < 1e-3 && in_view > 0.1, "{covered} {in_view}");
        assert!(covered < partly && partly < in_view, "{covered} {partly} {in_view}");
    }

    #[test]
    fn what_is_known_of_eyes_and_brows_alone_changes_no_coefficient_of_the_mouth() {
        let seen = normalise(&turned(5.0)).expect("a face");
        let neutral = Neutral::from_points(&normalise(&turned(-5.0)).expect("a face").points).expect("a face");
        let shaping = Shaping::only(Filters::uniform(FilterKind::Off, 0.3));
        let solver = Solver::new(faint_model(), Profile::default(), shaping);
        let from_mean = Features::from_mean(&seen);
        let raw = |reference| solver.raw(&from_mean, reference, None).expect("coefficients").0;
        let unknown = raw(Reference::MEAN);
        let known = Halves { upper: 1.0, lower: 0.0 };
        let known = raw(Reference { known, ..Reference::between(&neutral, 1.0) });
        for (place, (known, unknown)) in known.iter().zip(&unknown).enumerate() {
            assert!(half_of(place) == Half::Upper || known == unknown, "{place}: {known} {unknown}");
        }
        assert_ne!(known, unknown);
    }

    #[test]
    fn replaced_filters_make_no_step_once_they_are_crossfaded_and_the_difference_fades_within_a_second() {
        for kind in [FilterKind::Off, FilterKind::LowPass, FilterKind::OneEuro, FilterKind::MovingAverage] {
            let [jump, faded] = [false, true].map(|is_crossfaded| {
                solutions(|solver, _| {
                    solver.shaping.filters = Filters::uniform(kind, 0.3);
                    solver.history.crossfade.is_due = is_crossfaded;
                })
            });
            let yaw_deg = |solution: &Solution| solution.head.yaw_pitch_roll_deg()[0];
            let [least, most] = [&jump, &faded].map(|got| (yaw_deg(&got[10]) - yaw_deg(&got[9])).abs());
            assert!(least > 0.4 && most < 1e-3, "{kind:?}: {least} {most}");
            let steps = faded[10].smoothed.0.iter().zip(faded[9].smoothed.0).map(|(now, last)| (now - last).abs());
            assert!(steps.fold(0.0, f32::max) < 1e-6, "{kind:?}");
            assert!(faded.windows(2).all(|pair| (yaw_deg(&pair[1]) - yaw_deg(&pair[0])).abs() < 1.5), "{kind:?}");
            assert!((yaw_deg(&faded[44]) - yaw_deg(&jump[44])).abs() < 0.01, "{kind:?}");
        }
    }

    #[test]
    fn another_model_reads_the_wearer_again_and_leads_the_output_over() {
        let scaled = |factor: f32, offset: f32| {
            let mut model = Model::embedded();
            let Regression::HiddenLayer(layer) = &mut model.regression else { panic!("the shipped model is a layer") };
            layer.output.weights.iter_mut().for_each(|weight| *weight *= factor);
            layer.output.offsets = [offset; COEFFS];
            model
        };
        // The points of the test's face are not those of a person: only small weights read it as one at rest.
        let mut solver = Solver::new(scaled(1e-3, 0.0), Profile::default(), solver().shaping);
        solver.neutral_mode = NeutralMode::Auto;
        for frame in 0..60 {
            solver.solve(&turned(0.0), &CAMERA, FRAME_US * frame).expect("a face");
        }
        let share = solver.neutral_share();
        assert!(share > 0.1 && solver.history.gaze_offset != Offset::default());
        solver.set_model(scaled(2e-3, 0.0));
        assert_eq!(solver.neutral_share(), share);
        assert_eq!(solver.history.gaze_offset, Offset::default());
        assert!(solver.history.crossfade.is_due);
        solver.set_model(scaled(1e-3, 1e6));
        assert_eq!(solver.neutral_share(), 0.0, "that model makes nothing of the face");
    }

    #[test]
    fn long_gap_a_clock_that_ran_back_and_a_second_of_rejected_frames_start_the_filters_anew() {
        let is_fresh = |rejected: u64, last_us| {
            let mut solver = solver();
            for frame in 1..=3_u8 {
                solver.solve(&turned(frame.into()), &CAMERA, FRAME_US * u64::from(frame)).expect("a face");
            }
            for frame in 4..4 + rejected {
                assert!(solver.solve(&Landmarks([[f32::NAN; 3]; LANDMARKS]), &CAMERA, FRAME_US * frame).is_err());
            }
            solver.history.crossfade.is_due = last_us != FRAME_US * 4;
            let solution = solver.solve(&turned(5.0), &CAMERA, last_us).expect("a face");
            solution.smoothed == solution.corrected
        };
        assert!(is_fresh(0, 600_000) && is_fresh(0, 99_998) && is_fresh(30, FRAME_US * 34));
        assert!(!is_fresh(0, FRAME_US * 4));
    }
}
