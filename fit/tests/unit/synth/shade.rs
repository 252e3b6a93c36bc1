use facewire_fit::synth::shade::*;
use glam::Vec3;

fn lit(toward: Vec3) -> VertexLight {
    let lights = vec![Light { toward, colour: Vec3::ONE }];
    let lighting = Lighting { ambient: [Vec3::ZERO; 4], lights, shadows: true, softness: 0.5 };
    let surface = Surface { point: Vec3::new(0.0, 0.0, -50.0), normal: Vec3::Z, sky: 1.0, skin: true };
    let mut shadow = DepthMap::new(8);
    shadow.draw(toward, (Vec3::ZERO, 1.0), [], &[]);
    shade(&lighting, &shadow, &surface)
}

#[test]
fn light_is_brightest_at_normal_incidence_and_absent_from_behind() {
    assert!((lit(Vec3::Z).diffuse - 1.0).length() < 1e-5);
    assert!(lit(Vec3::NEG_Z).diffuse.length() < 1e-5);
    assert!(lit(Vec3::Z).gloss.x > lit(Vec3::new(0.8, 0.0, 0.6)).gloss.x);
}

#[test]
fn points_behind_a_triangle_are_in_shadow_and_points_beside_it_are_not() {
    let points = [Vec3::new(-1.0, -1.0, 2.0), Vec3::new(1.0, -1.0, 2.0), Vec3::new(0.0, 1.0, 2.0)];
    let mut map = DepthMap::new(64);
    map.draw(Vec3::Z, (Vec3::ZERO, 4.0), points, &[[0, 1, 2]]);
    let light = |x: f32, y: f32, z: f32| map.light_at(Vec3::new(x, y, z), 1.0);
    assert_eq!([light(0.0, 0.0, 0.0), light(0.0, 0.0, 3.0), light(2.5, 0.0, 0.0)], [0.0, 1.0, 1.0]);
    assert_eq!(light(0.0, 0.0, 2.0), 1.0, "a surface does not shade itself");
    assert_eq!(light(50.0, 0.0, 0.0), 1.0, "outside the map there is light");
}
