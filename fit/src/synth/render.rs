//! Renders a person to linear light: deforms, places and lights the head, then draws skin, mouth and eyes, and at last
//! brows and lashes over them.

use glam::{Vec2, Vec3};

use super::{
    assets::{Assets, BOUNDS},
    canvas::{Canvas, SAMPLES},
    geometry::normals_into,
    paint::{LASHES, Painter},
    person::Person,
    rig::Triangle,
    scene::{PIVOT, Scene},
    shade::{Surface, VertexLight, shade},
    shadow::DepthMap,
};

/// Cells per side of the key light's depth map.
const SHADOW_SIDE: usize = 200;
/// Visibility of the sky directly behind the lips.
const MOUTH_SKY: f32 = 0.6;
/// Factor on the inverse depth of brows, so that the skin below does not hide them.
const LIFT: f32 = 1.0005;

/// A renderer with buffers for pictures of one size.
pub struct Renderer {
    canvas: Canvas,
    shadow: DepthMap,
    head: Head,
}

/// The head in one picture, with one entry per vertex.
#[derive(Default)]
pub struct Head {
    /// Deformed positions in the rig's coordinates.
    pub shape: Vec<Vec3>,
    /// Positions in the world.
    pub points: Vec<Vec3>,
    /// Unit normals in the world.
    pub normals: Vec<Vec3>,
    /// Light on the vertex.
    pub lit: Vec<VertexLight>,
    /// Position among the samples, and inverse depth.
    screen: Vec<(Vec2, f32)>,
    /// Visibility of the sky.
    sky: Vec<f32>,
}

impl Renderer {
    /// Creates a renderer for pictures of this size.
    pub fn new(size: [usize; 2]) -> Self {
        Self { canvas: Canvas::new(size), shadow: DepthMap::new(SHADOW_SIDE), head: Head::default() }
    }

    /// Draws a person in linear light over the backdrop in `pixels`.
    pub fn draw(&mut self, assets: &Assets, person: &Person, scene: &Scene, pixels: &mut [Vec3]) {
        self.head.pose(assets, person, scene);
        self.light(assets, scene);
        self.head.darken_mouth(assets);
        self.canvas.clear();
        let painter = Painter::new(assets, person, &self.head, &scene.lighting);
        let parts = &assets.rig.parts;
        let canvas = &mut self.canvas;
        let head = &self.head;
        draw(canvas, head, &parts.skin, 1.0, |canvas, index, inverse_depth, corners| {
            canvas.set(index, inverse_depth, painter.skin(corners));
        });
        draw(canvas, head, &parts.gums, 1.0, |canvas, index, inverse_depth, corners| {
            canvas.set(index, inverse_depth, painter.gums(corners));
        });
        draw(canvas, head, &parts.teeth, 1.0, |canvas, index, inverse_depth, corners| {
            canvas.set(index, inverse_depth, painter.teeth(corners));
        });
        for eye in &parts.eyes {
            draw(canvas, head, eye, 1.0, |canvas, index, inverse_depth, corners| {
                canvas.set(index, inverse_depth, painter.eye(corners));
            });
        }
        draw(canvas, head, &assets.brows[person.looks.brow].triangles, LIFT, |canvas, index, _, corners| {
            let (alpha, colour) = painter.brow(corners);
            canvas.blend(index, alpha, colour);
        });
        draw(canvas, head, &parts.lashes, 1.0, |canvas, index, _, _| {
            canvas.blend(index, person.looks.lashes, LASHES);
        });
        self.canvas.resolve(pixels);
    }

    /// Returns the pixel positions of the outer eye corners in the last picture: the person's right, then left.
    pub fn eye_corners(&self, assets: &Assets) -> [Vec2; 2] {
        [36, 45].map(|index| self.head.screen[assets.rig.landmarks[index]].0 / SAMPLES as f32)
    }

