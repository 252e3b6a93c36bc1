//! Deforms the head by ARKit coefficients: moves the vertices of the rig's shapes and rotates the eyeballs. `tongueOut`
//! has no shape: see `tongue.rs`.

use std::collections::HashSet;

use anyhow::{Context, Result, ensure};
use facewire_face::{BLENDSHAPES, COEFFS};
use glam::{Mat3, Vec3};

use super::rig::{Rig, Triangle, vertices_of};
use crate::shapes::index_of;

pub type Coefficients = [f32; COEFFS];

/// Rotation of the rig's eyeballs per unit of `eyeLook`, sideways and up or down. The solver has ARKit's `FULL_GAZE_DEG`.
pub const GAZE_DEG: [f32; 2] = [34.7, 31.9];

/// The coefficients that roll in the upper and the lower lip.
pub const ROLLS: [&str; 2] = ["mouthRollUpper", "mouthRollLower"];
/// How far, in centimetres, a row of teeth and its gums move back when its lip is fully rolled in. A rolled-in lip hides the
/// edges of the teeth, but the rig's lip would pass through them and bare them.
const WITHDRAWAL_CM: f32 = 1.4;

pub struct Deformer {
    drivers: Vec<(usize, usize, f32)>,
    eyes: [Eye; 2],
    /// The vertices of the upper and the lower teeth with their gums, and the coefficient that rolls in their lip.
    rows: [(Vec<u32>, usize); 2],
}

struct Eye {
    vertices: Vec<u32>,
    look: [usize; 4],
    /// The outward direction along x: 1 for the person's left eye, -1 for the right.
    out: f32,
}

impl Deformer {
    pub fn new(rig: &Rig) -> Result<Self> {
        let shown = BLENDSHAPES.iter().enumerate().filter(|(_, name)| **name != "tongueOut");
        let drivers = shown.map(|(coefficient, name)| drivers(rig, coefficient, name)).collect::<Result<Vec<_>>>()?;
        let [left, right] = &rig.parts.eyes;
        let eyes = [Eye::new(left, "Left", 1.0), Eye::new(right, "Right", -1.0)];
        let [upper, lower] = rows(rig)?;
        let [rolls_upper, rolls_lower] = ROLLS.map(index_of);
        let rows = [(upper, rolls_upper), (lower, rolls_lower)];
        Ok(Self { drivers: drivers.into_iter().flatten().collect(), eyes, rows })
    }

    pub fn deform(&self, rig: &Rig, base: &[Vec3], weights: &Coefficients, out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(base);
        for (coefficient, shape, gain) in &self.drivers {
            let weight = weights[*coefficient] * gain;
            if weight != 0.0 {
                for (vertex, offset) in &rig.shapes[*shape].moves {
                    out[*vertex as usize] += weight * *offset;
                }
            }
        }
        self.eyes.iter().for_each(|eye| eye.turn(weights, out));
        for (row, roll) in &self.rows {
            row.iter().for_each(|vertex| out[*vertex as usize].z -= WITHDRAWAL_CM * weights[*roll]);
        }
    }
}

/// Returns the vertices of the upper and the lower teeth with their gums. The lower ones move with the jaw.
fn rows(rig: &Rig) -> Result<[Vec<u32>; 2]> {
    let jaw = rig.shape("jawOpen").context("the rig has no shape for jawOpen")?;
    let moving: HashSet<u32> = rig.shapes[jaw].moves.iter().map(|(vertex, _)| *vertex).collect();
    let mouth = vertices_of(&[rig.parts.gums.as_slice(), &rig.parts.teeth].concat());
    let (lower, upper) = mouth.into_iter().partition(|vertex| moving.contains(vertex));
    Ok([upper, lower])
}

fn drivers(rig: &Rig, coefficient: usize, name: &str) -> Result<Vec<(usize, usize, f32)>> {
    let gain = 1.0 / ratio(name).with_context(|| format!("no amplitude of {name}"))?;
    let found = rig_names(name).into_iter().filter_map(|name| rig.shape(&name));
    let drivers: Vec<_> = found.map(|shape| (coefficient, shape, gain)).collect();
    ensure!(!drivers.is_empty(), "the rig has no shape for {name}");
    Ok(drivers)
}

/// Returns the possible names of a blendshape in the rig, which splits some blendshapes into two halves.
fn rig_names(name: &str) -> Vec<String> {
    let sides = [("Left", "_L"), ("Right", "_R")];
    let one_side = sides.iter().find_map(|(side, ending)| Some(format!("{}{ending}", name.strip_suffix(side)?)));
    let halves = ["_L", "_R"].map(|ending| format!("{name}{ending}"));
    [name.to_owned()].into_iter().chain(one_side).chain(halves).collect()
}

