//! What one picture shows: expression and place of a head, its light, and the lens it is seen through.
//!
//! World: the camera stands at the origin; x right in the picture (the left of a person facing it), y up, z towards
//! the camera. Centimetres.

use glam::{Mat3, Quat, Vec2, Vec3};

use super::{
    expression::{Coefficients, head_rotation},
    geometry::smoothstep,
};

/// The point of the rig that the head turns about.
const PIVOT: Vec3 = Vec3::new(0.0, -1.0, 3.0);
/// About the tip of the nose.
const NOSE: Vec3 = Vec3::new(0.0, 0.4, 13.0);
/// From here down to there the neck follows the head less and less, centimetres.
const NECK: [f32; 2] = [-8.5, -15.0];
/// Share of the head's turn that the shoulders make.
const SHOULDERS: f32 = 0.25;

/// A light from far away.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    /// Where it comes from.
    pub toward: Vec3,
    /// Linear, about 0 to 1.
    pub colour: Vec3,
}

/// All light on a head. The first of `lights` casts shadows.
#[derive(Debug, Clone)]
pub struct Lighting {
    /// Mean light of the surroundings, and how it changes along x, y and z (spherical harmonics of degree 0 and 1).
    pub ambient: [Vec3; 4],
    /// Lamps and windows.
    pub lights: Vec<Light>,
    /// Width of the edge of shadows, centimetres.
    pub softness: f32,
}

/// A pinhole.
#[derive(Debug, Clone, Copy)]
pub struct Lens {
    /// Columns and rows of the picture.
    pub size: [usize; 2],
    /// Pixels.
    pub focal_px: f32,
}

/// Where the head is and where it faces.
#[derive(Debug, Clone, Copy)]
pub struct Placement {
    /// Yaw to the person's left, pitch nodding down, roll to the right shoulder; all 0 when facing the camera.
    pub angles_deg: [f32; 3],
    /// Where the head is, in the world.
    pub position: Vec3,
}

/// One picture of a head.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Its expression.
    pub weights: Coefficients,
    /// Its place.
    pub placement: Placement,
    /// Its light.
    pub lighting: Lighting,
    /// The lens.
    pub lens: Lens,
}

impl Shot {
    /// About where the tip of the nose is in the picture, pixels.
    pub fn nose(&self) -> Option<Vec2> {
        let mut tip = [NOSE];
        self.placement.place(&mut tip, &[0.0]);
        self.lens.project(tip[0]).map(|(place, _)| place)
    }
}

impl Lighting {
    /// Light of the surroundings on a surface that sees all of its half of the sky.
    pub fn ambient(&self, normal: Vec3) -> Vec3 {
        let [mean, x, y, z] = self.ambient;
        (mean + normal.x * x + normal.y * y + normal.z * z).max(Vec3::ZERO)
    }
}

impl Lens {
    /// Pixel position, and the inverse of the distance in depth. Nothing for points at or behind the camera.
    pub fn project(&self, point: Vec3) -> Option<(Vec2, f32)> {
        let near = 1.0 / -point.z;
        let centre = Vec2::new(self.size[0] as f32, self.size[1] as f32) / 2.0;
        (point.z < -1.0).then(|| (centre + self.focal_px * near * Vec2::new(point.x, -point.y), near))
    }
}

impl Placement {
    /// From the rig to the world, for head and shoulders: rotation each, about [`PIVOT`].
    fn rotations(&self) -> [Mat3; 2] {
        let [yaw, pitch, roll] = self.angles_deg;
        let facing = Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, (-self.position).normalize_or(Vec3::Z)));
        [1.0, SHOULDERS].map(|share| facing * head_rotation(share * yaw, share * pitch, share * roll))
    }

    /// Moves points of the rig to the world. `shoulder` says how far each belongs to the shoulders.
    pub fn place(&self, points: &mut [Vec3], shoulder: &[f32]) {
        let [head, body] = self.rotations();
        for (point, share) in points.iter_mut().zip(shoulder) {
            let offset = *point - PIVOT;
            let turned = head * offset;
            let blended = if *share > 0.0 { turned.lerp(body * offset, *share) } else { turned };
            *point = self.position + blended;
        }
    }
}

/// How far a vertex of the head at rest belongs to the shoulders, 0 to 1.
pub fn shoulder(point: Vec3) -> f32 {
    smoothstep(-NECK[0], -NECK[1], -point.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens { size: [640, 480], focal_px: 500.0 };

    #[test]
    fn the_persons_left_is_right_in_the_picture_and_up_is_up() {
        let at = |x, y| LENS.project(Vec3::new(x, y, -50.0)).map(|(place, _)| place);
        assert_eq!(at(0.0, 0.0), Some(Vec2::new(320.0, 240.0)));
        assert_eq!(at(5.0, 0.0), Some(Vec2::new(370.0, 240.0)));
        assert_eq!(at(0.0, 5.0), Some(Vec2::new(320.0, 190.0)));
        assert_eq!(LENS.project(Vec3::new(0.0, 0.0, 5.0)), None);
    }

    #[test]
    fn a_head_beside_the_middle_still_faces_the_camera() {
        let placement = Placement { angles_deg: [0.0; 3], position: Vec3::new(20.0, -5.0, -60.0) };
        let mut points = [PIVOT, PIVOT + 9.0 * Vec3::Z];
        placement.place(&mut points, &[0.0; 2]);
        let screen = points.map(|point| LENS.project(point).map(|(place, _)| place).unwrap_or_default());
        assert!((screen[0] - screen[1]).length() < 1e-2, "the nose covers the middle of the head");
    }

    #[test]
    fn shoulders_follow_a_quarter_of_the_turn() {
        let placement = Placement { angles_deg: [40.0, 0.0, 0.0], position: Vec3::new(0.0, 0.0, -60.0) };
        let mut points = [PIVOT + Vec3::Z, PIVOT + Vec3::Z];
        placement.place(&mut points, &[0.0, 1.0]);
        let [head, shoulder] = points.map(|point| (point - placement.position).x.asin().to_degrees());
        assert!((head - 40.0).abs() < 1e-3 && (shoulder - 10.0).abs() < 1e-3);
    }
}
