use facewire_fit::kinds::Predictor;
use facewire_fit::kinds::memory::{GaussianProcess, Kernel};
use facewire_fit::paper::processes::coverage;
use nalgebra::DMatrix;

/// Returns places and noisy values of a curve.
fn cloud(random: &mut fastrand::Rng, count: usize) -> (DMatrix<f64>, Vec<f64>) {
    let places = DMatrix::from_fn(count, 1, |_, _| 4.0 * random.f64() - 2.0);
    // The sum of 12 has a deviation of 1.
    let mut noise = || 0.1 * (0..12).map(|_| random.f64() - 0.5).sum::<f64>();
    let values = places.iter().map(|x| (1.5 * x).sin() + noise()).collect();
    (places, values)
}

#[test]
fn the_95_percent_band_of_a_process_covers_held_out_points_at_about_its_level_and_widens_far_away() {
    let mut random = fastrand::Rng::with_seed(9);
    let (places, values) = cloud(&mut random, 300);
    let (others, wanted) = cloud(&mut random, 2000);
    let process = GaussianProcess::fit(Kernel::Rbf, &places, &values).expect("a process");
    let [share, width, r, mse] = coverage(&process, &others, &wanted);
    assert!((0.93..0.975).contains(&share), "{share}");
    assert!((0.3..0.5).contains(&width) && r > 0.97 && mse < 0.012, "{width} {r} {mse}");
    let [mean, _] = process.distribution(&[0.4]);
    assert!((mean - process.predict(&[0.4])).abs() < 1e-9);
    assert!(process.distribution(&[40.0])[1] > 3.0 * process.distribution(&[0.4])[1]);
}
