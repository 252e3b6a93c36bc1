//! What the person of a clip does: acts one after the other, each a part of the clip with a name.

use std::f32::consts::TAU;
use std::ops::Range;

use anyhow::{Context, Result};
use clap::ValueEnum;
use facewire_face::{BLENDSHAPES, COEFFS};
use rand::RngExt;
use rand::seq::IteratorRandom;
use rand_chacha::ChaCha8Rng;

use super::acting::{APART, HALVES_SCALE, with_upper};
use super::anatomy::{Gaze, enforce_limits, mirrored};
use super::expression::{Coefficients, GAZE_DEG};
use super::rig::{piecewise, smoothstep};
use crate::shapes::{MODELLED, find, index_of};

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Script {
    /// A face that follows recordings, after half a second at rest
    Recordings,
    /// The same face, but the eyes look at one point after another, up to 30 degrees to the sides and 20 up and down
    Gaze,
    /// A wearer: at rest under three lights, the takes of a calibration, a minute of recordings to learn from and 20
    /// seconds to judge, blinks, winks, and a turned head. The length is fixed, and NAME.parts.csv tells where each part is
    Wearer,
    /// Every coefficient follows a sine, one after the other, with the head still. The length is fixed, and NAME.parts.csv
    /// tells where each coefficient is
    Sine,
}

#[derive(Debug, Clone, Copy)]
pub struct Moment {
    pub face: Coefficients,
    pub sway: f32,
    /// Yaw of the head in degrees, without the sway.
    pub yaw_deg: f32,
    pub light: Light,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    pub exposure: f32,
    /// Factor on the camera's noise, which amplifies a dim picture.
    pub noise: f32,
}

pub struct Part {
    pub name: &'static str,
    pub moments: Vec<Moment>,
}

const FULL_LIGHT: Light = Light { exposure: 1.0, noise: 1.0 };
const STILL: [(&str, Light); 3] = [
    ("still-bright", FULL_LIGHT),
    ("still-dim", Light { exposure: 0.45, noise: 1.6 }),
    ("still-dark", Light { exposure: 0.2, noise: 2.5 }),
];
const STILL_S: f32 = 2.5;
/// A clip of recordings starts with a neutral face. Motion fades in between these times in seconds.
const START_S: [f32; 2] = [0.5, 1.5];

/// The poses of a calibration with their blendshapes, and the strength of each relative to that of the pose.
const POSES: [(&str, &[(&str, f32)]); 10] = [
    ("eyes-shut", &[("eyeBlink", 1.0), ("eyeSquint", 0.2)]),
    ("jaw-open", &[("jawOpen", 1.0), ("mouthStretch", 0.1), ("mouthLowerDown", 0.15)]),
    ("brows-up", &[("browInnerUp", 1.0), ("browOuterUp", 1.0), ("eyeWide", 0.35)]),
    ("brows-down", &[("browDown", 1.0), ("eyeSquint", 0.2), ("noseSneer", 0.15)]),
    ("smile", &[("mouthSmile", 1.0), ("cheekSquint", 0.5), ("mouthUpperUp", 0.2), ("mouthDimple", 0.1)]),
    ("pucker", &[("mouthPucker", 1.0), ("mouthFunnel", 0.3)]),
    ("look-left", &[("eyeLookOutLeft", 1.0), ("eyeLookInRight", 1.0)]),
    ("look-right", &[("eyeLookInLeft", 1.0), ("eyeLookOutRight", 1.0)]),
    ("look-up", &[("eyeLookUp", 1.0), ("browInnerUp", 0.1)]),
    ("look-down", &[("eyeLookDown", 1.0), ("eyeBlink", 0.25)]),
];
/// Length of a take. The pose is there between these times.
const TAKE_S: f32 = 3.0;
const HOLD_S: [f32; 2] = [1.0, 2.7];
const MOVE_S: f32 = 0.35;
/// How far people go when they are asked for their largest expression. Shut eyes are shut.
const STRENGTH: Range<f32> = 0.75..1.0;
const SIDES: Range<f32> = 0.92..1.0;
/// Share of its sway that a head keeps while it is asked to hold still.
const CALM: f32 = 0.1;

