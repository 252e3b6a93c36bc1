use std::iter;

use super::*;
use crate::model::{Model, Regression};
use crate::solve::{Camera, Filters, Profile, Shaping, Solver, canonical::RIGID, normalise};
use crate::testing;
use crate::track::{LANDMARKS, Landmarks};

const FRAME_S: f32 = 1.0 / 30.0;
const SECOND: usize = 30;
const JAW_OPEN: usize = 17;
const SMILES: [usize; 2] = [23, 24];
const BLINKS: [usize; 2] = [0, 7];
/// Landmark of the chin, which is not rigid.
const CHIN: usize = 152;

/// A frame: how the head is turned, where the chin is, and the outputs measured from the mean of many people.
#[derive(Clone, Copy)]
struct Shot {
    yaw_deg: f32,
    chin: f32,
    /// How much wider than usual the temples are.
    width: f32,
    outputs: [f32; COEFFS],
}

const REST: Shot = Shot { yaw_deg: 0.0, chin: -1.4, width: 0.0, outputs: [0.0; COEFFS] };

impl Shot {
    fn with(self, blendshapes: &[usize], value: f32) -> Self {
        let mut outputs = self.outputs;
        for index in blendshapes {
            outputs[*index] = value;
        }
        Self { outputs, ..self }
    }

    fn face(&self) -> Normalised {
        let landmarks: Landmarks = testing::face([self.yaw_deg, 0.0, 0.0], 80.0, [320.0, 240.0]);
        let mut face = normalise(&landmarks).expect("a face");
        face.points[CHIN] = [0.0, self.chin, 0.0];
        for (landmark, side) in [(389, 1.0), (251, 1.0), (340, 1.0), (162, -1.0), (21, -1.0), (111, -1.0)] {
            face.points[landmark] = [side * (1.0 + self.width), 0.0, 0.0];
        }
        face
    }
}

fn held(shot: Shot, frames: usize) -> impl Iterator<Item = Shot> {
    iter::repeat_n(shot, frames)
}

/// A jaw that opens and shuts three times a second.
fn speech(frame: usize) -> Shot {
    speech_of(0.25, frame)
}

/// The same with this amplitude.
fn speech_of(amplitude: f32, frame: usize) -> Shot {
    let open = 0.35 + amplitude * (0.6 * frame as f32).sin();
    Shot { chin: -1.4 - 0.4 * open, ..REST }.with(&[JAW_OPEN], open)
}

fn watch(estimate: &mut NeutralEstimate, mode: NeutralMode, shots: impl IntoIterator<Item = Shot>) {
    shots.into_iter().for_each(|shot| step(estimate, mode, &shot, FRAME_S));
}

/// Shows a frame, for which the regression gives less of what is at rest the more the wearer is known.
fn step(estimate: &mut NeutralEstimate, mode: NeutralMode, shot: &Shot, step_s: f32) {
    let mut raw = shot.outputs;
    raw.iter_mut().zip(&estimate.outputs).for_each(|(raw, rest)| *raw -= estimate.share * rest);
    estimate.update(mode, &shot.face(), &RawCoeffs(raw), step_s);
}

fn watched(shots: impl IntoIterator<Item = Shot>) -> NeutralEstimate {
    let mut estimate = NeutralEstimate::default();
    watch(&mut estimate, NeutralMode::Auto, shots);
    estimate
}

fn chin(estimate: &NeutralEstimate) -> f32 {
    estimate.used.measures[3 * CHIN + 1]
}

#[test]
fn face_at_rest_is_the_reference_within_half_a_minute() {
    let estimate = watched(held(REST, 30 * SECOND));
    assert!(estimate.share() > 0.95, "{}", estimate.share());
    assert!((chin(&estimate) + 1.4).abs() < 1e-3);
    assert!(watched(held(REST, SECOND)).share() < 0.06, "not at once");
}

