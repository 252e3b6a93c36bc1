//! What makes pictures vary. Conditions make tracking hard: glasses, beards, covered faces, light from one side, dark rooms,
//! small faces. Each occurs with a small frequency, or, with `--condition`, in every picture and alone. Factors can be taken
//! away, so that their effect on the fit can be measured.
//!
//! Conditions draw from a stream of random numbers of their own, and all numbers are drawn whatever is taken away, so that
//! everything else in the pictures stays the same.

use Factor as F;
use clap::ValueEnum;
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use turbojpeg::Subsamp;

use super::camera::Effects;
use super::occluders::{Occluder, STRANGE, USUAL};
use super::options::name_of;
use super::person::{BeardStyle, Looks};
use super::props::Glasses;
use super::scene::{FACE_CM, Lens};
use super::shade::{Light, Lighting};

const GLASSES: f32 = 0.12;
const SIDE_LIGHT: f32 = 0.05;
const DARK: f32 = 0.05;
const SMALL: f32 = 0.05;
/// Share of pictures in which something covers a part of the face, unless another is given.
pub const COVERED: f64 = 0.05;
const SMALL_PX: [f32; 2] = [55.0, 65.0];

/// A condition that all pictures of a set have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Condition {
    /// Glasses or sunglasses
    Glasses,
    /// A full beard, moustache, goatee or stubble
    Beard,
    /// Something over a part of the face: any of the next ones, a microphone, a scarf or a cup
    Occluded,
    /// A headset for virtual reality
    Headset,
    /// A face mask
    Mask,
    /// A hand
    Hand,
    /// A microphone before the mouth
    Microphone,
    /// Hair down to the brows or the eyes
    Fringe,
    /// Sunglasses
    Sunglasses,
    /// Glasses with thick rims, in which a window is reflected
    Rims,
    /// Something that training never shows: goggles, a glove, or a sheet of paper
    Strange,
    /// One hard lamp at the side, and darkness on the other
    SideLight,
    /// A dark room: a noisy picture with little contrast
    Dark,
    /// A face about 60 pixels wide
    Small,
}

impl Condition {
    /// The occluders of a picture under this condition.
    fn occluders(self) -> &'static [(Occluder, u32)] {
        match self {
            Self::Occluded => &USUAL,
            Self::Headset => &[(Occluder::Headset, 1)],
            Self::Mask => &[(Occluder::Mask, 1)],
            Self::Hand => &[(Occluder::Hand, 1)],
            Self::Microphone => &[(Occluder::Microphone, 1)],
            Self::Fringe => &[(Occluder::Fringe, 1)],
            Self::Strange => &STRANGE,
            Self::Glasses
            | Self::Beard
            | Self::SideLight
            | Self::Dark
            | Self::Small
            | Self::Sunglasses
            | Self::Rims => &[],
        }
    }
}

#[derive(Debug, Clone)]
pub struct Conditions {
    pub glasses: Option<Glasses>,
    /// Share of the pictures with an occluder, and which ones.
    pub covered: (f64, &'static [(Occluder, u32)]),
    pub beard: (BeardStyle, Option<f32>),
    pub side_light: Option<Light>,
    /// Exposure, noise and contrast of a dark room.
    pub dark: Option<(f32, [f32; 2], f32)>,
    pub small_px: Option<f32>,
    wrinkles: f32,
}

impl Conditions {
    /// Draws the conditions of a subject: only `forced`, or each one with its frequency if it is not taken away.
    /// `covered` is the share of pictures with an occluder if no condition is forced.
    pub fn random(rng: &mut ChaCha8Rng, forced: Option<Condition>, without: &Without, covered: f64) -> Self {
        let mut has = |condition: Condition, factor: Factor, share: f32| {
            let drawn = rng.random::<f32>() < share;
            forced.map_or(drawn && !without.takes(factor), |forced| forced == condition)
        };
        let [glasses, side_light, dark, small, occluded] = [
            has(Condition::Glasses, Factor::Glasses, GLASSES),
            has(Condition::SideLight, Factor::SideLight, SIDE_LIGHT),
            has(Condition::Dark, Factor::Dark, DARK),
            has(Condition::Small, Factor::Small, SMALL),
            has(Condition::Occluded, Factor::Occlusion, 1.0),
        ];
        let mut style = Glasses::random(rng);
        let beard = BeardStyle::random(rng);
        let full = rng.random_range(0.7..1.0);
        let light = side_light_from(rng);
        let gain = rng.random_range(0.02..0.06);
        let exposure = rng.random_range(0.15..0.4);
        let room = (exposure, [gain, gain * rng.random_range(0.1..0.3)], rng.random_range(0.7..0.9));
        let width = rng.random_range(SMALL_PX[0]..SMALL_PX[1]);
        let wrinkles = rng.random_range(0.0_f32..0.75).powf(1.5);
        let has_glasses = match forced {
            Some(Condition::Sunglasses) => {
                style.darken(rng);
                true
            }
            Some(Condition::Rims) => {
                style.thicken(rng);
                true
            }
            _ => glasses,
        };
        let covered = match forced {
            Some(condition) => (f64::from(u8::from(!condition.occluders().is_empty())), condition.occluders()),
            None if occluded => (covered, USUAL.as_slice()),
            None => (0.0, USUAL.as_slice()),
        };
        Self {
            glasses: has_glasses.then_some(style),
            covered,
            beard: (beard, (forced == Some(Condition::Beard)).then_some(full)),
            side_light: side_light.then_some(light),
            dark: dark.then_some(room),
            small_px: small.then_some(width),
            wrinkles: if without.takes(Factor::Wrinkles) { 0.0 } else { wrinkles },
        }
    }

