use facewire_face::COEFFS;
use facewire_fit::judge::figures::*;

/// Returns a person whose blendshapes rest in 20 pictures and move up and down in 40. `estimate` gets the true coefficient.
fn person(estimate: impl Fn(f64) -> f64) -> Person {
    let mut faces = SolvedFaces::default();
    for picture in 0..60 {
        let truth = if picture < 20 { 0.0 } else { 0.55 + 0.45 * f64::from(picture).sin() };
        faces.truths.push([truth; COEFFS]);
        faces.estimates.push([estimate(truth); COEFFS]);
        faces.is_neutral.push(picture < 5);
    }
    Person::new("one".to_owned(), &faces, true)
}

fn judged(errors: &[f64]) -> Judgement {
    Judgement::new(errors.iter().map(|error| person(|truth| truth + error)).collect(), 400)
}

#[test]
fn pictures_at_rest_and_moving_are_judged_apart() {
    let person = person(|truth| if truth > REST { truth - 0.1 } else { 0.04 });
    let near = |phase, figure: Figure, value: f64| (person.figures(0, phase)[figure as usize] - value).abs() < 1e-9;
    assert!(near(Phase::AtRest, Figure::Bias, 0.04) && near(Phase::All, Figure::Resting, 0.04));
    assert!(near(Phase::Moving, Figure::Bias, -0.1) && near(Phase::Moving, Figure::Gain, 1.0));
    assert!(near(Phase::All, Figure::Jitter, 0.0));
    assert!(person.figures(0, Phase::AtRest)[Figure::R as usize].is_nan());
    assert!(person.figures(0, Phase::All)[Figure::Gain as usize] < 1.0);
}

#[test]
fn a_bias_that_differs_between_people_is_a_bias_of_each_of_them() {
    let both = judged(&[-0.1, 0.1]);
    let near = |figure, value: f64| (both.get(Row::Blendshape(0), Phase::All, figure) - value).abs() < 1e-9;
    assert!(near(Figure::Bias, 0.0) && near(Figure::MseOfBias, 0.01) && near(Figure::Mse, 0.01));
}

#[test]
fn a_better_model_is_certain_although_people_differ_more_than_the_models() {
    let hard: Vec<f64> = (0..20).map(|person| 0.1 + 0.02 * f64::from(person)).collect();
    let better: Vec<f64> = hard.iter().map(|error| error - 0.005).collect();
    let [a, b] = [judged(&hard), judged(&better)];
    let (difference, interval) = b.difference(&a, Row::Blendshapes, Phase::All, Figure::Mse);
    assert!(difference < 0.0 && interval.high < 0.0 && interval.excludes_zero(), "{difference} {interval:?}");
    let [own, other] = [&b, &a].map(|judged| judged.interval(Row::Blendshapes, Phase::All, Figure::Mse));
    assert!(own.high > other.low, "the intervals of both models overlap");
}
