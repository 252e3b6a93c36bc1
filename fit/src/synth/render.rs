//! Renders a person to linear light: deforms, places and lights the head, then draws skin, mouth and eyes, and at last
//! brows and lashes over them.

use glam::{Vec2, Vec3};

use super::assets::{Assets, BOUNDS};
use super::canvas::{Canvas, Position, Window};
use super::paint::{GUMS, LASHES, Painter, TEETH};
use super::person::Person;
use super::props::PropLayer;
use super::rig::{Triangle, normals_into, smoothstep};
use super::scene::{PIVOT, Scene};
use super::shade::{DepthMap, Surface, VertexLight, shade};
use crate::design::index_of;

const SHADOW_SIDE: usize = 200;
/// Visibility of the sky directly behind the lips.
const MOUTH_SKY: f32 = 0.6;
/// Factor on the inverse depth of brows, so that the skin below does not hide them.
const LIFT: f32 = 1.0005;

/// Width of a face seen from the front in centimetres.
pub const FACE_CM: f32 = 14.5;
/// Landmarks of the outer edge of the lips, which enclose all that is visible of the mouth; and a margin in samples.
const LIPS: core::ops::Range<usize> = 48..60;
const LIPS_MARGIN: u8 = 6;
/// Distance by which the eyeball lies further back behind a shut lid, because the lids of some heads are too flat for
/// their eyes, in centimetres.
const SHUT_EYE_CM: f32 = 0.4;
const SAMPLES_PER_FACE: f32 = 150.0;

pub struct Renderer {
    least_density: f32,
    canvas: Canvas,
    shadow: DepthMap,
    head: Head,
    props: PropLayer,
}

#[derive(Default)]
pub struct Head {
    pub shape: Vec<Vec3>,
    pub points: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub lit: Vec<VertexLight>,
    screen: Vec<(Position, f32)>,
    sky: Vec<f32>,
}

impl Renderer {
    pub fn new(size: [usize; 2], least_density: f32) -> Self {
        Self {
            least_density,
            canvas: Canvas::new(size),
            shadow: DepthMap::new(SHADOW_SIDE),
            head: Head::default(),
            props: PropLayer::default(),
        }
    }

    pub fn draw(&mut self, assets: &Assets, person: &Person, scene: &Scene, pixels: &mut [[f32; 3]]) {
        self.canvas.clear(self.density(scene));
        self.head.pose(assets, person, scene, self.canvas.density);
        self.light(assets, person.looks.wrinkles, scene);
        self.head.darken_mouth(assets);
        let painter = Painter::new(assets, person, &self.head, &scene.lighting);
        let parts = &assets.rig.parts;
        let canvas = &mut self.canvas;
        let head = &self.head;
        let whole = canvas.grid.whole();
        let lips = assets.rig.landmarks[LIPS].iter().map(|vertex| head.screen[*vertex].0);
        let mouth = canvas.grid.around(lips, LIPS_MARGIN);
        draw(canvas, &head.screen, (&parts.skin, &whole), 1.0, |number, vertices| {
            let paint = painter.skin(person.covers[number], vertices);
            move |canvas, index, inverse_depth, weights| canvas.set(index, inverse_depth, paint.colour(weights))
        });
        for (part, colour, gloss) in [(&parts.gums, GUMS, 1.0), (&parts.teeth, TEETH, 1.5)] {
            draw(canvas, &head.screen, (part, &mouth), 1.0, |_, vertices| {
                let lit = |vertex: usize| &head.lit[vertex];
                let corners = Corners(vertices.map(|vertex| colour * lit(vertex).diffuse + gloss * lit(vertex).gloss));
                move |canvas, index, inverse_depth, weights| canvas.set(index, inverse_depth, corners.at(weights))
            });
        }
        for (eye, lift) in parts.eyes.iter().zip(eye_lifts(scene)) {
            draw(canvas, &head.screen, (eye, &whole), lift, |_, vertices| {
                let painter = &painter;
                move |canvas, index, inverse_depth, weights| {
                    canvas.set(index, inverse_depth, painter.eye(Barycentric { vertices, weights }));
                }
            });
        }
        draw(canvas, &head.screen, (&person.brow_triangles, &whole), LIFT, |_, vertices| {
            let painter = &painter;
            move |canvas, index, _, weights| {
                let (alpha, colour) = painter.brow(Barycentric { vertices, weights });
                canvas.blend(index, alpha, colour);
            }
        });
        draw(canvas, &head.screen, (&parts.lashes, &whole), 1.0, |_, _| {
            |canvas: &mut Canvas, index, _, _| canvas.blend(index, person.looks.lashes, LASHES)
        });
        for prop in &scene.props {
            self.props.draw(canvas, prop, scene, &self.shadow);
        }
        self.canvas.resolve(pixels);
    }

    pub fn eye_corners(&self, assets: &Assets) -> [Vec2; 2] {
        [36, 45].map(|index| self.head.screen[assets.rig.landmarks[index]].0.samples() / self.canvas.density)
    }