    pub fn apply_to_looks(&self, looks: &mut Looks) {
        looks.beard_style = self.beard.0;
        looks.beard = self.beard.1.unwrap_or(looks.beard);
        looks.wrinkles = self.wrinkles;
    }

    pub fn apply_to_lighting(&self, lighting: &mut Lighting) {
        if let Some(lamp) = self.side_light {
            lighting.ambient = lighting.ambient.map(|light| 0.12 * light);
            lighting.lights = vec![lamp];
        }
    }

    pub fn apply_to_effects(&self, effects: &mut Effects) {
        if let Some((exposure, noise, contrast)) = self.dark {
            effects.exposure *= exposure;
            (effects.noise, effects.contrast) = (noise, contrast);
        }
    }

    /// Returns the focal length in pixels for a head at a distance in centimetres.
    pub fn focal_px(&self, drawn: &Lens, distance_cm: f32) -> f32 {
        self.small_px.map_or(drawn.focal_px, |width| width * distance_cm / FACE_CM)
    }
}

fn side_light_from(rng: &mut ChaCha8Rng) -> Light {
    let side = if rng.random() { 1.0 } else { -1.0 };
    let toward = Vec3::new(side, rng.random_range(-0.1..0.6), rng.random_range(-0.25..0.35));
    let warm = rng.random_range(-0.1..0.3);
    let colour = Vec3::new(1.0 + 0.5 * warm, 1.0, 1.0 - warm) * rng.random_range(0.8..1.5);
    Light { toward: toward.normalize_or(Vec3::X), colour }
}

/// Size of a face without [`Factor::Size`], relative to the picture, and its distance without [`Factor::Distance`].
const FACE_SHARE: f32 = 0.5;
const DISTANCE_CM: f32 = 60.0;
const FEWER_TURNS: f32 = 0.3;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Factor {
    /// Camera noise
    Noise,
    /// Motion blur
    Motion,
    /// Defocus
    Defocus,
    /// Strong JPEG compression; without it, the quality is 95
    Jpeg,
    /// Sharpening by the camera
    Sharpening,
    /// Dark corners
    Vignette,
    /// Exposure and white balance
    Exposure,
    /// Contrast of the tone curve
    Contrast,
    /// Ambient light and lamps from all sides; without it, a bright room and a lamp in front
    Light,
    /// Shadows of the key light
    Shadows,
    /// Beards
    Beard,
    /// Hair; without it, all heads are bald
    Hair,
    /// Height, tilt and thickness of the brows
    BrowShape,
    /// Colour and opacity of the brows; without it, they are dark
    BrowColour,
    /// Tint of the skin's texture
    Tint,
    /// Strength of the skin's highlights
    Gloss,
    /// Size and lightness of the iris, and lashes
    Eyes,
    /// Shapes in the backdrop
    Backdrop,
    /// Shapes of heads; without it, all people have the average head
    Identity,
    /// Size of the face in the picture
    Size,
    /// Distance from the camera
    Distance,
    /// Place of the face in the picture
    Place,
    /// Turned heads; without it, angles are 0.3 times as large
    Turns,
    /// Glasses
    Glasses,
    /// Things that hide a part of the face
    Occlusion,
    /// A single hard lamp at the side
    SideLight,
    /// Dark rooms
    Dark,
    /// Small faces
    Small,
    /// Wrinkles that come with an expression
    Wrinkles,
}

/// The factors that the reference renderer of the rig has, too.
const IN_REFERENCE: [Factor; 6] = [F::Backdrop, F::Identity, F::Size, F::Distance, F::Place, F::Turns];

const CONDITIONS: [Factor; 5] = [F::Glasses, F::Occlusion, F::SideLight, F::Dark, F::Small];

#[derive(Debug, Clone)]
pub struct Without(Vec<Factor>);

impl Without {
    pub fn new(factors: &[Factor], like_reference: bool) -> Self {
        let all = Factor::value_variants().iter().copied();
        let takes = |factor: &Factor| factors.contains(factor) || (like_reference && !IN_REFERENCE.contains(factor));
        Self(all.filter(takes).collect())
    }