/// Length of what a wearer does before and while the result is judged, and of its stretches of recordings.
const TALK_S: usize = 60;
const JUDGED_S: usize = 20;
const STRETCH_S: usize = 5;
const FADE_S: f32 = 0.5;

impl Script {
    /// Whether the script has parts with names and a length of its own.
    pub fn is_fixed(self) -> bool {
        matches!(self, Self::Wearer | Self::Sine)
    }

    pub fn parts(self, rng: &mut ChaCha8Rng, recordings: &[Vec<Coefficients>], count: usize) -> Result<Vec<Part>> {
        match self {
            Self::Recordings | Self::Gaze => {
                let mut faces = random_curves(rng, recordings, count)?;
                if self == Self::Gaze {
                    look_around(rng, &mut faces);
                }
                let moment = |(number, face): (usize, Coefficients)| {
                    let share = smoothstep(START_S[0], START_S[1], number as f32 / RATE as f32);
                    Moment { sway: share, ..at_rest(face.map(|value| share * value)) }
                };
                Ok(vec![Part { name: "recordings", moments: faces.into_iter().enumerate().map(moment).collect() }])
            }
            Self::Wearer => wearer(rng, recordings),
            Self::Sine => Ok(sines(&(0..MODELLED).collect::<Vec<_>>())),
        }
    }
}

/// Length of a period of the sine, and how many of them each coefficient follows.
pub const PERIOD_S: f32 = 1.0;
const PERIODS: usize = 2;

/// Returns a part at rest, then one for each of these blendshapes, in which it alone follows a sine from 0 to 1.
pub fn sines(shapes: &[usize]) -> Vec<Part> {
    let [jaw_open, mouth_close] = ["jawOpen", "mouthClose"].map(index_of);
    let wave = |shape: &usize| {
        acted(BLENDSHAPES[*shape], PERIODS as f32 * PERIOD_S, |time_s| {
            let mut face = [0.0; COEFFS];
            face[*shape] = 0.5 - 0.5 * (TAU * time_s / PERIOD_S).cos();
            // Lips close over an open jaw.
            face[jaw_open] = face[jaw_open].max(face[mouth_close]);
            at_rest(face)
        })
    };
    let rest = acted("rest", START_S[0], |_| at_rest([0.0; COEFFS]));
    [rest].into_iter().chain(shapes.iter().map(wave)).collect()
}

/// The farthest that eyes look to the sides, and up and down, as shares of their range.
const FARTHEST: [f32; 2] = [30.0 / GAZE_DEG[0], 20.0 / GAZE_DEG[1]];
const FIXATION_S: Range<f32> = 0.25..1.2;
const SACCADE_S: f32 = 0.05;

/// Makes the eyes rest on one point after another.
fn look_around(rng: &mut ChaCha8Rng, faces: &mut [Coefficients]) {
    let mut knots = [vec![(0.0, 0.0)], vec![(0.0, 0.0)]];
    let mut begin_s = START_S[1];
    while begin_s < faces.len() as f32 / RATE as f32 {
        for (knots, farthest) in knots.iter_mut().zip(FARTHEST) {
            let (_, last) = knots[knots.len() - 1];
            knots.extend([(begin_s, last), (begin_s + SACCADE_S, rng.random_range(-farthest..farthest))]);
        }
        begin_s += rng.random_range(FIXATION_S);
    }
    for (frame, face) in faces.iter_mut().enumerate() {
        let [left, up] = [0, 1].map(|axis: usize| piecewise(&knots[axis], frame as f32 / RATE as f32));
        Gaze { left, up, ..Gaze::of(face) }.set(face);
    }
}

fn wearer(rng: &mut ChaCha8Rng, recordings: &[Vec<Coefficients>]) -> Result<Vec<Part>> {
    let still = |(name, light)| acted(name, STILL_S, |_| Moment { light, ..at_rest([0.0; COEFFS]) });
    let mut parts: Vec<Part> = STILL.map(still).into();
    parts.push(acted("neutral", TAKE_S, |_| Moment { sway: CALM, ..at_rest([0.0; COEFFS]) }));
    for (name, shapes) in POSES {
        let pose = pose(rng, name, shapes);
        parts.push(acted(name, TAKE_S, |time_s| {
            let [from, to] = HOLD_S;
            let share = smoothstep(from - MOVE_S, from, time_s) - smoothstep(to, to + MOVE_S, time_s);
            Moment { sway: CALM, ..at_rest(pose.map(|value| share * value)) }
        }));
    }
    parts.push(follow("talk", rng, recordings, TALK_S)?);
    parts.push(follow("judged", rng, recordings, JUDGED_S)?);
    parts.extend([blinks(rng), winks(), turned()]);
    Ok(parts)
}

