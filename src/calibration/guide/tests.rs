use super::super::observation::Sight;
use super::super::test_wearer::{FRAME_US, Wearer};
use super::*;
use facewire_face::BLENDSHAPES;

fn gain(calibration: &Calibration, name: &str) -> f32 {
    calibration.profile.gain[BLENDSHAPES.iter().position(|known| *known == name).unwrap()]
}

/// Follows every take to this extent, half a second after being asked.
fn follow_all(wearer: &Wearer, extent: f32) -> (Result<Calibration, Refusal>, u64) {
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    Wearer::follow(&mut guide, 0, |take, since_s| wearer.pose(take, if since_s > 0.5 { extent } else { 0.0 }))
}

/// Runs the neutral take with what `act` shows, for 4 s. Returns the guide's state then.
fn neutral_take(wearer: &Wearer, mut act: impl FnMut(u64) -> (bool, Sight)) -> Progress {
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    for frame in 0..120 {
        let (is_dark, sight) = act(frame);
        guide.update(&Observation { time_us: frame * FRAME_US, is_dark, sight });
    }
    guide.progress()
}

#[test]
fn wearer_who_follows_is_done_within_30_s_with_every_take() {
    let (outcome, took_us) = follow_all(&Wearer::new(), 0.8);
    let calibration = outcome.unwrap();
    assert_eq!(calibration.taken, Take::ALL);
    assert_eq!((calibration.left_out.len(), calibration.refused), (0, 0));
    assert!(took_us < 30_000_000, "{took_us}");
}

#[test]
fn slow_camera_is_enough() {
    let wearer = Wearer::new();
    for period_us in [400_000, 500_000, 1_000_000, 2_000_000] {
        let (mut guide, mut time_us) = (Guide::new(Arc::clone(&wearer.model)), 0);
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
fn lids_are_brought_to_1_and_weak_poses_are_strengthened_within_bounds() {
    let wearer = Wearer::new();
    let calibration = follow_all(&wearer, 0.6).0.unwrap();
    let shut = wearer.model.correction.0[0].correct(0.6, calibration.profile.rest[0], calibration.profile.gain[0]);
    assert!(shut > 0.95, "{shut}");
    assert!((1.02..1.1).contains(&gain(&calibration, "eyeLookOutLeft")));
    assert!((gain(&follow_all(&wearer, 1.2).0.unwrap(), "browDownLeft") - 0.6).abs() < 1e-6);
    for name in ["cheekPuff", "mouthSmileLeft"] {
        assert!((gain(&calibration, name) - 1.0).abs() < 1e-6, "no pose tells about {name}");
    }
}

#[test]
fn conditions_of_the_neutral_take_are_named() {
    let mut wearer = Wearer::new();
    let face = wearer.shows([0.0; 3], &[]);
    let waits_for = |is_dark, sight: &Sight| neutral_take(&wearer, |_| (is_dark, sight.clone())).waits_for;
    assert_eq!(waits_for(false, &Sight::NoPicture), Some(Refusal::NoPicture));
    assert_eq!(waits_for(false, &Sight::NoFace), Some(Refusal::NoFace));
    assert_eq!(waits_for(true, &face), Some(Refusal::TooDark));
    for turned in [[25.0, 0.0, 0.0], [0.0, -25.0, 0.0], [0.0, 0.0, 25.0], [f32::NAN, 0.0, 0.0]] {
        assert_eq!(waits_for(false, &wearer.shows(turned, &[])), Some(Refusal::HeadTurned));
    }
    for (names, refusal) in [
        (Take::EyesShut.raises(), Refusal::EyesShut),
        (Take::Smile.raises(), Refusal::Smiling),
        (Take::JawOpen.raises(), Refusal::MouthOpen),
    ] {
        wearer.general = names.iter().map(|name| (*name, 0.8)).collect();
        let sight = wearer.shows([0.0; 3], &[]);
        assert_eq!(neutral_take(&wearer, |_| (false, sight.clone())).waits_for, Some(refusal));
    }
}

#[test]
fn head_that_moves_and_mouth_that_speaks_refuse_the_neutral_take() {
    let wearer = Wearer::new();
    let sways = neutral_take(&wearer, |frame| (false, wearer.shows([0.5 * (frame % 20) as f32, 0.0, 0.0], &[])));
    assert_eq!((sways.refused > 2, sways.last_refusal), (true, Some(Refusal::HeadMoves)));
    let speaks = neutral_take(&wearer, |frame| {
        let open = if frame % 16 < 8 { 0.0 } else { 0.35 };
        (false, wearer.shows([0.0; 3], &[("jawOpen", open)]))
    });
    assert_eq!((speaks.refused > 2, speaks.last_refusal), (true, Some(Refusal::FaceMoves)));
    assert_eq!(speaks.take, Take::Neutral);
}

#[test]
fn blink_in_the_neutral_take_is_left_out() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    for frame in 0..100 {
        let shut = if (50..55).contains(&frame) { 0.6 } else { 0.0 };
        let sight = wearer.shows([0.0; 3], &[("eyeBlinkLeft", shut), ("eyeBlinkRight", shut)]);
        guide.update(&Observation { time_us: frame * FRAME_US, is_dark: false, sight });
    }
    assert_eq!((guide.refused, guide.wanted()), (0, Some(Take::EyesShut)));
    assert!(guide.takes.neutral().unwrap().raw[0].abs() < 0.01);
}

#[test]
fn pose_that_is_not_performed_is_left_out_and_keeps_its_gain() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let (outcome, took_us) =
        Wearer::follow(&mut guide, 0, |take, _| wearer.pose(take, if take == Take::BrowsUp { 0.05 } else { 0.6 }));
    let calibration = outcome.unwrap();
    assert_eq!(calibration.left_out, [(Take::BrowsUp, Refusal::NotSeen)]);
    assert!((gain(&calibration, "browInnerUp") - 1.0).abs() < 1e-6 && gain(&calibration, "browDownLeft") < 0.9);
    assert!(took_us < 35_000_000, "{took_us}");
}