    pub fn conditions() -> Self {
        Self::new(&CONDITIONS, false)
    }

    pub fn takes(&self, factor: Factor) -> bool {
        self.0.contains(&factor)
    }

    pub fn names(&self) -> Vec<String> {
        self.0.iter().map(name_of).collect()
    }

    pub fn simplify_person(&self, identity: &mut [f32], looks: &mut Looks) {
        for factor in &self.0 {
            match factor {
                F::Identity => identity.fill(0.0),
                F::BrowShape => (looks.brow_lift, looks.brow_thickness) = ([0.22, 0.44], 1.3),
                F::BrowColour => looks.brow_colour = (Vec3::splat(0.015), 1.0),
                F::Beard => looks.beard = 0.0,
                F::Hair => looks.hair = None,
                F::Tint => looks.tint = Vec3::ONE,
                F::Gloss => looks.gloss = 1.0,
                F::Eyes => (looks.iris_radius, looks.iris_lightness, looks.lashes) = (0.39, 1.0, 0.15),
                _ => {}
            }
        }
    }

    pub fn simplify_lighting(&self, lighting: &mut Lighting) {
        lighting.shadows &= !self.takes(F::Shadows);
        if !self.takes(F::Light) {
            return;
        }
        // As in the reference: the key light comes from the front half, with a share of its drawn strength.
        let toward = |light: &Light| light.toward * Vec3::new(1.0, 0.6, 0.0) + Vec3::new(0.0, 0.3, 1.0);
        let key = lighting.lights.first().map_or(Vec3::Z, |light| toward(light).normalize_or(Vec3::Z));
        let light =
            |toward: Vec3, colour: f32| Light { toward: toward.normalize_or(Vec3::Y), colour: Vec3::splat(colour) };
        lighting.ambient = [Vec3::splat(0.25), Vec3::ZERO, Vec3::splat(0.07), Vec3::ZERO];
        lighting.lights =
            vec![light(key, 0.6), light(Vec3::new(-0.9, 0.2, 0.6), 0.26), light(Vec3::new(0.1, 1.0, -0.4), 0.2)];
    }

    /// Makes the size of the face, relative to the picture, and its distance in centimetres plain.
    pub fn simplify_size(&self, share: &mut f32, distance_cm: &mut f32) {
        *share = if self.takes(F::Size) { FACE_SHARE } else { *share };
        *distance_cm = if self.takes(F::Distance) { DISTANCE_CM } else { *distance_cm };
    }

    pub fn simplify_pose(&self, angles_deg: &mut [f32; 3], position: &mut Vec3, distance_cm: f32) {
        for factor in &self.0 {
            match factor {
                F::Turns => *angles_deg = angles_deg.map(|angle| FEWER_TURNS * angle),
                F::Place => (position.x, position.y) = (0.0, -0.5),
                F::Distance => position.z = -distance_cm,
                _ => {}
            }
        }
    }

    pub fn simplify_effects(&self, effects: &mut Effects) {
        for factor in &self.0 {
            match factor {
                F::Noise => effects.noise = [0.0; 2],
                F::Motion => effects.motion_px = Vec2::ZERO,
                F::Defocus => effects.defocus_px = 0.0,
                F::Jpeg => (effects.jpeg_quality, effects.chroma) = (95, Subsamp::Sub2x1),
                F::Sharpening => effects.sharpening = 0.0,
                F::Vignette => effects.vignette = 0.0,
                F::Exposure => effects.exposure = Vec3::splat(0.8),
                F::Contrast => effects.contrast = 1.0,
                _ => {}
            }
        }
    }
}
