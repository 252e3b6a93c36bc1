//! Lights vertices: ambient light, lamps with a soft shadow, and specular highlights.
//!
//! Vertices are about as dense as pixels, so light is computed per vertex and interpolated. Subsurface scattering is
//! approximated by a wrapped cosine with a wider wrap for red, because skin transmits more red than blue light.

use glam::{Vec3, Vec3A};

use super::{
    scene::{Light, Lighting},
    shadow::DepthMap,
};

/// Wrap of the cosine on skin, and on other materials.
const SKIN_WRAP: Vec3 = Vec3::new(0.42, 0.17, 0.11);
const HARD_WRAP: Vec3 = Vec3::splat(0.08);
/// Reflectance of skin at normal incidence.
const FRESNEL: f32 = 0.03;
/// Reflectance for ambient light.
const SKY_GLOSS: f32 = 0.02;
/// Vertices that face away further than this (cosine) are invisible and not lit.
const HIDDEN: f32 = -0.35;

/// Linear light on one vertex.
#[derive(Debug, Clone, Copy, Default)]
pub struct VertexLight {
    /// Diffuse light, to be multiplied by the surface's colour.
    pub diffuse: Vec3A,
    /// Specular light, to be added.
    pub gloss: Vec3A,
}

/// A vertex in the world.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Position, with the camera at the origin.
    pub point: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Share of the sky that is visible.
    pub sky: f32,
    /// Whether the vertex is skin.
    pub skin: bool,
}

/// Computes the light on a vertex.
pub fn shade(lighting: &Lighting, shadow: &DepthMap, surface: &Surface) -> VertexLight {
    let view = -surface.point.normalize_or_zero();
    if surface.normal.dot(view) < HIDDEN {
        return VertexLight::default();
    }
    let sky = lighting.ambient(surface.normal) * surface.sky;
    let mut lit = VertexLight { diffuse: sky.into(), gloss: Vec3A::ZERO };
    let dark = if surface.skin { -SKIN_WRAP.x } else { -HARD_WRAP.x };
    for (index, lamp) in lighting.lights.iter().enumerate() {
        if surface.normal.dot(lamp.toward) <= dark {
            continue;
        }
        let open =
            if index == 0 && lighting.shadows { shadowed(lighting, shadow, surface) } else { surface.sky.sqrt() };
        add_lamp(&mut lit, lamp, surface, view, open);
    }
    lit.gloss += Vec3A::from(lighting.ambient(-view.reflect(surface.normal)) * surface.sky * SKY_GLOSS);
    lit
}

fn shadowed(lighting: &Lighting, shadow: &DepthMap, surface: &Surface) -> f32 {
    let lifted = surface.point + 0.15 * surface.normal;
    shadow.light_at(lifted, shadow.cells(lighting.softness)) * surface.sky.sqrt().sqrt()
}

fn add_lamp(lit: &mut VertexLight, lamp: &Light, surface: &Surface, view: Vec3, open: f32) {
    let wrap = if surface.skin { SKIN_WRAP } else { HARD_WRAP };
    let cosine = surface.normal.dot(lamp.toward);
    lit.diffuse += Vec3A::from(lamp.colour * open * ((wrap + cosine) / (1.0 + wrap)).max(Vec3::ZERO));
    if cosine > 0.0 {
        let half = (lamp.toward + view).normalize_or_zero();
        let grazing = 1.0 - half.dot(view).max(0.0);
        let square = grazing * grazing;
        let grazing = FRESNEL + (1.0 - FRESNEL) * square * square * grazing;
        let share = open * grazing * cosine * highlight(surface.normal.dot(half).max(0.0));
        lit.gloss += Vec3A::from(lamp.colour * share);
    }
}

/// Returns the sum of two normalised Blinn-Phong lobes: 0.7 with exponent 12, and 0.3 with exponent 42.
fn highlight(cosine: f32) -> f32 {
    let square = cosine * cosine;
    let fourth = square * square;
    let eighth = fourth * fourth;
    let wide = eighth * fourth;
    let narrow = eighth * eighth * eighth * eighth * eighth * square;
    0.7 * 20.0 / 8.0 * wide + 0.3 * 50.0 / 8.0 * narrow
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lit(toward: Vec3, skin: bool) -> VertexLight {
        let lights = vec![Light { toward, colour: Vec3::ONE }];
        let lighting = Lighting { ambient: [Vec3::ZERO; 4], lights, shadows: true, softness: 0.5 };
        let surface = Surface { point: Vec3::new(0.0, 0.0, -50.0), normal: Vec3::Z, sky: 1.0, skin };
        let mut shadow = DepthMap::new(8);
        shadow.draw(toward, (Vec3::ZERO, 1.0), [], &[]);
        shade(&lighting, &shadow, &surface)
    }

    #[test]
    fn light_is_brightest_at_normal_incidence_and_absent_from_behind() {
        assert!((lit(Vec3::Z, true).diffuse - 1.0).length() < 1e-5);
        assert!(lit(Vec3::NEG_Z, true).diffuse.length() < 1e-5);
        assert!(lit(Vec3::Z, true).gloss.x > lit(Vec3::new(0.8, 0.0, 0.6), true).gloss.x);
    }

    #[test]
    fn beyond_the_terminator_only_skin_glows_red() {
        let edge = Vec3::new(1.0, 0.0, -0.15).normalize();
        assert!(lit(edge, true).diffuse.x > 0.1 && lit(edge, true).diffuse.z < 0.01);
        assert!(lit(edge, false).diffuse.max_element() < 0.01);
    }
}
