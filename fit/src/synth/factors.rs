//! Factors of variety, each of which can be taken away, so that its effect on the fit can be measured.
//!
//! All random numbers are drawn as before, so that everything else in the pictures stays the same.

use Factor as F;
use clap::ValueEnum;
use glam::{Vec2, Vec3};
use turbojpeg::Subsamp;

use super::camera::Effects;
use super::person::Looks;
use super::scene::{Light, Lighting};

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
        let name = |factor: &Factor| factor.to_possible_value().map(|value| value.get_name().to_owned());
        self.0.iter().filter_map(name).collect()
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
                F::Eyes => (looks.iris, looks.lashes) = (0.39, 0.15),
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

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    use crate::synth::scene::random_effects;

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
}