#[test]
fn speaking_smiling_turned_and_shut_eyed_faces_are_never_learned() {
    let minute = 60 * SECOND;
    let shots =
        [REST.with(&SMILES, 0.5), REST.with(&BLINKS, 0.9), REST.with(&BLINKS, 0.32), Shot { yaw_deg: 25.0, ..REST }];
    for shot in shots {
        assert_eq!(watched((0..minute).map(|_| shot)).share().to_bits(), 0);
    }
    for amplitude in [0.2, 0.25] {
        let estimate = watched((0..minute).map(|frame| speech_of(amplitude, frame)));
        assert!(estimate.share() < 0.05, "{amplitude}: {}", estimate.share());
    }
}

#[test]
fn two_seconds_of_rest_in_a_minute_of_speech_are_enough() {
    let estimate =
        watched((0..60 * SECOND).map(|frame| if (300..360).contains(&frame) { REST } else { speech(frame) }));
    assert!(estimate.share() > 0.8, "{}", estimate.share());
    assert!((chin(&estimate) + 1.4).abs() < 0.01, "{}", chin(&estimate));
}

#[test]
fn rest_outweighs_a_half_smile_that_is_held_much_longer() {
    let half_smile = Shot { chin: -1.3, ..REST }.with(&SMILES, 0.24);
    let estimate = watched(held(half_smile, 20 * SECOND).chain(held(REST, 20 * SECOND)));
    assert!((chin(&estimate) + 1.4).abs() < 0.02, "{}", chin(&estimate));
}

#[test]
fn half_smile_looks_no_more_like_rest_when_it_has_been_learned() {
    let shot = REST.with(&SMILES, 0.24);
    let mut estimate = watched(held(shot, 5 * SECOND));
    let weight = |estimate: &mut NeutralEstimate| {
        let before_s = estimate.evidence_s;
        step(estimate, NeutralMode::Auto, &shot, FRAME_S);
        estimate.evidence_s - before_s
    };
    let early = weight(&mut estimate);
    watch(&mut estimate, NeutralMode::Auto, held(shot, 40 * SECOND));
    assert!(estimate.share() > 0.3 && weight(&mut estimate) < 1.05 * early);
}

#[test]
fn share_and_reference_move_at_a_bounded_speed_while_rest_comes_and_people_change() {
    let other = Shot { chin: -1.6, width: 0.2, ..REST };
    let shots = held(REST, 40 * SECOND).chain(held(other, 40 * SECOND));
    let mut estimate = NeutralEstimate::default();
    let (mut least, mut most) = (0.0_f32, 0.0_f32);
    for shot in shots {
        let (share, chin_before) = (estimate.share, chin(&estimate));
        step(&mut estimate, NeutralMode::Auto, &shot, FRAME_S);
        (least, most) = (least.min(estimate.share - share), most.max(estimate.share - share));
        assert!(share == 0.0 || estimate.share == 0.0 || (chin(&estimate) - chin_before).abs() < 0.002);
    }
    assert!(most <= 1.01 * RISE_PER_S * FRAME_S && least >= -1.01 * FALL_PER_S * FRAME_S, "{least} {most}");
    assert_eq!(estimate.forgotten(), 1);
    assert!((chin(&estimate) + 1.6).abs() < 0.01 && estimate.share > 0.8, "{} {}", chin(&estimate), estimate.share);
}

#[test]
fn another_person_is_noticed_within_ten_seconds_with_and_without_a_gap() {
    let other = Shot { width: 0.2, ..REST };
    for gap_s in [FRAME_S, 60.0] {
        let mut estimate = watched(held(REST, 40 * SECOND));
        step(&mut estimate, NeutralMode::Auto, &other, gap_s);
        watch(&mut estimate, NeutralMode::Auto, held(other, 10 * SECOND));
        assert_eq!(estimate.forgotten(), 1, "{gap_s}");
    }
}

#[test]
fn wearer_who_looks_away_leaves_or_speaks_is_not_forgotten() {
    let mut estimate = watched(held(REST, 40 * SECOND));
    let away = Shot { yaw_deg: 40.0, ..REST };
    watch(&mut estimate, NeutralMode::Auto, held(away, 20 * SECOND));
    step(&mut estimate, NeutralMode::Auto, &REST, 60.0);
    watch(&mut estimate, NeutralMode::Auto, (0..20 * SECOND).map(speech));
    assert_eq!(estimate.forgotten(), 0);
    assert!(estimate.share() > 0.95);
}

