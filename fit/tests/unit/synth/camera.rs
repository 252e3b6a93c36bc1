use facewire_fit::synth::camera::*;
use facewire_fit::synth::scene::random_effects;
use glam::{Vec2, Vec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

const WIDTH: usize = 24;

#[test]
fn noise_has_the_deviation_of_photons_and_sensor() {
    let mut camera = Camera::new([WIDTH, 16]).expect("a camera");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let drawn = random_effects(&mut rng);
    let effects = Effects { exposure: Vec3::ONE, vignette: 0.0, noise: [0.04, 0.03], contrast: 1.0, ..drawn };
    let mut light = vec![[0.25; 3]; WIDTH * 16];
    camera.expose(&mut light, &effects, &mut rng);
    let seen = light.as_flattened().iter().map(|value| value / TONE_SCALE);
    let deviation = (seen.map(|value| (value - 0.25).powi(2)).sum::<f32>() / (3 * WIDTH * 16) as f32).sqrt();
    assert!((deviation / 0.000_4_f32.sqrt().hypot(0.03) - 1.0).abs() < 0.1, "{deviation}");
}

fn point(column: usize, row: usize) -> Vec<[f32; 3]> {
    let mut light = vec![[0.0; 3]; WIDTH * 16];
    light[row * WIDTH + column] = [1.0; 3];
    light
}

fn centre(light: &[[f32; 3]]) -> [f32; 3] {
    let weighed = |weight: fn(usize) -> f32| -> f32 {
        light.iter().enumerate().map(|(index, pixel)| weight(index) * pixel[1]).sum()
    };
    let sum = weighed(|_| 1.0);
    [weighed(|index| (index % WIDTH) as f32) / sum, weighed(|index| (index / WIDTH) as f32) / sum, sum]
}

#[test]
fn blur_neither_moves_nor_loses_light_and_an_even_picture_stays_even_up_to_its_border() {
    let mut scratch = vec![[0.0; 3]; WIDTH * 16];
    let mut even = vec![[0.5; 3]; WIDTH * 16];
    defocus(&mut even, &mut scratch, WIDTH, 1.3);
    smear(&mut even, &mut scratch, WIDTH, Vec2::new(-3.0, 5.0));
    assert!(even.as_flattened().iter().all(|value| (value - 0.5).abs() < 1e-5));
    for (column, row) in [(10, 7), (12, 8)] {
        let (mut defocused, mut smeared) = (point(column, row), point(column, row));
        defocus(&mut defocused, &mut scratch, WIDTH, 1.3);
        smear(&mut smeared, &mut scratch, WIDTH, Vec2::new(4.0, -2.0));
        for light in [defocused, smeared] {
            let [x, y, sum] = centre(&light);
            assert!((x - column as f32).abs() < 0.01 && (y - row as f32).abs() < 0.01, "{x} {y}");
            assert!((sum - 1.0).abs() < 1e-4 && light[row * WIDTH + column][0] < 0.5);
        }
    }
}
