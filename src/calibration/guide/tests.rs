//! The guide with a wearer who shows the coefficients that a test wants.

use facewire_face::model::{Cases, FormulaSetTable, FormulaTable, ModelFile};
use facewire_face::stages::{Coefficients, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, MouthValues, testing::face};

use super::super::take::Seen;
use super::*;

type Sight = Result<Seen, Refusal>;

/// Coefficients by name; all others are 0.
pub(crate) type Shown<'a> = &'a [(&'a str, f32)];

/// A model that reads nothing in the landmarks, so that the residual is all that a face shows.
pub(crate) fn blank_model_file() -> ModelFile {
    let named = |name: &&str| ((*name).to_owned(), FormulaTable::default());
    let blendshapes = BLENDSHAPES.iter().filter(|name| **name != "tongueOut").map(named).collect();
    let formulas = FormulaSetTable { blendshapes, ..FormulaSetTable::default() };
    let formulas = Cases { neutral_known: formulas.clone(), neutral_unknown: formulas };
    ModelFile { formulas: Some(formulas), ..ModelFile::new(String::new(), String::new()) }
}

const FRAME_US: u64 = 33_333;

fn guide() -> Guide {
    Guide::new(blank_model_file().to_model().unwrap(), Wears::Nothing)
}

/// A face whose head is turned by these angles and that shows these coefficients, relative to its neutral face.
fn shows(head_deg: [f32; 3], shown: Shown) -> Sight {
    let face = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap();
    let mut residual = Coefficients([0.0; COEFFS]);
    shown.iter().for_each(|(name, value)| residual.0[index(name)] += value);
    Ok(Seen { face, residuals: [residual; 2], eyes: None, mouth: None, head_deg })
}

/// The pose of a take, performed to this extent.
pub(crate) fn pose(take: Take, extent: f32) -> Sight {
    let shown: Vec<_> = expected(take).raises.iter().map(|name| (*name, extent)).collect();
    shows([0.0; 3], &shown)
}

/// As [`pose`], by a wearer whose neutral face shows another pose, measured from the mean of many people.
fn pose_of_face_at(rest: Take, take: Take, extent: f32) -> Sight {
    let mut seen = pose(take, extent)?;
    expected(rest).raises.iter().for_each(|name| seen.residuals[0].0[index(name)] += 0.8);
    Ok(seen)
}

/// Follows the guide in frames at these times: `act` says what the wearer shows, given the take and the time since it was
/// asked for. Returns the outcome, and the time of the last frame.
fn follow(
    guide: &mut Guide,
    times_us: impl IntoIterator<Item = u64>,
    mut act: impl FnMut(Take, f32) -> Sight,
) -> (Result<Calibration, Refusal>, u64) {
    let mut asked = (None, 0);
    for time_us in times_us {
        let Some(take) = guide.wanted() else { return (guide.outcome().unwrap(), time_us) };
        if asked.0 != Some(take) {
            asked = (Some(take), time_us);
        }
        let sight = act(take, (time_us - asked.1) as f32 / 1e6);
        guide.update(&Observation { time_us, sight });
    }
    panic!("the guide does not end: {:?}", guide.progress())
}

/// Shows a guide this many frames.
fn show(frames: u64, mut act: impl FnMut(u64) -> Sight) -> Guide {
    let mut guide = guide();
    (0..frames).for_each(|frame| guide.update(&Observation { time_us: frame * FRAME_US, sight: act(frame) }));
    guide
}

/// The times of frames for 300 s.
fn frames_from(begin_us: u64) -> impl Iterator<Item = u64> {
    (0..9000).map(move |frame| begin_us + frame * FRAME_US)
}

fn index(name: &str) -> usize {
    BLENDSHAPES.iter().position(|known| *known == name).unwrap()
}

/// Follows every take to this extent, half a second after being asked.
fn follow_all(extent: f32) -> (Result<Calibration, Refusal>, u64) {
    follow(&mut guide(), frames_from(0), |take, since_s| pose(take, if since_s > 0.5 { extent } else { 0.0 }))
}

#[test]
fn wearer_who_follows_is_done_within_30_s_and_gets_gains_within_bounds() {
    let (outcome, took_us) = follow_all(0.6);
    let calibration = outcome.unwrap();
    assert_eq!(calibration.taken, Take::ALL);
    assert_eq!((calibration.left_out.len(), calibration.refused), (0, 0));
    assert!(took_us < 30_000_000, "{took_us}");
    let gain = |name| calibration.profile.gain[index(name)];
    let shut = guide().model.correction.0[0].correct(0.6, calibration.profile.rest[0], gain("eyeBlinkLeft"));
    assert!(shut > 0.95, "lids are brought to 1: {shut}");
    assert!((1.08..1.13).contains(&gain("eyeLookOutLeft")), "weak poses are strengthened");
    assert_eq!(["cheekPuff", "mouthSmileLeft"].map(gain), [1.0; 2], "no pose tells about these");
    let strong = follow_all(1.6).0.unwrap();
    assert!((strong.profile.gain[index("eyeBlinkLeft")] - 0.6).abs() < 1e-6);
}

#[test]
fn slow_camera_is_enough() {
    for period_us in [400_000, 2_000_000] {
        // Times that vary by a quarter, and a blink in every seventh frame.
        let times_us = (1..400).scan(0, |time_us, frame| {
            *time_us += period_us * (75 + 50 * (frame % 2)) / 100;
            Some(*time_us)
        });
        let mut frame = 0;
        let (outcome, _) = follow(&mut guide(), times_us, |take, _| {
            frame += 1;
            let is_blink = frame % 7 == 3 && take != Take::EyesShut;
            pose(if is_blink { Take::EyesShut } else { take }, 0.9)
        });
        assert_eq!(outcome.unwrap().taken, Take::ALL, "{period_us}");
    }
}

#[test]
fn conditions_of_the_neutral_take_are_named_and_without_it_there_is_no_profile() {
    let waits_for = |sight: Sight| show(120, |_| sight.clone()).progress().waits_for.unwrap();
    assert_eq!(waits_for(Err(Refusal::TooDark)), Refusal::TooDark);
    for turned in [[25.0, 0.0, 0.0], [0.0, -25.0, 0.0], [0.0, 0.0, 25.0], [f32::NAN, 0.0, 0.0]] {
        assert_eq!(waits_for(shows(turned, &[])), Refusal::HeadTurned);
    }
    let poses = [Take::EyesShut, Take::Smile, Take::JawOpen];
    for (rest, refusal) in poses.into_iter().zip([Refusal::EyesShut, Refusal::Smiling, Refusal::MouthOpen]) {
        assert_eq!(waits_for(pose_of_face_at(rest, Take::Neutral, 0.0)), refusal);
    }
    let open = follow(&mut guide(), frames_from(0), |take, _| pose_of_face_at(Take::JawOpen, take, 0.8));
    assert_eq!(open.0, Err(Refusal::MouthOpen));
    let (outcome, took_us) = follow(&mut guide(), frames_from(0), |_, _| Err(Refusal::NoFace));
    assert!(outcome == Err(Refusal::NoFace) && took_us < 40_000_000, "{took_us}");
}

#[test]
fn moving_head_and_speaking_mouth_refuse_the_neutral_take_and_a_blink_is_left_out() {
    let sways = show(120, |frame| shows([0.5 * (frame % 20) as f32, 0.0, 0.0], &[]));
    assert_eq!((sways.calibration.refused > 2, sways.last_refusal), (true, Some(Refusal::HeadMoves)));
    let speaks = show(120, |frame| pose(Take::JawOpen, (frame / 8 % 2) as f32 * 0.35));
    assert_eq!((speaks.calibration.refused > 2, speaks.last_refusal), (true, Some(Refusal::FaceMoves)));
    let shut = |frame| if (50..55).contains(&frame) { 0.6 } else { 0.0 };
    let blinks = show(100, |frame| pose(Take::EyesShut, shut(frame)));
    assert_eq!((blinks.wanted(), blinks.calibration.refused), (Some(Take::EyesShut), 0));
    assert!(blinks.takes.neutral.unwrap().raw[0].abs() < 0.01);
}

#[test]
fn poses_are_taken_again_or_left_out_with_the_reason() {
    let run = |act: fn(Take, f32) -> Sight| {
        let mut guide = guide();
        let (outcome, _) = follow(&mut guide, frames_from(0), act);
        let Calibration { profile, left_out, refused, .. } = outcome.unwrap();
        ((refused, guide.last_refusal, left_out), profile.gain)
    };
    let not_performed = run(|take, _| pose(take, if take == Take::BrowsUp { 0.05 } else { 0.6 }));
    assert_eq!(not_performed.0, (0, None, vec![(Take::BrowsUp, Refusal::NotSeen)]));
    assert!(not_performed.1[index("browInnerUp")] == 1.0 && not_performed.1[index("browDownLeft")] < 0.9);
    let ends_too_early = run(|take, since_s| {
        let is_released = take == Take::Smile && (1.0..1.6).contains(&since_s);
        pose(take, if is_released { 0.0 } else { 0.8 })
    });
    assert_eq!(ends_too_early.0, (1, Some(Refusal::TooShort), vec![]));
    let slow = run(|take, since_s| pose(take, (0.4 * since_s).min(0.9)));
    assert_eq!(slow.0, (0, None, vec![]));
    assert!((0.98..1.01).contains(&slow.1[index("eyeLookOutLeft")]), "a slow pose is measured at its end");
    let face_is_lost = run(|take, since_s| match take {
        Take::JawOpen if (1.0..3.0).contains(&since_s) => Err(Refusal::NoFace),
        Take::LookLeft => shows([20.0, 0.0, 0.0], &[("eyeLookOutLeft", 0.8), ("eyeLookInRight", 0.8)]),
        _ => pose(take, 0.8),
    });
    assert_eq!(face_is_lost.0, (1, Some(Refusal::NoFace), vec![(Take::LookLeft, Refusal::HeadTurned)]));
}

#[test]
fn a_hindrance_that_is_over_is_not_named_any_more() {
    for hindrance in [Refusal::NoPicture, Refusal::NoFace] {
        let progress =
            |frames| show(frames, |frame| if frame < 10 { Err(hindrance) } else { shows([0.0; 3], &[]) }).progress();
        assert_eq!(progress(10).waits_for, Some(hindrance));
        let now = progress(11);
        assert_eq!((now.phase, now.waits_for), (Phase::GetReady, None));
    }
}

#[test]
fn the_end_names_its_reason_if_there_is_no_profile_and_none_if_there_is_one() {
    let end = |act: fn(Take) -> Sight| {
        let mut guide = guide();
        let (outcome, _) = follow(&mut guide, frames_from(0), |take, _| act(take));
        let progress = guide.progress();
        assert_eq!(progress.phase, Phase::Ended);
        (outcome.err(), progress.waits_for)
    };
    assert_eq!(end(|_| Err(Refusal::NoPicture)), (Some(Refusal::NoPicture), Some(Refusal::NoPicture)));
    assert_eq!(end(|take| pose(take, 0.8)), (None, None));
}

#[test]
fn a_pose_is_left_out_for_its_own_reason_and_not_for_that_of_an_earlier_failure() {
    let mut guide = guide();
    let mut frames = 0;
    let (outcome, _) = follow(&mut guide, frames_from(0), |take, _| {
        frames += 1;
        match take {
            // The camera fails while the first take is held.
            Take::Neutral if (40..50).contains(&frames) => Err(Refusal::NoPicture),
            Take::JawOpen => shows([0.0; 3], &[("jawOpen", 0.8), ("eyeBlinkLeft", 0.9), ("eyeBlinkRight", 0.9)]),
            _ => pose(take, 0.8),
        }
    });
    assert_eq!(guide.last_refusal, Some(Refusal::NoPicture));
    assert_eq!(outcome.unwrap().left_out, [(Take::JawOpen, Refusal::EyesShut)]);
}

#[test]
fn a_pose_that_is_held_when_its_time_is_over_is_taken() {
    let begins_late = |take, since_s| pose(take, if take == Take::BrowsUp && since_s < 5.3 { 0.0 } else { 0.8 });
    let (outcome, _) = follow(&mut guide(), frames_from(0), begins_late);
    assert_eq!(outcome.unwrap().taken, Take::ALL);
}

#[test]
fn faint_smile_in_the_neutral_take_is_found_by_the_poses_and_the_take_is_repeated() {
    let mut guide = guide();
    let mut neutrals = 0;
    let (outcome, _) = follow(&mut guide, frames_from(0), |take, since_s| {
        neutrals += u32::from(take == Take::Neutral && since_s == 0.0);
        let below = if neutrals == 1 { -0.35 } else { 0.0 };
        let mut shown: Vec<_> = expected(take).raises.iter().map(|name| (*name, 0.8)).collect();
        if take != Take::Neutral {
            shown.extend(expected(Take::Smile).raises.iter().map(|name| (*name, below)));
        }
        shows([0.0; 3], &shown)
    });
    // The observations stay relative to the first neutral face, so the repeated take cannot agree with them here.
    assert!(neutrals >= 2, "the neutral take is asked for again");
    assert_eq!((guide.last_refusal, outcome), (Some(Refusal::Smiling), Err(Refusal::Smiling)));
}

#[test]
fn clock_that_jumps_in_either_direction_breaks_no_take_and_completes_none() {
    for jump_us in [3_600_000_000, 2_000_000] {
        let mut guide = guide();
        let observe = |guide: &mut Guide, time_us| {
            guide.update(&Observation { time_us, sight: shows([0.0; 3], &[]) });
        };
        assert_eq!(guide.progress().phase, Phase::GetReady);
        frames_from(5_000_000).take(45).for_each(|time_us| observe(&mut guide, time_us));
        assert_eq!(guide.progress().phase, Phase::Measure);
        for time_us in [5_000_000 + jump_us, 1] {
            observe(&mut guide, time_us);
            assert_eq!(guide.wanted(), Some(Take::Neutral), "a gap does not count as held");
            // The last frame came 1.5 s after the first, so that a jump by 2 s leaves no gap.
            let is_gap = time_us == 1 || jump_us > 2_000_000;
            assert!(!is_gap || guide.progress().measured < 0.1, "a gap ends the hold");
        }
        let (outcome, _) = follow(&mut guide, frames_from(2), |take, _| pose(take, 0.8));
        assert_eq!(outcome.unwrap().taken, Take::ALL);
    }
}

/// What the picture of the mouth shows, by name; all else is 0.
fn picture_of_mouth(shown: Shown) -> MouthValues {
    let first = index("jawForward");
    let mut values = MouthValues::default();
    shown.iter().for_each(|(name, value)| values[index(name) - first] = *value);
    values
}

#[test]
fn under_a_headset_the_rest_of_the_mouth_is_learned_from_its_picture_wherever_the_head_seems_to_look() {
    let mut guide = Guide::new(blank_model_file().to_model().unwrap(), Wears::Headset);
    let (outcome, took_us) = follow(&mut guide, frames_from(0), |_, since_s| {
        // Landmarks under a headset tell of expressions that nobody makes, and of turns.
        let mut seen = shows([25.0 + 6.0 * since_s, 30.0, 0.0], &[("mouthSmileLeft", 0.9), ("eyeBlinkLeft", 0.9)])?;
        seen.mouth = Some(picture_of_mouth(&[("jawOpen", 0.1), ("mouthRollLower", 0.2)]));
        Ok(seen)
    });
    let Calibration { profile, taken, left_out, refused, .. } = outcome.unwrap();
    assert_eq!((taken, left_out, refused), (vec![Take::Neutral], vec![], 0));
    assert!(took_us < 5_000_000, "{took_us}");
    let rest = ["jawOpen", "mouthRollLower", "mouthSmileLeft", "eyeBlinkLeft"].map(|name| profile.rest[index(name)]);
    let want = [0.1, 0.2, 0.0, 0.0];
    assert!(rest.iter().zip(want).all(|(rest, want)| (rest - want).abs() < 1e-3), "{rest:?}");
    assert!(profile.fits(Wears::Headset) && !profile.fits(Wears::Nothing));
    assert_eq!((guide.progress().done, guide.progress().of), (1, 1));
}

#[test]
fn a_mouth_that_speaks_under_a_headset_refuses_the_take() {
    let mut guide = Guide::new(blank_model_file().to_model().unwrap(), Wears::Headset);
    for (number, time_us) in frames_from(0).take(90).enumerate() {
        let sight = shows([0.0; 3], &[]).map(|mut seen| {
            let open = if number / 10 % 2 == 0 { 0.0 } else { 0.35 };
            seen.mouth = Some(picture_of_mouth(&[("jawOpen", open)]));
            seen
        });
        guide.update(&Observation { time_us, sight });
    }
    assert_eq!((guide.wanted(), guide.last_refusal), (Some(Take::Neutral), Some(Refusal::FaceMoves)));
    guide.update(&Observation { time_us: 100 * FRAME_US, sight: shows([60.0, 0.0, 0.0], &[]) });
    assert_eq!(
        guide.progress().waits_for,
        Some(Refusal::HeadTurned),
        "a head turned this far is refused even under a headset"
    );
}

#[test]
fn a_mask_leaves_out_the_poses_of_the_mouth() {
    let mut guide = Guide::new(blank_model_file().to_model().unwrap(), Wears::Mask);
    let (outcome, _) = follow(&mut guide, frames_from(0), |take, _| {
        let mut seen = pose(take, 0.6)?;
        seen.residuals.iter_mut().for_each(|residual| residual.0[index("mouthSmileLeft")] = 0.9);
        Ok(seen)
    });
    let calibration = outcome.unwrap();
    let covered = [Take::JawOpen, Take::Smile, Take::Pucker];
    let want: Vec<Take> = Take::ALL.into_iter().filter(|take| !covered.contains(take)).collect();
    assert_eq!((calibration.taken, calibration.left_out, calibration.refused), (want, vec![], 0));
    assert_eq!(calibration.profile.rest[index("mouthSmileLeft")], 0.0, "a covered mouth tells nothing of its rest");
}
