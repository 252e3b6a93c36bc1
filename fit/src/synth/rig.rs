//! The face rig: a head with expression shapes and identity modes, loaded from a folder.
//!
//! The folder holds `rig.npz` (arrays) and `rig.json` (names of materials and expressions, vertices of 68 landmarks),
//! described in `fit/README.md`. Units are centimetres, with x to the person's left, y up, and z out of the face.
//!
//! Materials that only suit ray tracing (tear fluid, eye occlusion, the inner iris) are not used.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::arrays::Arrays;

/// Shorter offsets of an expression, in centimetres, are treated as 0.
const LEAST_MOVE: f32 = 0.002;
const EYE_CORNERS: [usize; 4] = [36, 39, 42, 45];
/// Lashes higher than this above the eye corners belong to the upper lids, in centimetres.
const UPPER_LASH: f32 = 0.12;

pub type Triangle = [u32; 3];

pub struct Rig {
    pub neutral: Vec<Vec3>,
    pub shapes: Vec<Shape>,
    pub identities: Vec<Vec<Vec3>>,
    pub skin_uv: Vec<Vec2>,
    pub landmarks: Vec<usize>,
    pub parts: Parts,
}

pub struct Parts {
    pub skin: Vec<Triangle>,
    /// Number of triangles at the beginning of `skin` that belong to the face in front of the ears.
    pub face: usize,
    pub gums: Vec<Triangle>,
    pub teeth: Vec<Triangle>,
    /// Eyeballs: the person's left, then right.
    pub eyes: [Vec<Triangle>; 2],
    pub lashes: Vec<Triangle>,
}

pub struct Shape {
    pub name: String,
    pub moves: Vec<(u32, Vec3)>,
}

impl Rig {
    pub fn load(folder: &Path) -> Result<Self> {
        let arrays = Arrays::open(&folder.join("rig.npz"));
        let mut arrays = arrays.context("cannot load the face rig: name its folder by --rig DIR")?;
        let names: Value = serde_json::from_reader(BufReader::new(File::open(folder.join("rig.json"))?))?;
        let neutral = points(&arrays.floats("neutral", &[3])?);
        let vertices = neutral.len();
        let expressions = arrays.floats("expressions", &[vertices, 3])?;
        let identities = arrays.floats("identities", &[vertices, 3])?;
        let skin_uv = arrays.floats("skin_uv", &[2])?;
        let landmarks: Vec<usize> = list(&names, "landmark68_vertices")?;
        let exist = landmarks.iter().all(|index| *index < vertices);
        ensure!(exist, "rig.json: a landmark refers to a vertex that does not exist");
        let parts = parts(&mut arrays, &list(&names, "materials")?, &neutral, &landmarks)?;
        let names = list(&names, "expressions")?;
        let shapes = names.into_iter().zip(expressions.chunks_exact(3 * vertices));
        let mut rig = Self {
            shapes: shapes.map(|(name, offsets)| Shape { name, moves: moves(&points(offsets)) }).collect(),
            identities: identities.chunks_exact(3 * vertices).map(points).collect(),
            skin_uv: skin_uv.chunks_exact(2).map(Vec2::from_slice).collect(),
            landmarks,
            parts,
            neutral,
        };
        add_bust(&mut rig);
        close_rolled_lips(&mut rig)?;
        Ok(rig)
    }

    pub fn landmark(&self, index: usize) -> Vec3 {
        self.neutral[self.landmarks[index]]
    }

    pub fn shape(&self, name: &str) -> Option<usize> {
        self.shapes.iter().position(|shape| shape.name == name)
    }
}

/// How far, in centimetres upwards, a rolled-in lip is moved where it moves most, before the shape is scaled back to its former
/// size. The rig's upper lip leaves the mouth open, and its lower lip does so towards the corners.
const RISES_CM: [(&str, f32); 2] = [("mouthRollUpper", -0.65), ("mouthRollLower", 0.35)];

