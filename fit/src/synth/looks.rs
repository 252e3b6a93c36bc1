//! Draws the looks of people: textures, colours, hair and beard.

use glam::Vec3;
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;

use super::{
    assets::Assets,
    person::{BeardStyle, Looks},
    sample::{TextureChoice, normal},
};

/// Hair colours in linear light: black, dark and light brown, blond, red, grey.
const HAIR: [[f32; 3]; 6] = [
    [0.012, 0.010, 0.009],
    [0.045, 0.026, 0.016],
    [0.11, 0.065, 0.035],
    [0.35, 0.25, 0.13],
    [0.2, 0.07, 0.025],
    [0.3, 0.3, 0.31],
];
/// Skin of lower lightness counts as dark.
const DARK_SKIN: f32 = 0.16;

fn pick(rng: &mut ChaCha8Rng, list: &[usize]) -> usize {
    list.iter().choose(rng).copied().unwrap_or(0)
}

/// Draws the looks of a person.
pub fn random_looks(rng: &mut ChaCha8Rng, assets: &Assets, textures: &TextureChoice) -> Looks {
    let skin = pick(rng, &textures.skins);
    let hair = hair_colour(rng, assets.skins[skin].lightness);
    let brow = hair.min(Vec3::splat(0.12)) * rng.random_range(0.12..0.55);
    let bearded = rng.random_bool(0.3);
    Looks {
        skin,
        brow: pick(rng, &textures.brows),
        eye: pick(rng, &textures.eyes),
        tint: Vec3::new(rng.random_range(0.9..1.12), 1.0, rng.random_range(0.88..1.1)) * rng.random_range(0.75..1.2),
        gloss: rng.random_range(0.4..2.2),
        hair: rng.random_bool(0.85).then(|| (hair, rng.random_range(0.1..1.6))),
        hairline: normal(rng, 0.6, 1.5),
        beard: if bearded { rng.random_range(0.15..0.95) } else { 0.0 },
        beard_style: BeardStyle::Full,
        wrinkles: 0.0,
        brow_colour: (brow, rng.random_range(0.6..1.0)),
        brow_lift: brow_lift(rng),
        brow_thickness: rng.random_range(1.0..1.9),
        iris: rng.random_range(0.355..0.42),
        lashes: rng.random_range(0.05..0.5),
        cloth: (cloth_colour(rng), normal(rng, 1.0, 2.0) - 13.0),
    }
}

/// Draws the offset of the brows' inner and outer end in centimetres: high or low, level or arched.
fn brow_lift(rng: &mut ChaCha8Rng) -> [f32; 2] {
    let (inner, tilt) = (normal(rng, 0.22, 0.6), normal(rng, 0.22, 0.5));
    [inner, inner + tilt]
}

/// Draws a colour for clothes. Most colours are unsaturated.
fn cloth_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let grey = Vec3::splat(rng.random_range(0.01..0.7));
    grey.lerp(hue * hue * 0.6, rng.random_range(0.0_f32..0.9).powi(2))
}

/// Draws a hair colour. People with dark skin mostly have black hair.
fn hair_colour(rng: &mut ChaCha8Rng, skin_lightness: f32) -> Vec3 {
    let black = skin_lightness < DARK_SKIN && rng.random_bool(0.8);
    let kind = if black { HAIR[0] } else { HAIR.iter().choose(rng).copied().unwrap_or_default() };
    Vec3::from_array(kind) * rng.random_range(0.7..1.4)
}
