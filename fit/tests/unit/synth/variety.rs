use Factor as F;
use facewire_fit::synth::camera::Effects;
use facewire_fit::synth::scene::random_effects;
use facewire_fit::synth::variety::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn drawn(forced: Option<Condition>, factors: &[Factor]) -> Vec<Conditions> {
    let without = Without::new(factors, false);
    (0..400).map(|seed| Conditions::random(&mut ChaCha8Rng::seed_from_u64(seed), forced, &without, COVERED)).collect()
}

#[test]
fn a_forced_condition_is_in_every_picture_and_alone() {
    for people in drawn(Some(Condition::Glasses), &[]) {
        assert!(people.glasses.is_some() && people.covered.0 == 0.0 && people.small_px.is_none());
    }
    for people in drawn(Some(Condition::Occluded), &[]) {
        assert!((people.covered.0 - 1.0).abs() < 1e-9 && people.dark.is_none() && people.side_light.is_none());
    }
}

#[test]
fn conditions_are_rare_and_taking_one_away_leaves_the_others_as_they_were() {
    let (all, without) = (drawn(None, &[]), drawn(None, &[Factor::Glasses]));
    assert!((20..90).contains(&all.iter().filter(|person| person.glasses.is_some()).count()));
    for (all, fewer) in all.into_iter().zip(without) {
        assert!(fewer.glasses.is_none());
        assert_eq!((all.dark, all.small_px, all.beard), (fewer.dark, fewer.small_px, fewer.beard));
    }
}

#[test]
fn a_factor_that_is_taken_away_becomes_plain_and_no_other_changes() {
    let drawn = random_effects(&mut ChaCha8Rng::seed_from_u64(3));
    let mut plain = drawn.clone();
    Without::new(&[F::Noise, F::Jpeg], false).simplify_effects(&mut plain);
    assert_eq!((plain.noise, plain.jpeg_quality), ([0.0; 2], 95));
    let others = |effects: &Effects| (effects.defocus_px, effects.exposure, effects.vignette, effects.sharpening);
    assert_eq!(others(&plain), others(&drawn));
}
