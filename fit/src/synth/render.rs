//! A person and a shot to linear light: deform, place, light, and draw back to front of detail: skin, mouth, eyes,
//! then brows and lashes over them.

use glam::{Vec2, Vec3};

use super::{
    canvas::{Canvas, SAMPLES},
    geometry::normals_into,
    kit::{BOUNDS, Kit},
    paint::{LASHES, Painter},
    person::Person,
    rig::Triangle,
    scene::Shot,
    shade::{Lit, Surface, light},
    shadow::DepthMap,
};

/// Cells of a side of the key light's depth map.
const SHADOW_SIDE: usize = 200;
/// Share of the sky seen inside the mouth, right behind the lips.
const MOUTH_SKY: f32 = 0.6;
/// Brows and lashes are drawn this much nearer (relative), so that the skin below them does not hide them.
const LIFT: f32 = 1.0005;

/// Room for drawing pictures of one size, used again and again.
pub struct Renderer {
    canvas: Canvas,
    shadow: DepthMap,
    head: Head,
}

/// A head as it is in one picture, by vertex.
#[derive(Default)]
pub struct Head {
    /// Deformed, in the rig's own frame.
    pub shape: Vec<Vec3>,
    /// In the world.
    pub points: Vec<Vec3>,
    /// Unit normals in the world.
    pub normals: Vec<Vec3>,
    /// Light.
    pub lit: Vec<Lit>,
    /// Place among the samples, and inverse of the distance.
    screen: Vec<(Vec2, f32)>,
    sky: Vec<f32>,
}

impl Renderer {
    /// For pictures of this size in pixels.
    pub fn new(size: [usize; 2]) -> Self {
        Self { canvas: Canvas::new(size), shadow: DepthMap::new(SHADOW_SIDE), head: Head::default() }
    }

    /// Draws a person over the backdrop that `pixels` holds; linear light.
    pub fn draw(&mut self, kit: &Kit, person: &Person, shot: &Shot, pixels: &mut [Vec3]) {
        self.head.pose(kit, person, shot);
        self.light(kit, shot);
        self.head.darken_mouth(kit);
        self.canvas.clear();
        let painter = Painter::new(kit, person, &self.head, &shot.lighting);
        let parts = &kit.rig.parts;
        let canvas = &mut self.canvas;
        let head = &self.head;
        draw(canvas, head, &parts.skin, 1.0, |canvas, index, near, corners| {
            canvas.put(index, near, painter.skin(corners));
        });
        draw(canvas, head, &parts.gums, 1.0, |canvas, index, near, corners| {
            canvas.put(index, near, painter.gums(corners));
        });
        draw(canvas, head, &parts.teeth, 1.0, |canvas, index, near, corners| {
            canvas.put(index, near, painter.teeth(corners));
        });
        for eye in &parts.eyes {
            draw(canvas, head, eye, 1.0, |canvas, index, near, corners| {
                canvas.put(index, near, painter.eye(corners));
            });
        }
        draw(canvas, head, &kit.brows[person.looks.brow].triangles, LIFT, |canvas, index, _, corners| {
            let (alpha, colour) = painter.brow(corners);
            canvas.blend(index, alpha, colour);
        });
        draw(canvas, head, &parts.lashes, 1.0, |canvas, index, _, _| {
            canvas.blend(index, person.looks.lashes, LASHES);
        });
        self.canvas.resolve(pixels);
    }

    /// Where the outer corners of the eyes are in the picture drawn last, pixels: the person's right, then left.
    pub fn eye_corners(&self, kit: &Kit) -> [Vec2; 2] {
        [36, 45].map(|index| self.head.screen[kit.rig.landmarks[index]].0 / SAMPLES as f32)
    }

    fn light(&mut self, kit: &Kit, shot: &Shot) {
        let head = &mut self.head;
        let key = shot.lighting.lights.first().map_or(Vec3::Y, |lamp| lamp.toward);
        let bounds = (shot.placement.position + BOUNDS.0 - Vec3::new(0.0, -1.0, 3.0), BOUNDS.1);
        self.shadow.draw(key, bounds, &head.points, &kit.rig.parts.skin);
        kit.sky.seen(&shot.weights, &mut head.sky);
        // What the lips hide at rest, the fall-off behind them accounts for.
        kit.mouth.iter().for_each(|vertex| head.sky[*vertex as usize] = MOUTH_SKY);
        head.lit.clear();
        let vertices = head.points.iter().zip(&head.normals).zip(&head.sky).zip(&kit.is_skin);
        let lit = vertices.map(|(((point, normal), sky), skin)| {
            light(&shot.lighting, &self.shadow, &Surface { point: *point, normal: *normal, sky: *sky, skin: *skin })
        });
        head.lit.extend(lit);
    }
}

impl Head {
    /// Deforms, places and projects.
    fn pose(&mut self, kit: &Kit, person: &Person, shot: &Shot) {
        kit.puppet.deform(&kit.rig, &person.base, &shot.weights, &mut self.shape);
        self.points.clone_from(&self.shape);
        shot.placement.place(&mut self.points, &kit.shoulder);
        self.normals.resize(self.points.len(), Vec3::ZERO);
        normals_into(&self.points, &kit.surface, &mut self.normals);
        let scale = SAMPLES as f32;
        let seen =
            |point: &Vec3| shot.lens.project(*point).map_or((Vec2::NAN, 0.0), |(place, near)| (scale * place, near));
        self.screen.clear();
        self.screen.extend(self.points.iter().map(seen));
    }

    /// Light falls off behind the lips, the faster the less they are open.
    fn darken_mouth(&mut self, kit: &Kit) {
        let [upper, lower] = [62, 66].map(|index| self.shape[kit.rig.landmarks[index]]);
        let front = f32::midpoint(upper.z, lower.z);
        let gap = (upper - lower).length();
        let open = (0.3 + 0.6 * gap).min(1.0);
        let reach = 1.2 + 0.6 * gap;
        for vertex in &kit.mouth {
            let vertex = *vertex as usize;
            let share = open * (-(front - self.shape[vertex].z - 0.3).max(0.0) / reach).exp();
            self.lit[vertex].diffuse *= share;
            self.lit[vertex].gloss *= share;
        }
    }
}

/// Weights of a sample's corners.
#[derive(Debug, Clone, Copy)]
pub struct Corners {
    /// Vertices.
    pub vertices: [usize; 3],
    /// Their shares, which sum to 1.
    pub weights: Vec3,
}

impl Corners {
    /// Blends what the corners have.
    #[inline]
    pub fn mix<T: core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>>(&self, of: impl Fn(usize) -> T) -> T {
        let [a, b, c] = self.vertices;
        of(a) * self.weights.x + of(b) * self.weights.y + of(c) * self.weights.z
    }
}

/// Calls `paint` for every sample of the triangles that is not hidden.
fn draw(
    canvas: &mut Canvas,
    head: &Head,
    triangles: &[Triangle],
    lift: f32,
    mut paint: impl FnMut(&mut Canvas, usize, f32, Corners),
) {
    let grid = canvas.grid;
    for [a, b, c] in triangles {
        let vertices = [*a as usize, *b as usize, *c as usize];
        let [one, two, three] = [head.screen[vertices[0]], head.screen[vertices[1]], head.screen[vertices[2]]];
        let nears = Vec3::new(one.1, two.1, three.1) * lift;
        grid.fill([one.0, two.0, three.0], |index, weights| {
            let near = weights.dot(nears);
            if canvas.sees(index, near) {
                paint(canvas, index, near, Corners { vertices, weights });
            }
        });
    }
}
