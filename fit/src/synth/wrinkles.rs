//! Wrinkles that come with an expression: folds from nose to mouth, lines on forehead and brow, and crow's feet.
//!
//! A wrinkle darkens vertices, which lie about 2 millimetres apart. Its depth is a weighted sum of coefficients.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::{anatomy::index_of, expression::Coefficients, geometry::smoothstep, rig::Rig};

pub struct Wrinkles(Vec<Wrinkle>);

struct Wrinkle {
    drivers: Vec<(usize, f32)>,
    lines: Vec<(u32, f32)>,
}

/// Depth of a group of lines at a position, whose x is mirrored for the right side.
type Pattern = fn(Vec2) -> f32;

/// Patterns of each side with the coefficients that drive them, without `Left` or `Right`.
const GROUPS: [(Pattern, &[(&str, f32)]); 4] = [
    (nose_to_mouth, &[("mouthSmile", 0.9), ("noseSneer", 0.7), ("mouthUpperUp", 0.5), ("cheekSquint", 0.3)]),
    (forehead, &[("browOuterUp", 0.6), ("browInnerUp", 0.7)]),
    (between_brows, &[("browDown", 1.0), ("noseSneer", 0.3)]),
    (crows_feet, &[("eyeSquint", 0.6), ("cheekSquint", 0.6), ("mouthSmile", 0.4), ("eyeBlink", 0.15)]),
];

impl Wrinkles {
    pub fn new(rig: &Rig) -> Self {
        let sides = [("Left", 1.0), ("Right", -1.0)];
        let groups = sides.iter().flat_map(|side| GROUPS.iter().map(move |group| (side, group)));
        Self(
            groups
                .map(|((side, sign), (pattern, names))| Wrinkle {
                    drivers: names.iter().map(|(name, depth)| (driver(name, side), *depth)).collect(),
                    lines: lines(rig, *sign, *pattern),
                })
                .collect(),
        )
    }

    /// Calls `darken(vertex, depth)` for every vertex of every line that an expression shows. Depths are 0 to 1.
    pub fn each(&self, weights: &Coefficients, mut darken: impl FnMut(usize, f32)) {
        for wrinkle in &self.0 {
            let depth: f32 = wrinkle.drivers.iter().map(|(index, depth)| depth * weights[*index]).sum();
            if depth > 0.05 {
                wrinkle.lines.iter().for_each(|(vertex, line)| darken(*vertex as usize, depth.min(1.0) * line));
            }
        }
    }
}

/// Returns the number of a coefficient of one side, or of the one without sides.
fn driver(name: &str, side: &str) -> usize {
    if name == "browInnerUp" { index_of(name) } else { index_of(&format!("{name}{side}")) }
}

fn lines(rig: &Rig, sign: f32, pattern: Pattern) -> Vec<(u32, f32)> {
    let depth = |(vertex, point): (u32, &Vec3)| {
        let beside = point.truncate() * Vec2::new(sign, 1.0);
        let front = point.z > 5.0 && beside.x >= 0.0;
        let depth = if front { pattern(beside) } else { 0.0 };
        (depth > 0.02).then_some((vertex, depth))
    };
    (0..).zip(&rig.neutral).filter_map(depth).collect()
}

fn nose_to_mouth(at: Vec2) -> f32 {
    let (from, to) = (Vec2::new(1.9, -0.6), Vec2::new(3.6, -4.6));
    let along = ((at - from).dot(to - from) / (to - from).length_squared()).clamp(0.0, 1.0);
    let away = (at - from.lerp(to, along)).length();
    smoothstep(0.45, 0.1, away) * (1.0 - 0.6 * along)
}

fn forehead(at: Vec2) -> f32 {
    let height = at.y + 0.03 * at.x * at.x;
    let inside = smoothstep(7.0, 7.5, height) * smoothstep(10.2, 9.4, height) * smoothstep(5.2, 3.6, at.x);
    inside * line((height - 7.2) / 0.85)
}

fn between_brows(at: Vec2) -> f32 {
    let inside = smoothstep(4.2, 4.8, at.y) * smoothstep(7.2, 6.4, at.y);
    inside * smoothstep(0.4, 0.1, (at.x - 0.55).abs())
}

/// Lines that spread from the outer corner of the eye.
fn crows_feet(at: Vec2) -> f32 {
    let offset = at - Vec2::new(4.4, 3.4);
    let away = offset.length();
    let inside = smoothstep(0.5, 0.9, away) * smoothstep(2.3, 1.5, away) * smoothstep(0.2, 0.6, offset.x);
    inside * line(offset.y.atan2(offset.x) / 0.5)
}

/// Returns a periodic line: 1 at whole numbers, and 0 between them.
fn line(phase: f32) -> f32 {
    (TAU * phase).cos().max(0.0)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use facewire_face::COEFFS;

    use super::*;
    use crate::reference;

    #[test]
    fn a_smile_on_one_side_folds_that_side_only_and_a_resting_face_is_smooth() {
        let rig = Rig::load(Path::new(reference::RIG)).expect("a rig");
        let wrinkles = Wrinkles::new(&rig);
        let shown = |name: Option<&str>| {
            let mut weights = [0.0; COEFFS];
            if let Some(name) = name {
                weights[index_of(name)] = 1.0;
            }
            let mut seen = Vec::new();
            wrinkles.each(&weights, |vertex, depth| seen.push((vertex, depth)));
            seen
        };
        assert!(shown(None).is_empty());
        let smile = shown(Some("mouthSmileLeft"));
        assert!(smile.len() > 50 && smile.iter().all(|(vertex, _)| rig.neutral[*vertex].x >= 0.0));
        let brows = shown(Some("browInnerUp"));
        assert!(brows.iter().any(|(vertex, _)| rig.neutral[*vertex].x > 1.0));
        assert!(brows.iter().any(|(vertex, _)| rig.neutral[*vertex].x < -1.0));
        assert!(brows.iter().all(|(vertex, depth)| rig.neutral[*vertex].y > 6.0 && (0.0..=1.0).contains(depth)));
    }
}
