//! Eyeballs: a picture of an eye laid flat on the ball, so that the iris has the right size.

use anyhow::{Context, Result};
use glam::{Vec2, Vec3};

use super::{geometry::vertices_of, rig::Rig, texture::Texture};

/// Middle of the eye in the texture.
const CENTRE: Vec2 = Vec2::new(0.288, 1.0 - 0.708);
/// Radius of the iris in the texture.
const IRIS: f32 = 0.115;

/// One colour of eyes.
pub struct EyeTexture {
    texture: Texture,
}

impl EyeTexture {
    /// Takes a texture of two eyes.
    pub fn new(texture: Texture) -> Result<Self> {
        let [width, height] = texture.size();
        (width > 0 && height > 0).then_some(Self { texture }).context("an eye texture is empty")
    }

    /// Colour at an offset from the middle of the ball, over its radius. `iris` is the radius of the iris on it.
    pub fn colour(&self, offset: Vec2, iris: f32) -> Vec3 {
        self.texture.light(CENTRE + offset * (IRIS / iris))
    }
}

/// Offset of every eyeball vertex from the middle of its ball over its radius, with the eyes looking ahead.
pub fn ball_offsets(rig: &Rig) -> Vec<Vec3> {
    let mut offsets = vec![Vec3::ZERO; rig.neutral.len()];
    for eye in &rig.parts.eyes {
        let vertices = vertices_of(eye);
        let place = |vertex: &u32| rig.neutral[*vertex as usize];
        let least = vertices.iter().map(place).fold(Vec3::INFINITY, Vec3::min);
        let most = vertices.iter().map(place).fold(Vec3::NEG_INFINITY, Vec3::max);
        let (centre, radius) = ((least + most) / 2.0, (most.x - least.x) / 2.0);
        for vertex in &vertices {
            offsets[*vertex as usize] = (place(vertex) - centre) / radius;
        }
    }
    offsets
}