/// Makes a lip that is rolled in meet the other one, without moving further than the rig's.
fn close_rolled_lips(rig: &mut Rig) -> Result<()> {
    for (name, rise_cm) in RISES_CM {
        let place = rig.shape(name).with_context(|| format!("the rig has no shape {name}"))?;
        let shape = &mut rig.shapes[place];
        let most = shape.most();
        ensure!(most > 0.0, "the rig's shape {name} moves nothing");
        shape.moves.iter_mut().for_each(|(_, offset)| offset.y += rise_cm * offset.length() / most);
        let scale = most / shape.most();
        shape.moves.iter_mut().for_each(|(_, offset)| *offset *= scale);
    }
    Ok(())
}

impl Shape {
    /// The largest displacement of a vertex.
    fn most(&self) -> f32 {
        self.moves.iter().map(|(_, offset)| offset.length()).fold(0.0, f32::max)
    }
}

fn points(values: &[f32]) -> Vec<Vec3> {
    values.chunks_exact(3).map(Vec3::from_slice).collect()
}

fn moves(offsets: &[Vec3]) -> Vec<(u32, Vec3)> {
    let far = offsets.iter().enumerate().filter(|(_, offset)| offset.length() > LEAST_MOVE);
    far.filter_map(|(index, offset)| Some((u32::try_from(index).ok()?, *offset))).collect()
}

fn list<T: DeserializeOwned>(file: &Value, name: &str) -> Result<Vec<T>> {
    serde_json::from_value(file[name].clone()).with_context(|| format!("rig.json lacks a list of {name}"))
}

fn parts(arrays: &mut Arrays, materials: &[String], neutral: &[Vec3], landmarks: &[usize]) -> Result<Parts> {
    let corners = arrays.integers("faces", &[3])?.into_iter().map(u32::try_from).collect::<Result<Vec<_>, _>>()?;
    let exist = corners.iter().all(|vertex| (*vertex as usize) < neutral.len());
    ensure!(exist, "rig.npz: a triangle refers to a vertex that does not exist");
    let triangles: Vec<Triangle> = corners.as_chunks::<3>().0.to_vec();
    let kinds = arrays.integers("face_material", &[])?;
    let of = |name: &str| -> Vec<Triangle> {
        let wanted = materials.iter().position(|known| known == name).and_then(|index| i32::try_from(index).ok());
        let both = triangles.iter().zip(&kinds);
        both.filter(|(_, kind)| Some(**kind) == wanted).map(|(triangle, _)| *triangle).collect()
    };
    let level = EYE_CORNERS.iter().map(|index| neutral[landmarks[*index]].y).sum::<f32>() / 4.0;
    let height = |triangle: &Triangle| triangle.iter().map(|vertex| neutral[*vertex as usize].y).sum::<f32>() / 3.0;
    let upper = |triangle: &Triangle| height(triangle) > level + UPPER_LASH;
    let face = of("M_Face");
    Ok(Parts {
        face: face.len(),
        skin: [face, of("M_BackHead")].concat(),
        gums: of("M_GumsTongue"),
        teeth: of("M_Teeth"),
        eyes: [of("M_ScleraLeft"), of("M_ScleraRight")],
        lashes: of("M_EyeLashes").into_iter().filter(upper).collect(),
    })
}

// Extends the rig, whose mesh ends at the shoulders, downwards and outwards, so that the bust does not float in the
// picture.

/// The rim of the shoulders lies below this height in centimetres. Higher rims are inside mouth and eyes.
const RIM: f32 = -11.0;
/// Rings of vertices below the rim: distance below it in centimetres, and scale of width and depth.
const RINGS: [(f32, [f32; 2]); 4] = [(2.5, [1.2, 1.12]), (5.5, [1.75, 1.25]), (11.0, [2.15, 1.4]), (120.0, [2.2, 1.5])];

fn add_bust(rig: &mut Rig) {
    let edges = rim(&rig.parts.skin, &rig.neutral);
    let mut order: Vec<u32> = edges.iter().flatten().copied().collect();
    order.sort_unstable();
    order.dedup();
    let mut above: HashMap<u32, u32> = order.iter().map(|vertex| (*vertex, *vertex)).collect();
    for (down, scale) in RINGS {
        let below: HashMap<u32, u32> =
            order.iter().map(|vertex| (*vertex, rig.add_below(*vertex as usize, down, scale))).collect();
        for [a, b] in &edges {
            let [upper_a, upper_b, lower_a, lower_b] = [above[a], above[b], below[a], below[b]];
            rig.parts.skin.extend([[upper_b, upper_a, lower_a], [upper_b, lower_a, lower_b]]);
        }
        above = below;
    }
}

