//! Things on and before a face: meshes with colours, which move with the head.

use glam::{Mat3, Vec2, Vec3};

use super::rig::Triangle;

/// Segments of an ellipsoid around its axis, and from pole to pole.
const AROUND: u16 = 18;
const ALONG: u16 = 12;

/// A mesh in the rig's coordinates, with one material.
#[derive(Debug, Clone)]
pub struct Prop {
    /// Vertices.
    pub points: Vec<Vec3>,
    /// Colour of each vertex in linear light.
    pub colours: Vec<Vec3>,
    /// Triangles.
    pub triangles: Vec<Triangle>,
    /// The lens that the mesh is, or `None` for an opaque mesh.
    pub lens: Option<Lens>,
}

/// How much light a lens of glasses reflects and lets through.
#[derive(Debug, Clone, Copy)]
pub struct Lens {
    /// Share of the light that the lens absorbs.
    pub tint: f32,
    /// Reflection of a window: its direction and offset on the lens in centimetres, its width, and its strength.
    pub glare: (Vec2, f32, f32, f32),
}

impl Lens {
    /// Returns the strength of the window's reflection at a position in the plane of the glasses.
    pub fn glare_at(&self, position: Vec2) -> f32 {
        let (across, offset, width, strength) = self.glare;
        let beyond = ((position.dot(across) - offset).abs() / width).min(1.0);
        strength * (1.0 - beyond * beyond * beyond)
    }
}

impl Prop {
    /// Creates an empty mesh.
    pub fn new(lens: Option<Lens>) -> Self {
        Self { points: Vec::new(), colours: Vec::new(), triangles: Vec::new(), lens }
    }

    /// Adds a vertex and returns its number.
    pub fn vertex(&mut self, point: Vec3, colour: Vec3) -> u32 {
        self.points.push(point);
        self.colours.push(colour);
        u32::try_from(self.points.len() - 1).unwrap_or(u32::MAX)
    }

    /// Adds a quadrilateral that is visible from both sides. The corners run around it.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        self.triangles.extend([[a, b, c], [a, c, d], [a, c, b], [a, d, c]]);
    }

    /// Adds an ellipsoid. The columns of `axes` are its half axes. `colour` gives the colour at each point of the unit
    /// sphere.
    pub fn ellipsoid(&mut self, centre: Vec3, axes: Mat3, colour: impl Fn(Vec3) -> Vec3) {
        let first = u32::try_from(self.points.len()).unwrap_or(u32::MAX);
        for ring in 0..=ALONG {
            let height = f32::from(ring) / f32::from(ALONG) * core::f32::consts::PI;
            for step in 0..AROUND {
                let around = Vec2::from_angle(f32::from(step) / f32::from(AROUND) * core::f32::consts::TAU);
                let unit = Vec3::new(around.x * height.sin(), height.cos(), around.y * height.sin());
                self.vertex(centre + axes * unit, colour(unit));
            }
        }
        let at = |ring: u16, step: u16| first + u32::from(ring * AROUND + step % AROUND);
        for (ring, step) in (0..ALONG).flat_map(|ring| (0..AROUND).map(move |step| (ring, step))) {
            let [a, b, c, d] = [at(ring, step), at(ring, step + 1), at(ring + 1, step + 1), at(ring + 1, step)];
            self.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::geometry::normals;

    #[test]
    fn the_normals_of_an_ellipsoid_point_outwards() {
        let mut prop = Prop::new(None);
        let centre = Vec3::new(1.0, 2.0, 3.0);
        prop.ellipsoid(centre, Mat3::from_diagonal(Vec3::new(1.0, 2.0, 0.5)), |_| Vec3::ONE);
        for (point, normal) in prop.points.iter().zip(normals(&prop.points, &prop.triangles)) {
            assert!(normal.dot(*point - centre) > 0.0);
        }
    }

    #[test]
    fn a_quad_is_visible_from_both_sides() {
        let mut prop = Prop::new(None);
        let corners = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y].map(|point| prop.vertex(point, Vec3::ONE));
        prop.quad(corners);
        let sides = prop.triangles.iter().map(|[a, b, c]| {
            let [a, b, c] = [a, b, c].map(|vertex| prop.points[*vertex as usize]);
            (b - a).cross(c - a).z
        });
        let (front, back): (Vec<f32>, Vec<f32>) = sides.partition(|area| *area > 0.0);
        assert_eq!((front.iter().sum::<f32>(), back.iter().sum::<f32>()), (2.0, -2.0));
    }
}
