//! The guide with a wearer who shows the coefficients that a test wants.

use facewire_face::model::{FormulaSetTable, FormulaTable, FormulasTable, ModelFile};
use facewire_face::stages::{Coefficients, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, testing::face};

use super::super::observation::{Seen, Sight};
use super::*;

/// Coefficients by name; all others are 0.
pub(crate) type Shown<'a> = &'a [(&'a str, f32)];

pub(crate) struct Wearer {
    pub(crate) model: Arc<Model>,
    /// The coefficients of the neutral face, measured from the mean of many people.
    general: Vec<(&'static str, f32)>,
}

/// A model that reads nothing in the landmarks, so that the residual is all that a face shows.
pub(crate) fn blank_model_file() -> ModelFile {
    let named = |name: &&str| ((*name).to_owned(), FormulaTable::default());
    let blendshapes = BLENDSHAPES.iter().filter(|name| **name != "tongueOut").map(named).collect();
    let formulas = FormulaSetTable { blendshapes, ..FormulaSetTable::default() };
    let formulas = FormulasTable { neutral_known: formulas.clone(), neutral_unknown: formulas };
    ModelFile { formulas: Some(formulas), ..ModelFile::new(String::new(), String::new()) }
}

const FRAME_US: u64 = 33_333;

impl Wearer {
    pub(crate) fn new() -> Self {
        Self { model: blank_model_file().to_model().unwrap().into(), general: Vec::new() }
    }

    /// A face whose head is turned by these angles and that shows these coefficients, relative to its neutral face.
    pub(crate) fn shows(&self, head_deg: [f32; 3], shown: Shown) -> Sight {
        let face = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap();
        let general: Vec<_> = self.general.iter().chain(shown).copied().collect();
        let residuals = [&*general, shown].map(|shown| {
            let mut residual = Coefficients([0.0; COEFFS]);
            shown.iter().for_each(|(name, value)| residual.0[index(name)] += value);
            residual
        });
        Sight::Face(Seen { face, residuals, head_deg })
    }

    /// The pose of a take, performed to this extent.
    pub(crate) fn pose(&self, take: Take, extent: f32) -> Sight {
        let shown: Vec<_> = take.raises().iter().map(|name| (*name, extent)).collect();
        self.shows([0.0; 3], &shown)
    }

    fn guide(&self) -> Guide {
        Guide::new(Arc::clone(&self.model))
    }

    /// Follows the guide from `begun_us` on: `act` says what the wearer shows in each frame, given the take and the time
    /// since the guide asked for it. Returns the outcome, and the time of the last frame.
    fn follow(
        guide: &mut Guide,
        begun_us: u64,
        mut act: impl FnMut(Take, f32) -> Sight,
    ) -> (Result<Calibration, Refusal>, u64) {
        let (mut time_us, mut asked) = (begun_us, (None, begun_us));
        loop {
            let Some(take) = guide.wanted() else { return (guide.outcome().unwrap(), time_us) };
            time_us += FRAME_US;
            assert!(time_us - begun_us < 300_000_000, "the guide does not end: {:?}", guide.progress());
            if asked.0 != Some(take) {
                asked = (Some(take), time_us);
            }
            let sight = act(take, (time_us - asked.1) as f32 / 1e6);
            guide.update(&Observation { time_us, is_dark: false, sight });
        }
    }

    /// Shows the guide this many frames, from the first one on.
    fn show(&self, frames: u64, mut act: impl FnMut(u64) -> (bool, Sight)) -> Guide {
        let mut guide = self.guide();
        for frame in 0..frames {
            let (is_dark, sight) = act(frame);
            guide.update(&Observation { time_us: frame * FRAME_US, is_dark, sight });
        }
        guide
    }
}

fn index(name: &str) -> usize {
    BLENDSHAPES.iter().position(|known| *known == name).unwrap()
}

/// Follows every take to this extent, half a second after being asked.
fn follow_all(wearer: &Wearer, extent: f32) -> (Result<Calibration, Refusal>, u64) {
    Wearer::follow(&mut wearer.guide(), 0, |take, since_s| wearer.pose(take, if since_s > 0.5 { extent } else { 0.0 }))
}

#[test]
fn wearer_who_follows_is_done_within_30_s_and_gets_gains_within_bounds() {
    let wearer = Wearer::new();
    let (outcome, took_us) = follow_all(&wearer, 0.6);
    let calibration = outcome.unwrap();
    assert_eq!(calibration.taken, Take::ALL);
    assert_eq!((calibration.left_out.len(), calibration.refused), (0, 0));
    assert!(took_us < 30_000_000, "{took_us}");
    let gain = |name| calibration.profile.gain[index(name)];
    let shut = wearer.model.correction.0[0].correct(0.6, calibration.profile.rest[0], gain("eyeBlinkLeft"));
    assert!(shut > 0.95, "lids are brought to 1: {shut}");
    assert!((1.02..1.1).contains(&gain("eyeLookOutLeft")), "weak poses are strengthened");
    assert_eq!(["cheekPuff", "mouthSmileLeft"].map(gain), [1.0; 2], "no pose tells about these");
    let strong = follow_all(&wearer, 1.2).0.unwrap();
    assert!((strong.profile.gain[index("browDownLeft")] - 0.6).abs() < 1e-6);
}

#[test]
fn slow_camera_is_enough() {
    let wearer = Wearer::new();
    for period_us in [400_000, 500_000, 1_000_000, 2_000_000] {
        let (mut guide, mut time_us) = (wearer.guide(), 0);
        for frame in 0..400 {
            let Some(take) = guide.wanted() else { break };
            // A blink in every seventh frame, and times that vary by a quarter.
            let shut = if frame % 7 == 3 && take != Take::EyesShut { 0.9 } else { 0.0 };
            let mut shown: Vec<_> = take.raises().iter().map(|name| (*name, 0.8)).collect();
            shown.extend(["eyeBlinkLeft", "eyeBlinkRight"].map(|name| (name, shut)));
            time_us += period_us * (75 + 50 * (frame % 2)) / 100;
            let sight = wearer.shows([0.0; 3], &shown);
            guide.update(&Observation { time_us, is_dark: false, sight });
        }
        let calibration = guide.outcome().unwrap_or_else(|| panic!("{period_us}: {:?}", guide.progress()));
        assert_eq!(calibration.unwrap().taken, Take::ALL, "{period_us}");
    }
}

#[test]
fn conditions_of_the_neutral_take_are_named() {
    let mut wearer = Wearer::new();
    let face = wearer.shows([0.0; 3], &[]);
    let waits_for = |wearer: &Wearer, is_dark, sight: &Sight| {
        wearer.show(120, |_| (is_dark, sight.clone())).progress().waits_for.unwrap()
    };
    assert_eq!(waits_for(&wearer, false, &Sight::NoPicture), Refusal::NoPicture);
    assert_eq!(waits_for(&wearer, false, &Sight::NoFace), Refusal::NoFace);
    assert_eq!(waits_for(&wearer, true, &face), Refusal::TooDark);
    for turned in [[25.0, 0.0, 0.0], [0.0, -25.0, 0.0], [0.0, 0.0, 25.0], [f32::NAN, 0.0, 0.0]] {
        assert_eq!(waits_for(&wearer, false, &wearer.shows(turned, &[])), Refusal::HeadTurned);
    }
    for (take, refusal) in
        [(Take::EyesShut, Refusal::EyesShut), (Take::Smile, Refusal::Smiling), (Take::JawOpen, Refusal::MouthOpen)]
    {
        wearer.general = take.raises().iter().map(|name| (*name, 0.8)).collect();
        assert_eq!(waits_for(&wearer, false, &wearer.shows([0.0; 3], &[])), refusal);
    }
    assert_eq!(follow_all(&wearer, 0.8).0, Err(Refusal::MouthOpen), "there is no profile without a neutral take");
    let (outcome, took_us) = Wearer::follow(&mut wearer.guide(), 0, |_, _| Sight::NoFace);
    assert_eq!(outcome, Err(Refusal::NoFace));
    assert!(took_us < 40_000_000, "{took_us}");
}

#[test]
fn moving_head_and_speaking_mouth_refuse_the_neutral_take_and_a_blink_is_left_out() {
    let wearer = Wearer::new();
    let at_rest = |head_deg, shown: Shown| (false, wearer.shows(head_deg, shown));
    let sways = wearer.show(120, |frame| at_rest([0.5 * (frame % 20) as f32, 0.0, 0.0], &[]));
    assert_eq!((sways.refused > 2, sways.last_refusal), (true, Some(Refusal::HeadMoves)));
    let speaks = wearer.show(120, |frame| at_rest([0.0; 3], &[("jawOpen", if frame % 16 < 8 { 0.0 } else { 0.35 })]));
    assert_eq!((speaks.refused > 2, speaks.last_refusal), (true, Some(Refusal::FaceMoves)));
    assert_eq!(speaks.wanted(), Some(Take::Neutral));
    let blinks = wearer.show(100, |frame| {
        let shut = if (50..55).contains(&frame) { 0.6 } else { 0.0 };
        at_rest([0.0; 3], &[("eyeBlinkLeft", shut), ("eyeBlinkRight", shut)])
    });
    assert_eq!((blinks.refused, blinks.wanted()), (0, Some(Take::EyesShut)));
    assert!(blinks.takes.neutral.unwrap().raw[0].abs() < 0.01);
}

#[test]
fn poses_are_taken_again_or_left_out_with_the_reason() {
    type Act = fn(&Wearer, Take, f32) -> Sight;
    let cases: [(&str, Act, u32, Option<Refusal>, &[(Take, Refusal)]); 5] = [
        (
            "a pose that is not performed",
            |wearer, take, _| wearer.pose(take, if take == Take::BrowsUp { 0.05 } else { 0.6 }),
            0,
            None,
            &[(Take::BrowsUp, Refusal::NotSeen)],
        ),
        (
            "a pose that ends too early",
            |wearer, take, since_s| {
                let is_released = take == Take::Smile && (1.0..1.6).contains(&since_s);
                wearer.pose(take, if is_released { 0.0 } else { 0.8 })
            },
            1,
            Some(Refusal::TooShort),
            &[],
        ),
        (
            "a wearer who moves into each pose slowly",
            |wearer, take, since_s| wearer.pose(take, (0.4 * since_s).min(0.9)),
            0,
            None,
            &[],
        ),
        (
            "a face that is lost in the middle of a take",
            |wearer, take, since_s| match take {
                Take::JawOpen if (1.0..3.0).contains(&since_s) => Sight::NoFace,
                _ => wearer.pose(take, 0.8),
            },
            1,
            Some(Refusal::NoFace),
            &[],
        ),
        (
            "a head that turns away",
            |wearer, take, _| match take {
                Take::LookLeft => wearer.shows([20.0, 0.0, 0.0], &[("eyeLookOutLeft", 0.8), ("eyeLookInRight", 0.8)]),
                _ => wearer.pose(take, 0.8),
            },
            0,
            None,
            &[(Take::LookLeft, Refusal::HeadTurned)],
        ),
    ];
    let wearer = Wearer::new();
    for (what, act, refused, last_refusal, left_out) in cases {
        let mut guide = wearer.guide();
        let (outcome, took_us) = Wearer::follow(&mut guide, 0, |take, since_s| act(&wearer, take, since_s));
        let calibration = outcome.unwrap();
        assert_eq!((calibration.refused, guide.last_refusal), (refused, last_refusal), "{what}");
        assert_eq!((&*calibration.left_out, calibration.taken.len()), (left_out, 11 - left_out.len()), "{what}");
        assert!(took_us < 40_000_000, "{what}: {took_us}");
        let gain = calibration.profile.gain[index("eyeLookOutLeft")];
        assert!(what != "a wearer who moves into each pose slowly" || (0.85..0.92).contains(&gain), "{gain}");
        assert!(left_out.is_empty() || calibration.profile.gain[index(left_out[0].0.raises()[0])] == 1.0, "{what}");
    }
}

#[test]
fn faint_smile_in_the_neutral_take_is_found_by_the_poses_and_the_take_is_repeated() {
    let wearer = Wearer::new();
    let (mut guide, mut neutrals) = (wearer.guide(), 0);
    let (outcome, _) = Wearer::follow(&mut guide, 0, |take, since_s| {
        neutrals += u32::from(take == Take::Neutral && since_s == 0.0);
        let below = if neutrals == 1 { -0.35 } else { 0.0 };
        let mut shown: Vec<_> = take.raises().iter().map(|name| (*name, 0.8)).collect();
        if take != Take::Neutral {
            shown.extend(Take::Smile.raises().iter().map(|name| (*name, below)));
        }
        wearer.shows([0.0; 3], &shown)
    });
    // The observations stay relative to the first neutral face, so the repeated take cannot agree with them here.
    assert!(neutrals >= 2, "the neutral take is asked for again");
    assert_eq!((guide.last_refusal, outcome), (Some(Refusal::Smiling), Err(Refusal::Smiling)));
}

#[test]
fn clock_that_jumps_in_either_direction_breaks_no_take_and_completes_none() {
    let wearer = Wearer::new();
    for jump_us in [3_600_000_000, 2_000_000] {
        let mut guide = wearer.guide();
        let observe = |guide: &mut Guide, time_us| {
            guide.update(&Observation { time_us, is_dark: false, sight: wearer.shows([0.0; 3], &[]) });
        };
        let begun_us = 5_000_000;
        (0..45).for_each(|frame| observe(&mut guide, begun_us + frame * FRAME_US));
        assert_eq!(guide.progress().phase, Phase::Measure);
        observe(&mut guide, begun_us + jump_us);
        assert_eq!(guide.wanted(), Some(Take::Neutral), "a gap does not count as held");
        observe(&mut guide, 1);
        assert_eq!(guide.wanted(), Some(Take::Neutral));
        assert_eq!(Wearer::follow(&mut guide, 2, |take, _| wearer.pose(take, 0.8)).0.unwrap().taken, Take::ALL);
    }
}

#[test]
fn progress_says_which_take_is_how_far() {
    let wearer = Wearer::new();
    let at = |frames| wearer.show(frames, |_| (false, wearer.shows([0.0; 3], &[]))).progress();
    assert_eq!((at(0).phase, at(0).done), (Phase::GetReady, 0));
    let measured = [1, 35, 50, 60, 70].map(|frames| at(frames).measured);
    assert!(measured.is_sorted() && measured[4] > 0.8 && measured[0] == 0.0, "{measured:?}");
    assert_eq!((at(85).take, at(85).done, at(85).of), (Take::EyesShut, 1, 11));
}