fn at_rest(face: Coefficients) -> Moment {
    Moment { face, sway: 0.0, yaw_deg: 0.0, light: FULL_LIGHT }
}

fn acted(name: &'static str, seconds: f32, moment: impl Fn(f32) -> Moment) -> Part {
    Part { name, moments: (0..frames(seconds)).map(|frame| moment(frame as f32 / RATE as f32)).collect() }
}

fn frames(seconds: f32) -> usize {
    (seconds * RATE as f32).round() as usize
}

/// Draws how a person shows a pose. Names without a side stand for both sides.
pub fn pose(rng: &mut ChaCha8Rng, name: &str, shapes: &[(&str, f32)]) -> Coefficients {
    let strength = if name == "eyes-shut" { 1.0 } else { rng.random_range(STRENGTH) };
    let mut face = [0.0; COEFFS];
    for (shape, share) in shapes {
        let sides = [format!("{shape}Left"), format!("{shape}Right"), (*shape).to_owned()];
        for index in sides.iter().filter_map(|side| find(side)) {
            let side = if name == "eyes-shut" { 1.0 } else { rng.random_range(SIDES) };
            face[index] = strength * share * side;
        }
    }
    face
}

fn follow(name: &'static str, rng: &mut ChaCha8Rng, recordings: &[Vec<Coefficients>], seconds: usize) -> Result<Part> {
    let rate = RATE as usize;
    let fade = frames(FADE_S);
    let mut faces: Vec<Coefficients> = Vec::with_capacity(seconds * rate);
    while faces.len() < seconds * rate {
        let next = random_curves(rng, recordings, STRETCH_S * rate + fade)?;
        let begin = faces.len().saturating_sub(fade);
        for (number, face) in next.into_iter().enumerate() {
            match faces.get_mut(begin + number) {
                Some(before) => {
                    let share = smoothstep(0.0, fade as f32, number as f32);
                    *before = core::array::from_fn(|shape| before[shape] + share * (face[shape] - before[shape]));
                }
                None => faces.push(face),
            }
        }
    }
    faces.truncate(seconds * rate);
    let ends = |frame: usize| {
        let [from_start, to_end] = [frame, faces.len() - 1 - frame].map(|frames| frames as f32 / RATE as f32);
        smoothstep(0.0, 1.0, from_start.min(to_end))
    };
    let moment = |(frame, face): (usize, &Coefficients)| {
        let share = ends(frame);
        Moment { sway: share, ..at_rest(face.map(|value| share * value)) }
    };
    Ok(Part { name, moments: faces.iter().enumerate().map(moment).collect() })
}

/// How far a lid is shut in a blink, by the time since its beginning in seconds: 130 ms, of which it is shut for 50 ms.
const BLINK: [(f32, f32); 4] = [(0.0, 0.0), (0.035, 1.0), (0.085, 1.0), (0.13, 0.0)];

pub fn blinks(rng: &mut ChaCha8Rng) -> Part {
    let starts: Vec<f32> = (0..6).map(|number| 0.5 + number as f32 + rng.random_range(0.0..0.3)).collect();
    let [left, right] = ["eyeBlinkLeft", "eyeBlinkRight"].map(index_of);
    acted("blinks", 6.5, |time_s| {
        let shut = starts.iter().map(|start| piecewise(&BLINK, time_s - start)).fold(0.0, f32::max);
        let mut face = [0.0; COEFFS];
        (face[left], face[right]) = (shut, shut);
        at_rest(face)
    })
}

const WINK_S: f32 = 1.2;