impl Eye {
    fn new(triangles: &[Triangle], side: &str, out: f32) -> Self {
        let look = ["In", "Out", "Up", "Down"].map(|to| index_of(&format!("eyeLook{to}{side}")));
        Self { vertices: vertices_of(triangles), look, out }
    }

    fn turn(&self, weights: &Coefficients, points: &mut [Vec3]) {
        let rotation = gaze(self.look.map(|index| weights[index]), self.out);
        if rotation == Mat3::IDENTITY {
            return;
        }
        let centre = self.centre(points);
        for vertex in &self.vertices {
            let point = &mut points[*vertex as usize];
            *point = centre + rotation * (*point - centre);
        }
    }

    /// Returns the centre of the eyeball. Its depth follows from its width, because the cornea bulges.
    fn centre(&self, points: &[Vec3]) -> Vec3 {
        let bound = |pick: fn(Vec3, Vec3) -> Vec3, start: Vec3| {
            self.vertices.iter().fold(start, |bound, vertex| pick(bound, points[*vertex as usize]))
        };
        let (least, most) = (bound(Vec3::min, Vec3::INFINITY), bound(Vec3::max, Vec3::NEG_INFINITY));
        let middle = f32::midpoint(least.x, most.x);
        Vec3::new(middle, f32::midpoint(least.y, most.y), least.z + (most.x - least.x) / 2.0)
    }
}

/// Returns the rotation of an eyeball from `[in, out, up, down]`. `out` is 1 for the left eye, -1 for the right.
pub fn gaze([inward, outward, up, down]: [f32; 4], out: f32) -> Mat3 {
    head_rotation(out * (outward - inward) * GAZE_DEG[0], (down - up) * GAZE_DEG[1], 0.0)
}

/// Returns the rotation for yaw to the person's left, pitch nodding down, and roll to the right shoulder.
pub fn head_rotation(yaw_deg: f32, pitch_deg: f32, roll_deg: f32) -> Mat3 {
    let [yaw, pitch, roll] = [yaw_deg, pitch_deg, roll_deg].map(f32::to_radians);
    Mat3::from_rotation_z(roll) * Mat3::from_rotation_x(pitch) * Mat3::from_rotation_y(yaw)
}

/// Amplitude of the rig's shapes divided by that of ARKit's, by name without the side. The amplitude is the largest
/// displacement divided by the distance of the eyes. Weights are divided by this factor, so that a coefficient of 1 means
/// ARKit's motion. `eyeLookIn` and `eyeLookOut` refer to the lids. Two shapes are defined by contact instead: `eyeBlink`
/// shuts the lid at 1, and lips meet where `mouthClose` equals `jawOpen`.
const RATIOS: [(&str, f32); 33] = [
    ("browDown", 0.74),
    ("browInnerUp", 0.56),
    ("browOuterUp", 0.74),
    ("cheekPuff", 1.51),
    ("cheekSquint", 0.82),
    ("eyeBlink", 1.0),
    ("eyeLookDown", 1.75),
    ("eyeLookIn", 0.67),
    ("eyeLookOut", 0.71),
    ("eyeLookUp", 1.0),
    ("eyeSquint", 0.75),
    ("eyeWide", 1.03),
    ("jawForward", 1.23),
    ("jawLeft", 1.02),
    ("jawRight", 1.02),
    ("jawOpen", 1.05),
    ("mouthClose", 1.25),
    ("mouthDimple", 0.88),
    ("mouthFrown", 0.88),
    ("mouthFunnel", 0.87),
    ("mouthLeft", 1.57),
    ("mouthLowerDown", 0.65),
    ("mouthPress", 0.42),
    ("mouthPucker", 1.09),
    ("mouthRight", 1.57),
    ("mouthRollLower", 1.57),
    ("mouthRollUpper", 1.14),
    ("mouthShrugLower", 1.55),
    ("mouthShrugUpper", 1.32),
    ("mouthSmile", 0.86),
    ("mouthStretch", 0.75),
    ("mouthUpperUp", 0.94),
    ("noseSneer", 2.14),
];

pub fn ratio(name: &str) -> Option<f32> {
    let stem = name.strip_suffix("Left").or_else(|| name.strip_suffix("Right")).unwrap_or(name);
    // A name like `jawLeft` ends with a direction of motion instead of a side.
    RATIOS.iter().find(|(known, _)| [name, stem].contains(known)).map(|(_, ratio)| *ratio)
}
