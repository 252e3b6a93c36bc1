use facewire_face::COEFFS;
use facewire_fit::shapes::index_of;
use facewire_fit::synth::describe::*;
use facewire_fit::synth::expression::Coefficients;

use crate::synth::anatomy::face as face_of;

/// Returns 11 faces: jawOpen rises from 0 to 1, mouthFunnel with it, mouthSmileLeft falls, mouthSmileRight by half.
fn faces() -> Vec<Coefficients> {
    let face = |step: u8| {
        let open = f32::from(step) / 10.0;
        face_of(&[
            ("jawOpen", open),
            ("mouthFunnel", 0.2 * open),
            ("mouthSmileLeft", 1.0 - open),
            ("mouthSmileRight", (1.0 - open) / 2.0),
        ])
    };
    (0..11).map(face).collect()
}

#[test]
fn figures_have_densities_quantiles_and_the_difference_of_both_sides() {
    let near = |one: f64, other: f64| (one - other).abs() < 1e-6;
    let halves = Figures::of(&[faces(), vec![[0.0; COEFFS]; 11]].concat());
    assert!(near(halves.densities[0], 0.5) && halves.density_quantile(0.5) == 0 && halves.density_quantile(1.0) == 4);
    let visible: usize = faces().iter().map(|face| above(face, VISIBLE)).sum();
    assert!(near(halves.visible(), visible as f64 / 22.0) && near(halves.densities.iter().sum(), 1.0));
    let figures = Figures::of(&faces());
    let shape = |name: &str| &figures.shapes[index_of(name)];
    assert!(near(shape("jawOpen").quantiles[0], 0.5) && near(shape("jawOpen").quantiles[2], 0.9));
    assert!(near(shape("jawOpen").zero, 1.0 / 11.0) && near(shape("browInnerUp").zero, 1.0));
    let [gap, r] = shape("mouthSmileLeft").sides.expect("two sides");
    assert!(near(gap, 0.25) && near(r, 1.0), "{gap} {r}");
    assert!(shape("jawOpen").sides.is_none() && shape("mouthSmileRight").sides.is_none());
}
