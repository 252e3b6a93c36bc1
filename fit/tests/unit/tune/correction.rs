use facewire_face::COEFFS;
use facewire_fit::shapes::index_of;
use facewire_fit::tune::correction::*;

#[test]
fn every_blendshape_but_the_tongue_has_terms_and_sides_share_them() {
    let mut shapes: Vec<usize> = stems().iter().flat_map(|stem| sides(stem)).collect();
    shapes.sort_unstable();
    assert!(shapes.into_iter().eq(0..COEFFS - 1));
    assert_eq!(sides("jaw"), ["jawLeft", "jawRight"].map(index_of));
}

#[test]
fn a_weak_reading_is_brought_to_its_range_and_a_resting_offset_removed() {
    let truths = (0..200).map(|step| (f64::from(step) / 100.0 - 1.0).max(0.0));
    let pairs: Pairs = truths.flat_map(|truth| [[0.04 + 0.6 * truth, truth]; 5]).collect();
    let found = fit("noseSneer", &pairs);
    for (raw, want) in [(0.04, 0.0), (0.34, 0.5), (0.64, 1.0)] {
        let corrected = found.correct(raw, 0.0, 1.0);
        assert!((corrected - want).abs() < 0.03, "{found:?}: {raw} gives {corrected}");
    }
}