    fn light(&mut self, assets: &Assets, scene: &Scene) {
        let head = &mut self.head;
        let key = scene.lighting.lights.first().map_or(Vec3::Y, |lamp| lamp.toward);
        let bounds = (scene.placement.position + BOUNDS.0 - PIVOT, BOUNDS.1);
        self.shadow.draw(key, bounds, &head.points, &assets.rig.parts.skin);
        assets.occlusion.visibility(&scene.weights, &mut head.sky);
        // The ambient occlusion of the mouth is that of shut lips; `darken_mouth` models the open mouth instead.
        assets.mouth.iter().for_each(|vertex| head.sky[*vertex as usize] = MOUTH_SKY);
        head.lit.clear();
        let vertices = head.points.iter().zip(&head.normals).zip(&head.sky).zip(&assets.is_skin);
        let lit = vertices.map(|(((point, normal), sky), skin)| {
            shade(&scene.lighting, &self.shadow, &Surface { point: *point, normal: *normal, sky: *sky, skin: *skin })
        });
        head.lit.extend(lit);
    }
}

impl Head {
    /// Deforms, places and projects the head.
    fn pose(&mut self, assets: &Assets, person: &Person, scene: &Scene) {
        assets.deformer.deform(&assets.rig, &person.base, &scene.weights, &mut self.shape);
        self.points.clone_from(&self.shape);
        scene.placement.place(&mut self.points, &assets.shoulder);
        self.normals.resize(self.points.len(), Vec3::ZERO);
        normals_into(&self.points, &assets.surface, &mut self.normals);
        let scale = SAMPLES as f32;
        let seen = |point: &Vec3| {
            scene.lens.project(*point).map_or((Vec2::NAN, 0.0), |(pixel, inverse_depth)| (scale * pixel, inverse_depth))
        };
        self.screen.clear();
        self.screen.extend(self.points.iter().map(seen));
    }

    /// Darkens the mouth behind the lips. The less the lips are open, the faster the light falls off.
    fn darken_mouth(&mut self, assets: &Assets) {
        let [upper, lower] = [62, 66].map(|index| self.shape[assets.rig.landmarks[index]]);
        let front = f32::midpoint(upper.z, lower.z);
        let gap = (upper - lower).length();
        let open = (0.3 + 0.6 * gap).min(1.0);
        let reach = 1.2 + 0.6 * gap;
        for vertex in &assets.mouth {
            let vertex = *vertex as usize;
            let share = open * (-(front - self.shape[vertex].z - 0.3).max(0.0) / reach).exp();
            self.lit[vertex].diffuse *= share;
            self.lit[vertex].gloss *= share;
        }
    }
}

/// Barycentric coordinates of a sample in its triangle.
#[derive(Debug, Clone, Copy)]
pub struct Barycentric {
    /// The triangle's vertices.
    pub vertices: [usize; 3],
    /// Their weights, which sum to 1.
    pub weights: Vec3,
}

impl Barycentric {
    /// Interpolates an attribute of the vertices.
    #[inline]
    pub fn interpolate<T: core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>>(
        &self,
        of: impl Fn(usize) -> T,
    ) -> T {
        let [a, b, c] = self.vertices;
        of(a) * self.weights.x + of(b) * self.weights.y + of(c) * self.weights.z
    }
}

/// Calls `paint` for every visible sample of the triangles.
fn draw(
    canvas: &mut Canvas,
    head: &Head,
    triangles: &[Triangle],
    lift: f32,
    mut paint: impl FnMut(&mut Canvas, usize, f32, Barycentric),
) {
    let grid = canvas.grid;
    for [a, b, c] in triangles {
        let vertices = [*a as usize, *b as usize, *c as usize];
        let [one, two, three] = [head.screen[vertices[0]], head.screen[vertices[1]], head.screen[vertices[2]]];
        let inverse_depths = Vec3::new(one.1, two.1, three.1) * lift;
        grid.fill([one.0, two.0, three.0], |index, weights| {
            let inverse_depth = weights.dot(inverse_depths);
            if canvas.is_visible(index, inverse_depth) {
                paint(canvas, index, inverse_depth, Barycentric { vertices, weights });
            }
        });
    }
}
