//! The face rig: a head with expression shapes and identity modes, loaded from a folder.
//!
//! The folder holds `rig.npz` (arrays) and `rig.json` (names of materials and expressions, vertices of 68 landmarks),
//! described in `fit/README.md`. Units are centimetres, with x to the person's left, y up, and z out of the face.
//!
//! Materials that only suit ray tracing (tear fluid, eye occlusion, the inner iris) are not used.

use std::{fs::File, io::BufReader, path::Path};

use anyhow::{Context, Result, ensure};
use glam::{Vec2, Vec3};
use serde_json::Value;

use super::bust;
use crate::arrays::Arrays;

/// Shorter offsets of an expression, in centimetres, are treated as 0.
const LEAST_MOVE: f32 = 0.002;
/// The four eye corners among the 68 landmarks.
const EYE_CORNERS: [usize; 4] = [36, 39, 42, 45];
/// Lashes higher than this above the eye corners belong to the upper lids, in centimetres.
const UPPER_LASH: f32 = 0.12;

/// Indices of three vertices.
pub type Triangle = [u32; 3];

/// A head at rest with its expression shapes and identity modes.
pub struct Rig {
    /// Vertices of the head at rest.
    pub neutral: Vec<Vec3>,
    /// Expression shapes.
    pub shapes: Vec<Shape>,
    /// Offset of every vertex for each identity mode.
    pub identities: Vec<Vec<Vec3>>,
    /// Coordinates of each vertex in the skin texture.
    pub skin_uv: Vec<Vec2>,
    /// Vertices of the usual 68 landmarks.
    pub landmarks: Vec<usize>,
    /// Triangles by part of the head.
    pub parts: Parts,
}

/// The triangles of a head.
pub struct Parts {
    /// Face, scalp, neck and shoulders.
    pub skin: Vec<Triangle>,
    /// Number of triangles at the beginning of `skin` that belong to the face in front of the ears.
    pub face: usize,
    /// Gums, tongue and the inside of the mouth.
    pub gums: Vec<Triangle>,
    /// Both rows of teeth.
    pub teeth: Vec<Triangle>,
    /// Eyeballs: the person's left, then right.
    pub eyes: [Vec<Triangle>; 2],
    /// Lashes of the upper lids.
    pub lashes: Vec<Triangle>,
}

/// An expression shape.
pub struct Shape {
    /// Name in the rig.
    pub name: String,
    /// The vertices that the shape moves, with their offsets at weight 1.
    pub moves: Vec<(u32, Vec3)>,
}

impl Rig {
    /// Loads a rig from a folder.
    pub fn load(folder: &Path) -> Result<Self> {
        let arrays = Arrays::open(&folder.join("rig.npz"));
        let mut arrays = arrays.context("cannot load the face rig: name its folder by --rig DIR")?;
        let names: Value = serde_json::from_reader(BufReader::new(File::open(folder.join("rig.json"))?))?;
        let neutral = points(&arrays.floats("neutral", &[3])?);
        let vertices = neutral.len();
        let expressions = arrays.floats("expressions", &[vertices, 3])?;
        let identities = arrays.floats("identities", &[vertices, 3])?;
        let skin_uv = arrays.floats("skin_uv", &[2])?;
        let landmarks = vertex_list(&names["landmark68_vertices"])?;
        ensure!(
            landmarks.iter().all(|index| *index < vertices),
            "rig.json: a landmark refers to a vertex that does not exist"
        );
        let parts = parts(&mut arrays, &strings(&names["materials"])?, &neutral, &landmarks)?;
        let names = strings(&names["expressions"])?;
        let shapes = names.into_iter().zip(expressions.chunks_exact(3 * vertices));
        let mut rig = Self {
            shapes: shapes.map(|(name, offsets)| Shape { name, moves: moves(&points(offsets)) }).collect(),
            identities: identities.chunks_exact(3 * vertices).map(points).collect(),
            skin_uv: skin_uv.chunks_exact(2).map(Vec2::from_slice).collect(),
            landmarks,
            parts,
            neutral,
        };
        bust::extend(&mut rig);
        Ok(rig)
    }

    /// Returns the position of one of the 68 landmarks on the head at rest.
    pub fn landmark(&self, index: usize) -> Vec3 {
        self.neutral[self.landmarks[index]]
    }

    /// Returns the index of the shape with this name in the rig.
    pub fn shape(&self, name: &str) -> Option<usize> {
        self.shapes.iter().position(|shape| shape.name == name)
    }
}

fn points(values: &[f32]) -> Vec<Vec3> {
    values.chunks_exact(3).map(Vec3::from_slice).collect()
}

fn moves(offsets: &[Vec3]) -> Vec<(u32, Vec3)> {
    let far = offsets.iter().enumerate().filter(|(_, offset)| offset.length() > LEAST_MOVE);
    far.filter_map(|(index, offset)| Some((u32::try_from(index).ok()?, *offset))).collect()
}

fn strings(list: &Value) -> Result<Vec<String>> {
    serde_json::from_value(list.clone()).context("rig.json lacks a list of names")
}

fn vertex_list(list: &Value) -> Result<Vec<usize>> {
    serde_json::from_value(list.clone()).context("rig.json lacks landmark68_vertices")
}

fn parts(arrays: &mut Arrays, materials: &[String], neutral: &[Vec3], landmarks: &[usize]) -> Result<Parts> {
    let corners = arrays.integers("faces", &[3])?.into_iter().map(u32::try_from).collect::<Result<Vec<_>, _>>()?;
    ensure!(
        corners.iter().all(|vertex| (*vertex as usize) < neutral.len()),
        "rig.npz: a triangle refers to a vertex that does not exist"
    );
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
