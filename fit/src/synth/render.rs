//! Renders a person to linear light: deforms, places and lights the head, then draws skin, mouth and eyes, and at last
//! brows and lashes over them.

use glam::{Vec2, Vec3, Vec3A};

use super::anatomy::TONGUE_OUT;
use super::assets::{Assets, BOUNDS};
use super::canvas::{Barycentric, Canvas, Corners, Position, draw};
use super::paint::{GUMS, LASHES, Painter, TEETH};
use super::person::Person;
use super::props::{Lens, Prop, light_in_mouth};
use super::rig::{Triangle, normals_into, smoothstep};
use super::scene::{FACE_CM, PIVOT, Scene};
use super::shade::{DepthMap, Lighting, Surface, VertexLight, shade};
use super::tongue::light_beside;
use super::visible::REGIONS;
use crate::shapes::index_of;

const SHADOW_SIDE: usize = 200;
/// Visibility of the sky directly behind the lips.
const MOUTH_SKY: f32 = 0.6;
/// Factor on the inverse depth of brows, so that the skin below does not hide them.
const LIFT: f32 = 1.0005;

/// Landmarks of the outer edge of the lips, which enclose all that is visible of the mouth; and a margin in samples.
const LIPS: core::ops::Range<usize> = 48..60;
const LIPS_MARGIN: u8 = 6;
/// Distance by which the eyeball lies further back behind a shut lid, because the lids of some heads are too flat for
/// their eyes, in centimetres.
const SHUT_EYE_CM: f32 = 0.4;
const SAMPLES_PER_FACE: f32 = 150.0;
/// Exponent and strength of the lamps' reflections on a lens.
const GLINT: (i32, f32) = (900, 3.0);
/// Factor on the gloss of a moist surface.
const WET: f32 = 2.5;
/// The tint, or the share of a reflection, from which on a lens hides what is behind it, and at which it hides all.
const LENS_HIDES: [f32; 2] = [0.4, 0.95];
/// Largest share of a lens's colour that its reflections replace.
const MOST_GLARE: f32 = 0.9;

pub struct Renderer {
    least_density: f32,
    canvas: Canvas,
    shadow: DepthMap,
    /// The vertices of the head with its expression, not yet placed before the camera.
    shape: Vec<Vec3>,
    head: Placed,
    sky: Vec<f32>,
    prop: Placed,
}

/// A mesh before the camera, vertex by vertex.
#[derive(Default)]
struct Placed {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    lit: Vec<VertexLight>,
    screen: Vec<(Position, f32)>,
}

impl Renderer {
    pub fn new(size: [usize; 2], least_density: f32) -> Self {
        Self {
            least_density,
            canvas: Canvas::new(size),
            shadow: DepthMap::new(SHADOW_SIDE),
            shape: Vec::new(),
            head: Placed::default(),
            sky: Vec::new(),
            prop: Placed::default(),
        }
    }

    pub fn draw(&mut self, assets: &Assets, person: &Person, scene: &Scene, pixels: &mut [[f32; 3]]) {
        self.canvas.clear(self.density(scene));
        assets.deformer.deform(&assets.rig, &person.base, &scene.weights, &mut self.shape);
        let shoulders = assets.shoulder.iter().copied();
        self.head.points.clone_from(&self.shape);
        self.head.place(scene, self.canvas.density, &assets.surface, shoulders);
        let out = scene.weights[*TONGUE_OUT];
        let tongue = scene.tongue.build(&assets.rig, &assets.below_tongue, &self.shape, out);
        self.light(assets, person.looks.wrinkles, scene);
        self.darken_mouth(assets);
        if let Some(tongue) = &tongue {
            for vertex in assets.below_tongue.iter().map(|vertex| *vertex as usize) {
                self.head.lit[vertex].diffuse *= light_beside(tongue, self.shape[vertex]);
            }
        }
        let (canvas, head) = (&mut self.canvas, &self.head);
        let painter = Painter::new(assets, person, (&head.points, &head.normals, &head.lit), &scene.lighting);
        let parts = &assets.rig.parts;
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
        for prop in tongue.iter().chain(scene.props.iter().map(AsRef::as_ref)) {
            self.prop.draw(canvas, prop, scene, &self.shadow);
        }
        self.canvas.resolve(pixels);
    }

    pub fn eye_corners(&self, assets: &Assets) -> [Vec2; 2] {
        [36, 45].map(|index| self.head.screen[assets.rig.landmarks[index]].0.samples() / self.canvas.density)
    }

    /// Returns the corners of the mouth in pixels: the person's right one, then the left.
    pub fn mouth_corners(&self, assets: &Assets) -> [Vec2; 2] {
        [48, 54].map(|index| self.head.screen[assets.rig.landmarks[index]].0.samples() / self.canvas.density)
    }

