//! Things that hide a part of the face: a hand, a microphone, strands of hair, or a scarf, made of ellipsoids.

use glam::{Mat3, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::props::Prop;

/// Draws a thing before a face. `skin` and `hair` are colours in linear light.
pub fn random_occluder(rng: &mut ChaCha8Rng, skin: Vec3, hair: Vec3) -> Prop {
    let mut prop = Prop::new(None);
    match rng.random_range(0..20) {
        0..8 => hand(rng, &mut prop, skin),
        8..12 => microphone(rng, &mut prop),
        12..16 => strands(rng, &mut prop, hair),
        _ => scarf(rng, &mut prop),
    }
    prop
}

/// Returns axes with `along` as the direction of the second one.
fn axes(along: Vec3, half: Vec3) -> Mat3 {
    let along = along.normalize_or(Vec3::Y);
    let right = along.cross(Vec3::Z).normalize_or(Vec3::X);
    Mat3::from_cols(right * half.x, along * half.y, right.cross(along) * half.z)
}

/// A hand that lies on one side of the face: on the chin, beside the mouth, on the cheek or an eye. Its fingers point
/// upwards.
fn hand(rng: &mut ChaCha8Rng, prop: &mut Prop, skin: Vec3) {
    let side = if rng.random() { 1.0 } else { -1.0 };
    let (reach, height) = (rng.random_range(3.0..7.0), rng.random_range(-13.0..-3.0));
    let palm = Vec3::new(side * reach, height, 12.8 - 0.09 * reach * reach - 0.03 * (height + 1.0).powi(2));
    let up = Vec3::new(-side * rng.random_range(-0.2..0.4), 1.0, 0.05).normalize_or(Vec3::Y);
    let across = up.cross(Vec3::Z).normalize_or(Vec3::X);
    let shade = |unit: Vec3| skin * (0.92 + 0.08 * unit.y);
    prop.ellipsoid(palm, axes(up, Vec3::new(3.6, 4.2, 1.1)), shade);
    for finger in 0_u8..4 {
        let offset = f32::from(finger) - 1.5;
        let length = 3.6 - 0.35 * offset * offset + rng.random_range(-0.3..0.3);
        let direction = (up + 0.08 * offset * across).normalize_or(up);
        let centre = palm + offset * 1.75 * across + (3.2 + 0.75 * length) * direction;
        prop.ellipsoid(centre, axes(direction, Vec3::new(0.85, length, 0.8)), shade);
    }
    prop.ellipsoid(palm - 7.0 * up, axes(up, Vec3::new(2.9, 6.0, 2.2)), shade);
}

/// A dark microphone below or before the mouth, on a handle.
fn microphone(rng: &mut ChaCha8Rng, prop: &mut Prop) {
    let head = Vec3::new(rng.random_range(-3.0..3.0), rng.random_range(-9.0..-4.5), rng.random_range(13.0..17.0));
    let grey = rng.random_range(0.01..0.2);
    let radius = rng.random_range(1.8..3.2);
    let grid = move |unit: Vec3| Vec3::splat(grey * (1.0 + 0.5 * (14.0 * unit.x).sin() * (14.0 * unit.y).sin()));
    prop.ellipsoid(head, Mat3::from_diagonal(Vec3::splat(radius)), grid);
    let along = Vec3::new(rng.random_range(-0.7..0.7), -1.0, rng.random_range(-0.2..0.6));
    let handle = head + (radius + 6.0) * along.normalize_or(Vec3::NEG_Y);
    prop.ellipsoid(handle, axes(along, Vec3::new(1.1, 8.0, 1.1)), |_| Vec3::splat(0.6 * grey));
}

/// Strands of hair that hang over one half of the forehead, and often over an eye.
fn strands(rng: &mut ChaCha8Rng, prop: &mut Prop, hair: Vec3) {
    let side = if rng.random() { 1.0 } else { -1.0 };
    let (inner, length) = (rng.random_range(0.0..3.5), rng.random_range(2.5..6.0));
    for strand in 0_u8..7 {
        let x = inner + 0.75 * f32::from(strand) + rng.random_range(-0.2..0.2);
        let along = Vec3::new(side * rng.random_range(-0.05..0.3), -1.0, 0.1);
        let centre = Vec3::new(side * x, 10.2 - 0.8 * length, 11.4 - 0.075 * x * x);
        let light = rng.random_range(0.7..1.3);
        prop.ellipsoid(centre, axes(along, Vec3::new(0.55, length, 0.4)), |unit| {
            hair * light * (1.0 + 0.3 * (20.0 * unit.x).sin())
        });
    }
}

/// A scarf or collar over chin and mouth.
fn scarf(rng: &mut ChaCha8Rng, prop: &mut Prop) {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let (stripes, strength) = (rng.random_range(0.0..25.0), rng.random_range(0.0..0.6));
    let top = rng.random_range(-6.5..-1.5);
    let half = rng.random_range(3.5..6.0);
    let cloth = move |unit: Vec3| hue * hue * (1.0 - strength * (0.5 + 0.5 * (stripes * unit.y).sin()));
    let centre = Vec3::new(0.0, top - half, 4.0);
    prop.ellipsoid(centre, Mat3::from_diagonal(Vec3::new(9.0, half, 9.5)), cloth);
}

#[cfg(test)]
mod tests {
    use glam::Vec2;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    /// Both eyes and the mouth of the rig.
    const PLACES: [Vec2; 3] = [Vec2::new(-3.15, 3.3), Vec2::new(3.15, 3.3), Vec2::new(0.0, -3.4)];

    #[test]
    fn an_occluder_lies_before_the_face_and_nearly_always_leaves_an_eye_or_the_mouth_free() {
        let mut hidden = 0;
        for seed in 0..300 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let prop = random_occluder(&mut rng, Vec3::splat(0.4), Vec3::splat(0.1));
            let skin = |at: Vec2| 11.5 - 0.09 * at.x * at.x - 0.03 * (at.y + 1.0).powi(2);
            let before = |point: &Vec3| point.x.abs() < 7.0 && point.y > -11.0 && point.z > skin(point.truncate());
            assert!(prop.points.iter().any(before), "{seed}");
            let near = |place: &Vec2| prop.points.iter().any(|point| point.truncate().distance(*place) < 1.0);
            hidden += u32::from(PLACES.iter().all(near));
        }
        assert!(hidden <= 9, "{hidden} of 300");
    }
}
