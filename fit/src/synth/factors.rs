//! Factors of variety, each of which can be taken away, so that its effect on the fit can be measured.
//!
//! All random numbers are drawn as before, so that everything else in the pictures stays the same.

use Factor as F;
use clap::ValueEnum;
use glam::{Vec2, Vec3};
use turbojpeg::Subsamp;

use super::backdrop::Backdrop;
use super::camera::Effects;
use super::person::Looks;
use super::scene::{Light, Lighting};

/// Size of a face without [`Factor::Size`], relative to the picture, and its distance without [`Factor::Distance`].
const FACE_SHARE: f32 = 0.5;
const DISTANCE_CM: f32 = 60.0;
/// Factor on the angles without [`Factor::Turns`].
const FEWER_TURNS: f32 = 0.3;

/// A factor of variety.
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
    /// Size of the iris, and lashes
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

/// The factors that the reference renderer of the rig does not have.
const NOT_IN_REFERENCE: [Factor; 23] = [
    F::Noise,
    F::Motion,
    F::Defocus,
    F::Jpeg,
    F::Sharpening,
    F::Vignette,
    F::Exposure,
    F::Contrast,
    F::Light,
    F::Shadows,
    F::Beard,
    F::Hair,
    F::BrowShape,
    F::BrowColour,
    F::Tint,
    F::Gloss,
    F::Eyes,
    F::Glasses,
    F::Occlusion,
    F::SideLight,
    F::Dark,
    F::Small,
    F::Wrinkles,
];

/// The conditions that occur rarely.
const CONDITIONS: [Factor; 5] = [F::Glasses, F::Occlusion, F::SideLight, F::Dark, F::Small];

#[derive(Debug, Clone)]
pub struct Without(Vec<Factor>);

impl Without {
    pub fn new(factors: &[Factor], like_reference: bool) -> Self {
        let reference: &[Factor] = if like_reference { &NOT_IN_REFERENCE } else { &[] };
        let mut all = [factors, reference].concat();
        all.sort_by_key(|factor| *factor as u8);
        all.dedup();
        Self(all)
    }

    pub fn conditions() -> Self {
        Self::new(&CONDITIONS, false)
    }

    pub fn takes(&self, factor: Factor) -> bool {
        self.0.contains(&factor)
    }

    /// Returns the names of the factors, in a fixed order.
    pub fn names(&self) -> Vec<String> {
        let name = |factor: &Factor| factor.to_possible_value().map(|value| value.get_name().to_owned());
        self.0.iter().filter_map(name).collect()
    }

    pub fn simplify_looks(&self, looks: &mut Looks) {
        let Looks { brow_colour, brow_lift, brow_thickness, .. } = looks;
        if self.takes(F::BrowShape) {
            (*brow_lift, *brow_thickness) = ([0.22, 0.44], 1.3);
        }
        if self.takes(F::BrowColour) {
            *brow_colour = (Vec3::splat(0.015), 1.0);
        }
        if self.takes(F::Beard) {
            looks.beard = 0.0;
        }
        if self.takes(F::Hair) {
            looks.hair = None;
        }
        if self.takes(F::Tint) {
            looks.tint = Vec3::ONE;
        }
        if self.takes(F::Gloss) {
            looks.gloss = 1.0;
        }
        if self.takes(F::Eyes) {
            (looks.iris, looks.lashes) = (0.39, 0.15);
        }
    }

    pub fn simplify_identity(&self, identity: &mut [f32]) {
        if self.takes(F::Identity) {
            identity.fill(0.0);
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

    pub fn simplify_backdrop(&self, backdrop: &mut Backdrop) {
        if self.takes(F::Backdrop) {
            backdrop.flatten();
        }
    }

    /// Makes the size of the face, relative to the picture, and its distance in centimetres plain.
    pub fn simplify_size(&self, share: &mut f32, distance_cm: &mut f32) {
        if self.takes(F::Size) {
            *share = FACE_SHARE;
        }
        if self.takes(F::Distance) {
            *distance_cm = DISTANCE_CM;
        }
    }

    pub fn simplify_pose(&self, angles_deg: &mut [f32; 3], position: &mut Vec3, distance_cm: f32) {
        if self.takes(F::Turns) {
            *angles_deg = angles_deg.map(|angle| FEWER_TURNS * angle);
        }
        if self.takes(F::Place) {
            (position.x, position.y) = (0.0, -0.5);
        }
        if self.takes(F::Distance) {
            position.z = -distance_cm;
        }
    }

    pub fn simplify_effects(&self, effects: &mut Effects) {
        if self.takes(F::Noise) {
            effects.noise = [0.0; 2];
        }
        if self.takes(F::Motion) {
            effects.motion_px = Vec2::ZERO;
        }
        if self.takes(F::Defocus) {
            effects.defocus_px = 0.0;
        }
        if self.takes(F::Jpeg) {
            (effects.jpeg_quality, effects.chroma) = (95, Subsamp::Sub2x1);
        }
        if self.takes(F::Sharpening) {
            effects.sharpening = 0.0;
        }
        if self.takes(F::Vignette) {
            effects.vignette = 0.0;
        }
        if self.takes(F::Exposure) {
            effects.exposure = Vec3::splat(0.8);
        }
        if self.takes(F::Contrast) {
            effects.contrast = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    use crate::synth::scene::{random_effects, random_lighting};

    use super::*;

    #[test]
    fn a_factor_that_is_taken_away_becomes_plain_and_no_other_changes() {
        let drawn = random_effects(&mut ChaCha8Rng::seed_from_u64(3));
        let mut plain = drawn.clone();
        Without::new(&[F::Noise, F::Jpeg], false).simplify_effects(&mut plain);
        assert_eq!((plain.noise, plain.jpeg_quality), ([0.0; 2], 95));
        let others = |effects: &Effects| (effects.defocus_px, effects.exposure, effects.vignette, effects.sharpening);
        assert_eq!(others(&plain), others(&drawn));
    }

    #[test]
    fn without_light_the_key_light_comes_from_the_front() {
        for seed in 0..50 {
            let mut lighting = random_lighting(&mut ChaCha8Rng::seed_from_u64(seed));
            Without::new(&[F::Light, F::Shadows], false).simplify_lighting(&mut lighting);
            assert!(lighting.lights[0].toward.z > 0.5 && !lighting.shadows);
        }
    }
}
