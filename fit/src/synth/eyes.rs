//! Eyeballs: an eye texture projected onto the ball from the front and scaled to the size of the iris.

use anyhow::{Context, Result};
use glam::{Vec2, Vec3};

use super::{geometry::vertices_of, rig::Rig, texture::Texture};

/// Centre of the eye in the texture.
const CENTRE: Vec2 = Vec2::new(0.288, 1.0 - 0.708);
/// Radius of the iris in the texture.
const IRIS: f32 = 0.115;

/// An eye texture of one colour.
pub struct EyeTexture {
    texture: Texture,
}

impl EyeTexture {
    /// Uses a texture that shows two eyes.
    pub fn new(texture: Texture) -> Result<Self> {
        let [width, height] = texture.size();
        (width > 0 && height > 0).then_some(Self { texture }).context("an eye texture is empty")
    }

    /// Returns the colour at an offset from the centre of the ball. The offset and the radius `iris` are relative to
    /// the radius of the ball.
    pub fn colour(&self, offset: Vec2, iris: f32) -> Vec3 {
        self.texture.light(CENTRE + offset * (IRIS / iris)).into()
    }
}

/// Returns the offset of every eyeball vertex from its ball's centre, relative to the ball's radius, for eyes that look
/// ahead. The offset of all other vertices is 0.
pub fn ball_offsets(rig: &Rig) -> Vec<Vec3> {
    let mut offsets = vec![Vec3::ZERO; rig.neutral.len()];
    for eye in &rig.parts.eyes {
        let vertices = vertices_of(eye);
        let point = |vertex: &u32| rig.neutral[*vertex as usize];
        let least = vertices.iter().map(point).fold(Vec3::INFINITY, Vec3::min);
        let most = vertices.iter().map(point).fold(Vec3::NEG_INFINITY, Vec3::max);
        let (centre, radius) = ((least + most) / 2.0, (most.x - least.x) / 2.0);
        for vertex in &vertices {
            offsets[*vertex as usize] = (point(vertex) - centre) / radius;
        }
    }
    offsets
}
