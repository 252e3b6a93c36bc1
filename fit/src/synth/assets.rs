//! The assets of all pictures, loaded once: rig, textures, and data precomputed from them.

use core::f32::consts::TAU;
use std::path::Path;

use anyhow::{Result, ensure};
use facewire_face::COEFFS;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::expression::{Coefficients, Deformer};
use super::rig::{Rig, SimpleMesh, Triangle, normals, smoothstep, vertices_of};
use super::shade::ambient_occlusion;
use super::textures::{Brow, Layout, Skin, Texture, ball_offsets};
use super::tongue::below_tongue;
use super::visible::{REGIONS, regions};
use crate::output;
use crate::shapes::{find, index_of};

/// Least visibility of the sky, because indirect light reaches every vertex.
const LEAST_VISIBILITY: f32 = 0.03;
/// Details smaller than this cast no shadow of their own, in centimetres.
const CASTER_CELL: f32 = 0.6;
/// Between these heights the neck's motion changes from the head's to the shoulders', in centimetres.
const NECK: [f32; 2] = [-8.5, -15.0];
/// Bounding sphere of the head for lighting: centre and radius.
pub const BOUNDS: (Vec3, f32) = (Vec3::new(0.0, -1.0, 2.0), 21.0);

pub struct Assets {
    pub rig: Rig,
    pub deformer: Deformer,
    pub layout: Layout,
    /// Names of skins, brows and eyes: their file names without extension.
    pub names: [Vec<String>; 3],
    /// In the order of their names, as brows and eyes.
    pub skins: Vec<Skin>,
    pub brows: Vec<Brow>,
    pub eyes: Vec<Texture>,
    pub occlusion: AmbientOcclusion,
    pub rest_normals: Vec<Vec3>,
    /// Weight of the shoulders' motion, against the head's, for each vertex.
    pub shoulder: Vec<f32>,
    /// Offset of each eyeball vertex from its ball's centre relative to the ball's radius, and 0 for other vertices.
    pub ball_offsets: Vec<Vec3>,
    pub is_skin: Vec<bool>,
    pub surface: Vec<Triangle>,
    pub wrinkles: Wrinkles,
    pub caster: SimpleMesh,
    pub mouth: Vec<u32>,
    pub below_tongue: Vec<u32>,
    /// Vertices of each region whose visibility is measured.
    pub regions: [Vec<usize>; REGIONS],
}

/// Indices of the skins, brows and eyes to draw from, at least one of each.
pub type TextureChoice = [Vec<usize>; 3];

/// Share of the sky that is visible from each vertex.
pub struct AmbientOcclusion {
    rest: Vec<f32>,
    /// Change of the visibility at coefficient 1, for coefficients that open and shut mouth and lids.
    changes: Vec<(usize, Vec<f32>)>,
}

impl Assets {
    /// Loads the assets from the folder of a rig, whose layout is described in `fit/README.md`.
    pub fn load(folder: &Path) -> Result<Self> {
        let rig = Rig::load(folder)?;
        let deformer = Deformer::new(&rig)?;
        let layout = Layout::new(&rig);
        let [skins, brows, eyes] = ["skins", "brows", "eyes"].map(|kind| textures(&folder.join(kind)));
        let [(skin_names, skins), (brow_names, brows), (eye_names, eyes)] = [skins?, brows?, eyes?];
        let skins = skins.into_par_iter().map(|texture| Skin::new(texture, &rig, &layout));
        let brows = brows.into_iter().map(|texture| Brow::new(texture, &rig));
        let parts = &rig.parts;
        let surface = [parts.skin.as_slice(), &parts.gums, &parts.teeth, &parts.eyes[0], &parts.eyes[1]].concat();
        Ok(Self {
            occlusion: AmbientOcclusion::new(&rig, &deformer, &surface),
            rest_normals: normals(&rig.neutral, &surface),
            shoulder: rig.neutral.iter().map(|point| smoothstep(-NECK[0], -NECK[1], -point.y)).collect(),
            ball_offsets: ball_offsets(&rig),
            is_skin: is_skin(&rig),
            mouth: vertices_of(&[parts.gums.as_slice(), &parts.teeth].concat()),
            below_tongue: below_tongue(&rig),
            regions: regions(&rig),
            wrinkles: Wrinkles::new(&rig),
            caster: SimpleMesh::new(&rig.neutral, &rig.parts.skin, CASTER_CELL),
            surface,
            names: [skin_names, brow_names, eye_names],
            skins: skins.collect(),
            brows: brows.collect::<Result<_>>()?,
            eyes,
            layout,
            deformer,
            rig,
        })
    }
}

fn is_skin(rig: &Rig) -> Vec<bool> {
    let mut skin = vec![false; rig.neutral.len()];
    rig.parts.skin.iter().flatten().for_each(|vertex| skin[*vertex as usize] = true);
    skin
}

pub fn textures(folder: &Path) -> Result<(Vec<String>, Vec<Texture>)> {
    let paths = output::files(folder, &["png", "jpg"])?;
    ensure!(!paths.is_empty(), "{} contains no PNG or JPEG images", folder.display());
    let names = paths.iter().filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned())).collect();
    Ok((names, paths.par_iter().map(|path| Texture::load(path)).collect::<Result<_>>()?))
}

impl AmbientOcclusion {
    fn new(rig: &Rig, deformer: &Deformer, surface: &[Triangle]) -> Self {
        let moved = ["jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthFunnel", "mouthSmileLeft", "mouthSmileRight"];
        let baked = |weights: &Coefficients| {
            let mut points = Vec::new();
            deformer.deform(rig, &rig.neutral, weights, &mut points);
            ambient_occlusion(&points, &normals(&points, surface), surface, BOUNDS)
        };
        let rest = baked(&[0.0; COEFFS]);
        let change = |name: &&str| {
            let (coefficient, mut weights) = (index_of(name), [0.0; COEFFS]);
            weights[coefficient] = 1.0;
            (coefficient, baked(&weights).iter().zip(&rest).map(|(there, here)| there - here).collect())
        };
        Self { changes: moved.iter().map(change).collect(), rest }
    }

    pub fn visibility(&self, weights: &Coefficients, out: &mut Vec<f32>) {
        out.clear();
        out.extend_from_slice(&self.rest);
        for (coefficient, change) in &self.changes {
            let weight = weights[*coefficient];
            if weight != 0.0 {
                out.iter_mut().zip(change).for_each(|(share, change)| *share += weight * change);
            }
        }
        out.iter_mut().for_each(|share| *share = share.clamp(LEAST_VISIBILITY, 1.0));
    }
}

// Wrinkles that come with an expression: folds from nose to mouth, lines on forehead and brow, and crow's feet. A wrinkle
// darkens vertices, which lie about 2 millimetres apart. Its depth is a weighted sum of coefficients.

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
        let driver = |name: &str, side: &str| find(name).unwrap_or_else(|| index_of(&format!("{name}{side}")));
        let wrinkle = |((side, sign), (pattern, names)): (&(&str, f32), &(Pattern, &[(&str, f32)]))| Wrinkle {
            drivers: names.iter().map(|(name, depth)| (driver(name, side), *depth)).collect(),
            lines: lines(rig, *sign, *pattern),
        };
        Self(groups.map(wrinkle).collect())
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