#[test]
fn frozen_estimate_stays_and_one_that_is_off_fades_in_four_seconds() {
    let mut estimate = watched(held(REST, 20 * SECOND));
    let before = estimate.clone();
    watch(&mut estimate, NeutralMode::Frozen, held(Shot { chin: -1.7, width: 0.2, ..REST }, 20 * SECOND));
    assert_eq!((estimate.share(), &estimate.used), (before.share(), &before.used));
    watch(&mut estimate, NeutralMode::Off, held(REST, 2 * SECOND));
    assert!((0.3..0.6).contains(&estimate.share()), "{}", estimate.share());
    watch(&mut estimate, NeutralMode::Off, held(REST, 2 * SECOND));
    assert_eq!(estimate.reference(), Reference::MEAN);
    watch(&mut estimate, NeutralMode::Auto, held(REST, 20 * SECOND));
    assert!(estimate.share() > 0.9, "what was learned is still there");
}

#[test]
fn time_that_stands_still_or_jumps_changes_nothing_visible() {
    for step_s in [0.0, 1e9, f32::INFINITY] {
        let mut estimate = watched(held(REST, 20 * SECOND));
        let share = estimate.share();
        step(&mut estimate, NeutralMode::Auto, &REST, step_s);
        assert!((estimate.share() - share).abs() <= RISE_PER_S * LONGEST_STEP_S);
        watch(&mut estimate, NeutralMode::Auto, held(REST, 20 * SECOND));
        assert!(estimate.share() > 0.95 && estimate.used.measures.iter().all(|value| value.is_finite()), "{step_s}");
    }
}

/// The built-in model without the distances that it reads, and the mean neutral face of many people as far as it knows its
/// coordinates, with corners of the mouth that hang a little.
fn model_and_face() -> (Model, Landmarks) {
    let Regression::HiddenLayer(mut layer) = Model::embedded().regression else { panic!("a hidden layer") };
    let inputs = layer.inputs.iter().cloned().zip(layer.weights.iter().copied());
    let (inputs, weights): (Vec<_>, Vec<_>) = inputs.filter(|(input, _)| input.feature.index() < 3 * LANDMARKS).unzip();
    (layer.inputs, layer.weights) = (inputs.into(), weights.into());
    let mut points = [[0.0; 3]; LANDMARKS];
    for (landmark, point) in RIGID {
        points[landmark] = point.map(|value| value as f32);
    }
    for input in &layer.inputs {
        points.as_flattened_mut()[input.feature.index()] = input.neutral;
    }
    points[61][1] -= 0.06;
    points[291][1] -= 0.06;
    (
        Model::of(Regression::HiddenLayer(layer)),
        Landmarks(points.map(|[x, y, z]| [320.0 + 80.0 * x, 240.0 - 80.0 * y, -80.0 * z])),
    )
}

#[test]
fn still_face_moves_by_less_than_a_200th_a_frame_while_its_estimate_comes_in_and_goes() {
    let (model, face) = model_and_face();
    let mut solver = Solver::new(model, Profile::default(), Shaping::only(Filters::OFF));
    let camera = Camera::new([640.0, 480.0], 60.0);
    let mut shown: Vec<[f32; COEFFS]> = Vec::new();
    for frame in 0..40 * SECOND as u64 {
        solver.neutral_mode = if frame < 30 * SECOND as u64 { NeutralMode::Auto } else { NeutralMode::Off };
        shown.push(solver.solve(&face, &camera, 33_333 * frame).expect("a face").raw.0);
        assert!(frame != 29 * SECOND as u64 || solver.neutral_share() > 0.5, "{}", solver.neutral_share());
    }
    let change = |a: &[f32; COEFFS], b: &[f32; COEFFS]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let largest = shown.windows(2).map(|pair| change(&pair[0], &pair[1])).fold(0.0, f32::max);
    assert!(largest < 0.005, "{largest}");
    let learned = change(&shown[0], &shown[29 * SECOND]);
    assert!(learned > 0.02, "the estimate makes a difference: {learned}");
    assert!(change(&shown[0], &shown[40 * SECOND - 1]) < 1e-4, "without it, all is as before");
}