#[test]
fn pose_that_ends_too_early_is_refused_and_taken_again() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let (outcome, _) = Wearer::follow(&mut guide, 0, |take, since_s| {
        let is_released = take == Take::Smile && (1.0..1.6).contains(&since_s);
        wearer.pose(take, if is_released { 0.0 } else { 0.8 })
    });
    let calibration = outcome.unwrap();
    assert_eq!((calibration.refused, calibration.taken.len()), (1, 11));
    assert_eq!(guide.last_refusal, Some(Refusal::TooShort));
}

#[test]
fn wearer_who_moves_into_a_pose_slowly_is_measured_at_its_end() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let slowly = |take, since_s: f32| wearer.pose(take, (0.4 * since_s).min(0.9));
    let calibration = Wearer::follow(&mut guide, 0, slowly).0.unwrap();
    assert_eq!((calibration.refused, calibration.left_out.len()), (0, 0));
    assert!((0.85..0.92).contains(&gain(&calibration, "eyeLookOutLeft")), "{}", gain(&calibration, "eyeLookOutLeft"));
}

#[test]
fn face_that_is_lost_in_mid_take_is_told_and_awaited() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let (outcome, _) = Wearer::follow(&mut guide, 0, |take, since_s| match take {
        Take::JawOpen if (1.0..3.0).contains(&since_s) => Sight::NoFace,
        _ => wearer.pose(take, 0.8),
    });
    let calibration = outcome.unwrap();
    assert_eq!((calibration.refused, calibration.taken.len()), (1, 11));
    assert_eq!(guide.last_refusal, Some(Refusal::NoFace));
}

#[test]
fn head_that_turns_away_leaves_a_pose_out_in_the_end() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let (outcome, _) = Wearer::follow(&mut guide, 0, |take, _| match take {
        Take::LookLeft => wearer.shows([20.0, 0.0, 0.0], &[("eyeLookOutLeft", 0.8), ("eyeLookInRight", 0.8)]),
        _ => wearer.pose(take, 0.8),
    });
    assert_eq!(outcome.unwrap().left_out, [(Take::LookLeft, Refusal::HeadTurned)]);
}

#[test]
fn without_a_neutral_take_there_is_no_profile() {
    let mut wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let (outcome, took_us) = Wearer::follow(&mut guide, 0, |_, _| Sight::NoFace);
    assert_eq!(outcome.unwrap_err(), Refusal::NoFace);
    assert!(took_us < 40_000_000, "{took_us}");
    wearer.general = vec![("mouthSmileLeft", 0.8), ("mouthSmileRight", 0.8)];
    assert_eq!(follow_all(&wearer, 0.8).0.unwrap_err(), Refusal::Smiling);
}

#[test]
fn faint_smile_in_the_neutral_take_is_found_by_the_poses_and_the_take_is_repeated() {
    let wearer = Wearer::new();
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    let mut neutrals = 0;
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
    assert_eq!(guide.last_refusal, Some(Refusal::Smiling));
    assert_eq!(outcome.unwrap_err(), Refusal::Smiling);
}

#[test]
fn clock_that_jumps_in_either_direction_breaks_no_take_and_completes_none() {
    let wearer = Wearer::new();
    for jump_us in [3_600_000_000, 2_000_000] {
        let mut guide = Guide::new(Arc::clone(&wearer.model));
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
    let mut guide = Guide::new(Arc::clone(&wearer.model));
    assert_eq!((guide.progress().phase, guide.progress().done), (Phase::GetReady, 0));
    let mut measured = Vec::new();
    for frame in 0..85 {
        guide.update(&Observation { time_us: frame * FRAME_US, is_dark: false, sight: wearer.shows([0.0; 3], &[]) });
        if guide.wanted() == Some(Take::Neutral) {
            measured.push(guide.progress().measured);
        }
    }
    assert!(measured.is_sorted() && measured.last() > Some(&0.8) && measured.first() == Some(&0.0));
    assert_eq!((guide.progress().take, guide.progress().done, guide.progress().of), (Take::EyesShut, 1, 11));
}
