//! The assets of all pictures, loaded once: rig, textures, and data precomputed from them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use facewire_face::{BLENDSHAPES, COEFFS};
use glam::Vec3;
use rayon::prelude::*;

use super::expression::{Coefficients, Deformer};
use super::geometry::{SimpleMesh, normals, vertices_of};
use super::rig::{Rig, Triangle};
use super::scene::shoulder;
use super::shade::ambient_occlusion;
use super::textures::{Brow, EyeTexture, Layout, Skin, Texture, ball_offsets};
use super::wrinkles::Wrinkles;

/// Least visibility of the sky, because indirect light reaches every vertex.
const LEAST_VISIBILITY: f32 = 0.03;
/// Details smaller than this cast no shadow of their own, in centimetres.
const CASTER_CELL: f32 = 0.6;
/// Bounding sphere of the head for lighting: centre and radius.
pub const BOUNDS: (Vec3, f32) = (Vec3::new(0.0, -1.0, 2.0), 21.0);

pub struct Assets {
    pub rig: Rig,
    pub deformer: Deformer,
    /// The part of the head that skin textures cover.
    pub layout: Layout,
    /// Names of skins, brows and eyes: their file names without extension.
    pub names: [Vec<String>; 3],
    /// Skins in the order of their names.
    pub skins: Vec<Skin>,
    /// Brows in the order of their names.
    pub brows: Vec<Brow>,
    /// Eyes in the order of their names.
    pub eyes: Vec<EyeTexture>,
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
}

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
        let eyes = eyes.into_iter().map(EyeTexture::new);
        let parts = &rig.parts;
        let surface = [parts.skin.as_slice(), &parts.gums, &parts.teeth, &parts.eyes[0], &parts.eyes[1]].concat();
        Ok(Self {
            occlusion: AmbientOcclusion::new(&rig, &deformer, &surface)?,
            rest_normals: normals(&rig.neutral, &surface),
            shoulder: rig.neutral.iter().map(|point| shoulder(*point)).collect(),
            ball_offsets: ball_offsets(&rig),
            is_skin: is_skin(&rig),
            mouth: vertices_of(&[parts.gums.as_slice(), &parts.teeth].concat()),
            wrinkles: Wrinkles::new(&rig),
            caster: SimpleMesh::new(&rig.neutral, &rig.parts.skin, CASTER_CELL),
            surface,
            names: [skin_names, brow_names, eye_names],
            skins: skins.collect(),
            brows: brows.collect::<Result<_>>()?,
            eyes: eyes.collect::<Result<_>>()?,
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

/// Loads the images in a folder in the order of their names, which are returned with them.
fn textures(folder: &Path) -> Result<(Vec<String>, Vec<Texture>)> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot open {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<PathBuf>>>()?;
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "png" || extension == "jpg"));
    paths.sort();
    ensure!(!paths.is_empty(), "{} contains no PNG or JPEG images", folder.display());
    let names = paths.iter().filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned())).collect();
    Ok((names, paths.par_iter().map(|path| Texture::load(path)).collect::<Result<_>>()?))
}

impl AmbientOcclusion {
    fn new(rig: &Rig, deformer: &Deformer, surface: &[Triangle]) -> Result<Self> {
        let index =
            |name: &str| BLENDSHAPES.iter().position(|known| *known == name).with_context(|| format!("no {name}"));
        let moved = ["jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthFunnel", "mouthSmileLeft", "mouthSmileRight"];
        let baked = |weights: &Coefficients| {
            let mut points = Vec::new();
            deformer.deform(rig, &rig.neutral, weights, &mut points);
            ambient_occlusion(&points, &normals(&points, surface), surface, BOUNDS)
        };
        let rest = baked(&[0.0; COEFFS]);
        let change = |name: &&str| -> Result<_> {
            let coefficient = index(name)?;
            let mut weights = [0.0; COEFFS];
            weights[coefficient] = 1.0;
            let change = baked(&weights).iter().zip(&rest).map(|(there, here)| there - here).collect();
            Ok((coefficient, change))
        };
        Ok(Self { changes: moved.iter().map(change).collect::<Result<_>>()?, rest })
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
        for share in out {
            *share = share.clamp(LEAST_VISIBILITY, 1.0);
        }
    }
}
