//! Conditions that make tracking hard: glasses, beards, covered faces, light from one side, dark rooms, small faces.
//!
//! Each occurs with a small frequency, or, with `--condition`, in every picture and alone. Conditions draw from a stream
//! of random numbers of their own, so that everything else is the same with and without them.

use clap::ValueEnum;
use glam::Vec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::camera::Effects;
use super::factors::{Factor, Without};
use super::person::{BeardStyle, Looks};
use super::props::Glasses;
use super::render::FACE_CM;
use super::scene::{Lens, Light, Lighting};

const GLASSES: f32 = 0.12;
const SIDE_LIGHT: f32 = 0.05;
const DARK: f32 = 0.05;
const SMALL: f32 = 0.05;
const OCCLUDED: f64 = 0.05;
const SMALL_PX: [f32; 2] = [55.0, 65.0];

/// A condition that all pictures of a set have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Condition {
    /// Glasses or sunglasses
    Glasses,
    /// A full beard, moustache, goatee or stubble
    Beard,
    /// A hand, a microphone, hair or a scarf over a part of the face
    Occluded,
    /// One hard lamp at the side, and darkness on the other
    SideLight,
    /// A dark room: a noisy picture with little contrast
    Dark,
    /// A face about 60 pixels wide
    Small,
}

#[derive(Debug, Clone)]
pub struct Conditions {
    pub glasses: Option<Glasses>,
    pub occluded: f64,
    beard: (BeardStyle, Option<f32>),
    side_light: Option<Light>,
    /// Exposure, noise and contrast of a dark room.
    dark: Option<(f32, [f32; 2], f32)>,
    small_px: Option<f32>,
    wrinkles: f32,
}

impl Conditions {
    /// Draws the conditions of a subject: only `forced`, or each one with its frequency if it is not taken away.
    pub fn random(rng: &mut ChaCha8Rng, forced: Option<Condition>, without: &Without) -> Self {
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
        let style = Glasses::random(rng);
        let beard = BeardStyle::random(rng);
        let full = rng.random_range(0.7..1.0);
        let light = side_light_from(rng);
        let gain = rng.random_range(0.02..0.06);
        let exposure = rng.random_range(0.15..0.4);
        let room = (exposure, [gain, gain * rng.random_range(0.1..0.3)], rng.random_range(0.7..0.9));
        let width = rng.random_range(SMALL_PX[0]..SMALL_PX[1]);
        let wrinkles = rng.random_range(0.0_f32..0.75).powf(1.5);
        Self {
            glasses: glasses.then_some(style),
            occluded: if forced.is_some() { 1.0 } else { OCCLUDED } * f64::from(u8::from(occluded)),
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

#[cfg(test)]
mod tests {
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    fn drawn(forced: Option<Condition>, factors: &[Factor]) -> Vec<Conditions> {
        let without = Without::new(factors, false);
        (0..400).map(|seed| Conditions::random(&mut ChaCha8Rng::seed_from_u64(seed), forced, &without)).collect()
    }

    #[test]
    fn a_forced_condition_is_in_every_picture_and_alone() {
        for people in drawn(Some(Condition::Glasses), &[]) {
            assert!(people.glasses.is_some() && people.occluded == 0.0 && people.small_px.is_none());
        }
        for people in drawn(Some(Condition::Occluded), &[]) {
            assert!((people.occluded - 1.0).abs() < 1e-9 && people.dark.is_none() && people.side_light.is_none());
        }
    }

    #[test]
    fn conditions_are_rare_and_taking_one_away_leaves_the_others_as_they_were() {
        let (all, without) = (drawn(None, &[]), drawn(None, &[Factor::Glasses]));
        assert!((20..90).contains(&all.iter().filter(|person| person.glasses.is_some()).count()));
        for (all, fewer) in all.into_iter().zip(without) {
            assert!(fewer.glasses.is_none());
            assert_eq!(all.dark, fewer.dark);
            assert_eq!(all.small_px, fewer.small_px);
            assert_eq!(all.beard, fewer.beard);
        }
    }
}
