use facewire_fit::synth::canvas::*;
use glam::{Vec2, Vec3, Vec3A};

#[test]
fn at_any_density_an_even_surface_stays_even_and_an_edge_stays_in_its_place() {
    for density in [1.0, 1.25, 1.37, 1.5, 1.8, 2.0] {
        let mut canvas = Canvas::new([40, 30]);
        canvas.clear(density);
        let Grid { width, height } = canvas.grid;
        for index in (0..width * height).filter(|index| (index % width) as f32 + 0.5 < width as f32 / 4.0) {
            canvas.set(index, 0.1, Vec3A::ONE);
        }
        let mut pixels = vec![[0.0; 3]; 40 * 30];
        canvas.resolve(&mut pixels);
        let brightness: f32 = pixels.iter().map(|pixel| pixel[0]).sum::<f32>() / 30.0;
        assert!((brightness - 10.0).abs() < 0.51, "{density}: {brightness}");
        assert!((pixels[5][0] - 1.0).abs() < 1e-5 && pixels[15][0] < 1e-5, "{density}");
        assert!(!canvas.is_visible(0, 0.05) && canvas.is_visible(0, 0.2), "{density}");
    }
}

const GRID: Grid = Grid { width: 40, height: 30 };

fn fill(corners: [Vec2; 3], sample: impl FnMut(usize, Vec3)) {
    if let Some(covered) = GRID.whole().cover(corners.map(Position::new)) {
        covered.each(sample);
    }
}

fn coverage(triangles: &[[Vec2; 3]]) -> Vec<u32> {
    let mut counts = vec![0; GRID.width * GRID.height];
    for corners in triangles {
        fill(*corners, |index, _| counts[index] += 1);
    }
    counts
}

fn fan(centre: Vec2, blades: u8) -> Vec<[Vec2; 3]> {
    let rim = |blade: u8| {
        let angle = f32::from(blade) / f32::from(blades) * core::f32::consts::TAU;
        centre + 90.0 * Vec2::from_angle(angle)
    };
    (0..blades).map(|blade| [centre, rim((blade + 1) % blades), rim(blade)]).collect()
}

#[test]
fn triangles_that_share_edges_cover_every_sample_exactly_once() {
    for (centre, blades) in [(Vec2::new(20.5, 15.5), 8), (Vec2::new(13.37, 11.11), 7), (Vec2::new(20.0, 15.0), 64)] {
        let counts = coverage(&fan(centre, blades));
        assert!(counts.iter().all(|count| *count == 1), "{centre}, {blades} blades");
    }
}

#[test]
fn triangles_outside_the_grid_and_invalid_corners_are_skipped() {
    let far = [Vec2::new(-500.0, -500.0), Vec2::new(-400.0, 900.0), Vec2::new(-300.0, 10.0)];
    let invalid = [Vec2::new(f32::NAN, 0.0), Vec2::new(1e9, 3.0), Vec2::new(0.0, 20.0)];
    assert!(coverage(&[far, invalid]).iter().all(|count| *count == 0));
}

#[test]
fn a_window_shows_the_samples_around_its_positions_and_no_others() {
    let whole = [Vec2::new(-300.0, -300.0), Vec2::new(20.0, 900.0), Vec2::new(900.0, -300.0)].map(Position::new);
    let window = GRID.around([Vec2::new(10.0, 4.0), Vec2::new(20.0, 9.0)].map(Position::new), 2);
    let mut seen = Vec::new();
    window.cover(whole).expect("covered").each(|index, _| seen.push([index % GRID.width, index / GRID.width]));
    assert_eq!(seen.len(), 14 * 9);
    assert_eq!((seen.first(), seen.last()), (Some(&[8, 2]), Some(&[21, 10])));
}

#[test]
fn weights_interpolate_the_position_and_only_triangles_that_face_the_camera_are_drawn() {
    let corners = [Vec2::new(2.0, 2.0), Vec2::new(5.0, 25.0), Vec2::new(35.0, 7.0)];
    fill(corners, |index, weights| {
        let position = corners[0] * weights.x + corners[1] * weights.y + corners[2] * weights.z;
        let expected = Vec2::new((index % GRID.width) as f32 + 0.5, (index / GRID.width) as f32 + 0.5);
        assert!((weights.element_sum() - 1.0).abs() < 1e-4 && (position - expected).length() < 0.01);
    });
    let turned = [corners[0], corners[2], corners[1]];
    assert!(coverage(&[corners]).iter().sum::<u32>() > 100, "it faces the camera");
    assert_eq!(coverage(&[turned]).iter().sum::<u32>(), 0, "it faces away");
}
