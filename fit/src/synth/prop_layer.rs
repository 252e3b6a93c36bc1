//! Draws things on and before a face, such as glasses and hands.

use glam::{Vec3, Vec3A};

use super::{
    canvas::Canvas,
    geometry::normals_into,
    props::{Lens, Prop},
    raster::Position,
    render::{Corners, draw, on_screen},
    scene::{Lighting, Scene},
    shade::{Surface, VertexLight, shade},
    shadow::DepthMap,
};

/// Exponent of the reflection of lamps on a lens, and its strength.
const GLINT: (i32, f32) = (900, 3.0);
/// Largest share of a lens's colour that its reflections replace.
const MOST_GLARE: f32 = 0.9;

/// Buffers for a thing, with one entry per vertex.
#[derive(Default)]
pub struct PropLayer {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    lit: Vec<VertexLight>,
    screen: Vec<(Position, f32)>,
    shoulder: Vec<f32>,
}

impl PropLayer {
    /// Draws a thing that moves with the head.
    pub fn draw(&mut self, canvas: &mut Canvas, prop: &Prop, scene: &Scene, shadow: &DepthMap) {
        self.points.clone_from(&prop.points);
        self.shoulder.clear();
        self.shoulder.resize(prop.points.len(), 0.0);
        scene.placement.place(&mut self.points, &self.shoulder);
        self.normals.resize(self.points.len(), Vec3::ZERO);
        normals_into(&self.points, &prop.triangles, &mut self.normals);
        self.screen.clear();
        self.screen.extend(self.points.iter().map(|point| on_screen(scene, canvas.density, *point)));
        match prop.lens {
            Some(lens) => self.draw_lens(canvas, prop, scene, lens),
            None => self.draw_opaque(canvas, prop, scene, shadow),
        }
    }

    fn draw_opaque(&mut self, canvas: &mut Canvas, prop: &Prop, scene: &Scene, shadow: &DepthMap) {
        let vertices = self.points.iter().zip(&self.normals);
        // Flat parts are visible from both sides: their normals cancel out, and they are lit as if they faced the camera.
        let lit = vertices.map(|(point, normal)| {
            let normal = if *normal == Vec3::ZERO { -point.normalize_or_zero() } else { *normal };
            shade(&scene.lighting, shadow, &Surface { point: *point, normal, sky: 0.9, skin: false })
        });
        self.lit.clear();
        self.lit.extend(lit);
        let window = canvas.grid.whole();
        draw(canvas, &self.screen, (&prop.triangles, &window), 1.0, |_, vertices| {
            let colour = |vertex: usize| Vec3A::from(prop.colours[vertex]) * self.lit[vertex].diffuse;
            let corners = Corners(vertices.map(|vertex| colour(vertex) + self.lit[vertex].gloss));
            move |canvas, index, inverse_depth, weights| canvas.set(index, inverse_depth, corners.at(weights))
        });
    }

    fn draw_lens(&self, canvas: &mut Canvas, prop: &Prop, scene: &Scene, lens: Lens) {
        let window = canvas.grid.whole();
        draw(canvas, &self.screen, (&prop.triangles, &window), 1.0, |_, vertices| {
            let normals = Corners(vertices.map(|vertex| self.normals[vertex]));
            let points = Corners(vertices.map(|vertex| self.points[vertex]));
            let places = Corners(vertices.map(|vertex| prop.points[vertex].truncate()));
            move |canvas, index, _, weights| {
                let (normal, view) = (normals.at(weights).normalize_or_zero(), -points.at(weights).normalize_or_zero());
                let mirrored = -view.reflect(normal);
                let seen = scene.lighting.ambient(mirrored);
                let share = (0.04 + lens.glare_at(places.at(weights))).min(MOST_GLARE);
                canvas.blend(index, lens.tint, Vec3A::ZERO);
                canvas.blend(index, share, Vec3A::from(1.5 * seen + lamps(&scene.lighting, mirrored)));
            }
        });
    }
}

/// Returns the light of the lamps that is seen in a direction.
fn lamps(lighting: &Lighting, toward: Vec3) -> Vec3 {
    let seen = |toward: Vec3, lamp: Vec3| GLINT.1 * toward.dot(lamp).max(0.0).powi(GLINT.0);
    lighting.lights.iter().map(|lamp| lamp.colour * seen(toward, lamp.toward)).sum()
}