    /// Returns the samples per side of a pixel. More would not be visible to the mesh network at 192 pixels.
    fn density(&self, scene: &Scene) -> f32 {
        let face_px = FACE_CM * scene.lens.focal_px / -scene.placement.position.z;
        (SAMPLES_PER_FACE / face_px).max(self.least_density)
    }

    fn light(&mut self, assets: &Assets, wrinkles: f32, scene: &Scene) {
        let head = &mut self.head;
        if scene.lighting.shadows {
            let key = scene.lighting.lights.first().map_or(Vec3::Y, |lamp| lamp.toward);
            let bounds = (scene.placement.position + BOUNDS.0 - PIVOT, BOUNDS.1);
            let caster = assets.caster.vertices.iter().map(|vertex| head.points[*vertex as usize]);
            self.shadow.draw(key, bounds, caster, &assets.caster.triangles);
        }
        assets.occlusion.visibility(&scene.weights, &mut head.sky);
        // The ambient occlusion of the mouth is that of shut lips; `darken_mouth` models the open mouth instead.
        assets.mouth.iter().for_each(|vertex| head.sky[*vertex as usize] = MOUTH_SKY);
        head.lit.clear();
        let vertices = head.points.iter().zip(&head.normals).zip(&head.sky).zip(&assets.is_skin);
        let lit = vertices.map(|(((point, normal), sky), skin)| {
            shade(&scene.lighting, &self.shadow, &Surface { point: *point, normal: *normal, sky: *sky, skin: *skin })
        });
        head.lit.extend(lit);
        assets.wrinkles.each(&scene.weights, |vertex, depth| {
            head.lit[vertex].diffuse *= 1.0 - wrinkles * depth;
        });
    }
}

impl Head {
    fn pose(&mut self, assets: &Assets, person: &Person, scene: &Scene, density: Vec2) {
        assets.deformer.deform(&assets.rig, &person.base, &scene.weights, &mut self.shape);
        self.points.clone_from(&self.shape);
        scene.placement.place(&mut self.points, &assets.shoulder);
        self.normals.resize(self.points.len(), Vec3::ZERO);
        normals_into(&self.points, &assets.surface, &mut self.normals);
        self.screen.clear();
        self.screen.extend(self.points.iter().map(|point| on_screen(scene, density, *point)));
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

#[derive(Debug, Clone, Copy)]
pub struct Barycentric {
    pub vertices: [usize; 3],
    pub weights: Vec3,
}

impl Barycentric {
    #[inline]
    pub fn interpolate<T: core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>>(
        &self,
        of: impl Fn(usize) -> T,
    ) -> T {
        let [a, b, c] = self.vertices;
        of(a) * self.weights.x + of(b) * self.weights.y + of(c) * self.weights.z
    }
}

pub struct Corners<T>(pub [T; 3]);

impl<T: Copy + core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>> Corners<T> {
    #[inline]
    pub fn at(&self, weights: Vec3) -> T {
        let [a, b, c] = self.0;
        a * weights.x + b * weights.y + c * weights.z
    }
}

pub fn on_screen(scene: &Scene, density: Vec2, point: Vec3) -> (Position, f32) {
    let seen = scene.lens.project(point);
    seen.map_or((Position::NOWHERE, 0.0), |(pixel, depth)| (Position::new(density * pixel), depth))
}

/// Returns factors on the inverse depths of the left and the right eyeball, so that no shut lid lets the eye through.
fn eye_lifts(scene: &Scene) -> [f32; 2] {
    ["eyeBlinkLeft", "eyeBlinkRight"].map(|name| {
        let shut = smoothstep(0.4, 0.8, scene.weights[index_of(name)]);
        1.0 + SHUT_EYE_CM * shut / scene.placement.position.z
    })
}

/// Calls `paint(number, vertices)` for every triangle that covers samples of the window. Calls the function that
/// `paint` returns for every visible sample, with the sample's index, inverse depth and barycentric coordinates.
pub fn draw<Paint: FnMut(&mut Canvas, usize, f32, Vec3)>(
    canvas: &mut Canvas,
    screen: &[(Position, f32)],
    (triangles, window): (&[Triangle], &Window),
    lift: f32,
    paint: impl Fn(usize, [usize; 3]) -> Paint,
) {
    for (number, triangle) in triangles.iter().enumerate() {
        let vertices = triangle.map(|vertex| vertex as usize);
        let [one, two, three] = vertices.map(|vertex| screen[vertex]);
        let Some(covered) = window.cover([one.0, two.0, three.0]) else { continue };
        let inverse_depths = Vec3::new(one.1, two.1, three.1) * lift;
        let mut sample = paint(number, vertices);
        covered.each(|index, weights| {
            let inverse_depth = weights.dot(inverse_depths);
            if canvas.is_visible(index, inverse_depth) {
                sample(canvas, index, inverse_depth, weights);
            }
        });
    }
}