fn rim(triangles: &[Triangle], points: &[Vec3]) -> Vec<[u32; 2]> {
    let directed = || triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let all: HashSet<[u32; 2]> = directed().collect();
    let low = |[a, b]: &[u32; 2]| points[*a as usize].y < RIM && points[*b as usize].y < RIM;
    directed().filter(|[a, b]| !all.contains(&[*b, *a])).filter(low).collect()
}

impl Rig {
    fn add_below(&mut self, vertex: usize, down: f32, [wider, deeper]: [f32; 2]) -> u32 {
        let point = self.neutral[vertex];
        self.neutral.push(Vec3::new(point.x * wider, RIM.min(point.y) - down, point.z * deeper));
        self.skin_uv.push(self.skin_uv[vertex]);
        self.identities.iter_mut().for_each(|mode| mode.push(mode[vertex]));
        u32::try_from(self.neutral.len() - 1).unwrap_or(u32::MAX)
    }
}

// Geometry and interpolation for several stages.

/// Returns area-weighted unit normals of the vertices, and 0 for vertices without triangles.
pub fn normals(points: &[Vec3], triangles: &[Triangle]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; points.len()];
    normals_into(points, triangles, &mut sums);
    sums
}

pub fn normals_into(points: &[Vec3], triangles: &[Triangle], sums: &mut [Vec3]) {
    sums.fill(Vec3::ZERO);
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| points[vertex as usize]);
        let normal = (b - a).cross(c - a);
        for vertex in triangle {
            sums[*vertex as usize] += normal;
        }
    }
    for normal in sums {
        *normal = normal.normalize_or_zero();
    }
}

pub fn vertices_of(triangles: &[Triangle]) -> Vec<u32> {
    let mut vertices = triangles.concat();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

pub struct SimpleMesh {
    pub vertices: Vec<u32>,
    pub triangles: Vec<Triangle>,
}

impl SimpleMesh {
    /// Merges the vertices that share a cube with sides of `cell`, in the length of the points.
    pub fn new(points: &[Vec3], triangles: &[Triangle], cell: f32) -> Self {
        let (mut vertices, mut numbers) = (Vec::new(), BTreeMap::new());
        let mut number = |vertex: u32| {
            let cube = (points[vertex as usize] / cell).floor().as_ivec3().to_array();
            *numbers.entry(cube).or_insert_with(|| {
                vertices.push(vertex);
                u32::try_from(vertices.len() - 1).unwrap_or(u32::MAX)
            })
        };
        let merged: BTreeSet<Triangle> = triangles.iter().map(|triangle| triangle.map(&mut number)).collect();
        let triangles = merged.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect();
        Self { vertices, triangles }
    }
}

/// Draws a number with a normal distribution of mean 0, cut off at the limit on both sides.
pub fn normal(rng: &mut ChaCha8Rng, deviation: f32, limit: f32) -> f32 {
    (rng.sample::<f32, _>(StandardNormal) * deviation).clamp(-limit, limit)
}

pub fn smoothstep(from: f32, to: f32, value: f32) -> f32 {
    let share = ((value - from) / (to - from)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

/// Interpolates linearly between points in ascending order. The function is constant outside of them.
pub fn piecewise(points: &[(f32, f32)], at: f32) -> f32 {
    let between = points.windows(2).find(|pair| at <= pair[1].0);
    match (between, points.last()) {
        (Some(pair), _) => {
            let share = ((at - pair[0].0) / (pair[1].0 - pair[0].0)).clamp(0.0, 1.0);
            pair[0].1 + share * (pair[1].1 - pair[0].1)
        }
        (None, Some(last)) => last.1,
        (None, None) => 0.0,
    }
}