    /// Returns which share of each region is in view.
    pub fn visible(&self, assets: &Assets) -> [f32; REGIONS] {
        assets.regions.each_ref().map(|vertices| {
            let views = vertices.iter().map(|vertex| {
                let (position, inverse_depth) = self.head.screen[*vertex];
                self.canvas.view(position, inverse_depth)
            });
            views.sum::<f32>() / vertices.len().max(1) as f32
        })
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
        assets.occlusion.visibility(&scene.weights, &mut self.sky);
        // The ambient occlusion of the mouth is that of shut lips; `darken_mouth` models the open mouth instead.
        assets.mouth.iter().for_each(|vertex| self.sky[*vertex as usize] = MOUTH_SKY);
        head.lit.clear();
        let vertices = head.points.iter().zip(&head.normals).zip(&self.sky).zip(&assets.is_skin);
        let lit = vertices.map(|(((point, normal), sky), skin)| {
            shade(&scene.lighting, &self.shadow, &Surface { point: *point, normal: *normal, sky: *sky, skin: *skin })
        });
        head.lit.extend(lit);
        assets.wrinkles.each(&scene.weights, |vertex, depth| {
            head.lit[vertex].diffuse *= 1.0 - wrinkles * depth;
        });
    }

    fn darken_mouth(&mut self, assets: &Assets) {
        let lips = [62, 66].map(|index| self.shape[assets.rig.landmarks[index]]);
        for vertex in &assets.mouth {
            let vertex = *vertex as usize;
            let share = light_in_mouth(lips, self.shape[vertex].z);
            self.head.lit[vertex].diffuse *= share;
            self.head.lit[vertex].gloss *= share;
        }
    }
}

/// Returns factors on the inverse depths of the left and the right eyeball, so that no shut lid lets the eye through.
fn eye_lifts(scene: &Scene) -> [f32; 2] {
    ["eyeBlinkLeft", "eyeBlinkRight"].map(|name| {
        let shut = smoothstep(0.4, 0.8, scene.weights[index_of(name)]);
        1.0 + SHUT_EYE_CM * shut / scene.placement.position.z
    })
}

impl Placed {
    /// Places the points of a mesh before the camera. `shoulder` tells how much each turns with the shoulders.
    fn place(&mut self, scene: &Scene, density: Vec2, triangles: &[Triangle], shoulder: impl Iterator<Item = f32>) {
        scene.placement.place(&mut self.points, shoulder);
        self.normals.resize(self.points.len(), Vec3::ZERO);
        normals_into(&self.points, triangles, &mut self.normals);
        let on_screen = |point: &Vec3| {
            let seen = scene.lens.project(*point);
            seen.map_or((Position::NOWHERE, 0.0), |(pixel, depth)| (Position::new(density * pixel), depth))
        };
        self.screen.clear();
        self.screen.extend(self.points.iter().map(on_screen));
    }

    fn draw(&mut self, canvas: &mut Canvas, prop: &Prop, scene: &Scene, shadow: &DepthMap) {
        self.points.clone_from(&prop.points);
        self.place(scene, canvas.density, &prop.triangles, core::iter::repeat(0.0));
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
        if let Some(lips) = prop.lips {
            for (lit, point) in self.lit.iter_mut().zip(&prop.points) {
                let share = light_in_mouth(lips, point.z);
                lit.diffuse *= share;
                lit.gloss *= share * WET;
            }
        }
        // A tongue is a part of the face.
        let hides = if prop.lips.is_some() { 0.0 } else { 1.0 };
        let window = canvas.grid.whole();
        draw(canvas, &self.screen, (&prop.triangles, &window), 1.0, |_, vertices| {
            let colour = |vertex: usize| Vec3A::from(prop.colours[vertex]) * self.lit[vertex].diffuse;
            let corners = Corners(vertices.map(|vertex| colour(vertex) + self.lit[vertex].gloss));
            move |canvas, index, inverse_depth, weights| {
                canvas.set(index, inverse_depth, corners.at(weights));
                canvas.hide(index, hides);
            }
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
                canvas.hide(index, smoothstep(LENS_HIDES[0], LENS_HIDES[1], lens.tint.max(share)));
                canvas.blend(index, lens.tint, Vec3A::ZERO);
                canvas.blend(index, share, Vec3A::from(1.5 * seen + lamps(&scene.lighting, mirrored)));
            }
        });
    }
}

fn lamps(lighting: &Lighting, toward: Vec3) -> Vec3 {
    let seen = |toward: Vec3, lamp: Vec3| GLINT.1 * toward.dot(lamp).max(0.0).powi(GLINT.0);
    lighting.lights.iter().map(|lamp| lamp.colour * seen(toward, lamp.toward)).sum()
}