/// Winks of the left eye, then of the right, twice each. A cheek rises with its lid.
fn winks() -> Part {
    acted("winks", 5.0, |time_s| {
        let since_s = time_s % WINK_S;
        let shut = smoothstep(0.3, 0.4, since_s) - smoothstep(0.75, 0.9, since_s);
        let side = if time_s < 2.0 * WINK_S { "Left" } else { "Right" };
        let mut face = [0.0; COEFFS];
        if time_s < 4.0 * WINK_S {
            face[index_of(&format!("eyeBlink{side}"))] = shut;
            face[index_of(&format!("cheekSquint{side}"))] = 0.4 * shut;
        }
        at_rest(face)
    })
}

fn turned() -> Part {
    const YAW: [(f32, f32); 6] = [(0.0, 0.0), (1.0, 30.0), (2.0, 30.0), (3.5, -30.0), (4.5, -30.0), (5.5, 0.0)];
    acted("turned", 6.0, |time_s| Moment { yaw_deg: piecewise(&YAW, time_s), ..at_rest([0.0; COEFFS]) })
}

pub const RATE: u32 = 30;
/// Largest yaw, pitch and roll (degrees) and displacement along x, y and z (centimetres) of a head, and the smallest
/// share of them that a clip reaches.
const SWAY: [f32; 6] = [22.0, 12.0, 8.0, 2.5, 1.5, 4.0];
const LEAST_SWAY: f32 = 0.75;
/// Number of waves that a motion consists of, and the range of their frequencies.
const WAVES: usize = 4;
const HERTZ: Range<f32> = 0.08..0.7;
const SLOW_HERTZ: f32 = 0.2;

/// Returns the curves of a clip. Upper and lower half of the face follow stretches of recordings from different moments,
/// each mirrored in half of the clips, with each coefficient scaled.
pub fn random_curves(
    rng: &mut ChaCha8Rng,
    recordings: &[Vec<Coefficients>],
    count: usize,
) -> Result<Vec<Coefficients>> {
    let of = |(recording, frames): (usize, &Vec<Coefficients>)| {
        let last = (frames.len() + 1).saturating_sub(count);
        (0..last).map(move |first| (recording, first))
    };
    let all: Vec<(usize, usize)> = recordings.iter().enumerate().flat_map(of).collect();
    let short = "the recordings of this set are too short for two stretches of this length: choose fewer --seconds";
    let upper = *all.iter().choose(rng).context(short)?;
    let lower =
        *all.iter().filter(|own| own.0 != upper.0 || own.1.abs_diff(upper.1) >= APART).choose(rng).context(short)?;
    let [upper, lower] = [upper, lower].map(|(recording, first)| {
        let frames = &recordings[recording][first..][..count];
        if rng.random() { frames.iter().map(mirrored).collect() } else { frames.to_vec() }
    });
    let gains: Coefficients = core::array::from_fn(|_| rng.random_range(HALVES_SCALE));
    let faces = upper.iter().zip(&lower).map(|(upper, lower)| {
        let face = with_upper(upper, lower);
        let mut face = core::array::from_fn(|index| (gains[index] * face[index]).min(1.0));
        enforce_limits(&mut face);
        face
    });
    Ok(faces.collect())
}

pub fn random_sway(rng: &mut ChaCha8Rng, count: usize) -> Vec<[f32; 6]> {
    let motions = SWAY.map(|largest| {
        let waves: [_; WAVES] = core::array::from_fn(|_| {
            let hertz: f32 = rng.random_range(HERTZ);
            let size = rng.random_range(0.3..1.0) * (SLOW_HERTZ / hertz).min(1.0);
            (size, hertz, rng.random_range(0.0..TAU))
        });
        let at = |frame: usize| {
            let time_s = frame as f32 / RATE as f32;
            waves.iter().map(|(size, hertz, phase)| size * (TAU * hertz * time_s + phase).sin()).sum::<f32>()
        };
        let motion: Vec<f32> = (0..count).map(at).collect();
        let peak = motion.iter().map(|value| value.abs()).fold(f32::MIN_POSITIVE, f32::max);
        let scale = largest * rng.random_range(LEAST_SWAY..1.0) / peak;
        motion.into_iter().map(|value| scale * value).collect::<Vec<f32>>()
    });
    (0..count).map(|frame| core::array::from_fn(|axis| motions[axis][frame])).collect()
}
