//! Finds the minimum of a function of a few numbers whose scale is known.

/// How often the steps are halved.
const HALVINGS: usize = 9;
/// Limit on the rounds with steps of one size.
const MOST_ROUNDS: usize = 60;

/// Returns the point at which `cost` is lowest, as a search by coordinates finds it: from `start`, each coordinate goes up or
/// down by its step as long as that lowers the cost, and then the steps are halved.
pub fn minimum<const N: usize>(
    start: [f64; N],
    mut steps: [f64; N],
    cost: impl Fn(&[f64; N]) -> f64,
) -> ([f64; N], f64) {
    let mut best = (start, cost(&start));
    for _ in 0..HALVINGS {
        for _ in 0..MOST_ROUNDS {
            if !improve(&mut best, &steps, &cost) {
                break;
            }
        }
        steps = steps.map(|step| step / 2.0);
    }
    best
}

/// Tries a step up and a step down along each coordinate. Returns whether one was taken.
fn improve<const N: usize>(best: &mut ([f64; N], f64), steps: &[f64; N], cost: &impl Fn(&[f64; N]) -> f64) -> bool {
    let mut is_better = false;
    for (coordinate, step) in steps.iter().enumerate() {
        for signed in [*step, -step] {
            let mut point = best.0;
            point[coordinate] += signed;
            let found = cost(&point);
            if found < best.1 {
                (*best, is_better) = ((point, found), true);
            }
        }
    }
    is_better
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bottom_of_a_bowl_is_found_and_walls_are_kept() {
        let bowl = |[x, y]: &[f64; 2]| (x - 0.3).powi(2) + 2.0 * (y + 0.7).powi(2);
        let ([x, y], cost) = minimum([0.0, 0.0], [0.2, 0.2], bowl);
        assert!((x - 0.3).abs() < 1e-2 && (y + 0.7).abs() < 1e-2 && cost < 1e-3, "{x} {y}");
        let walled = |point: &[f64; 2]| if point[1] < 0.0 { f64::INFINITY } else { bowl(point) };
        assert!(minimum([0.0, 0.5], [0.2, 0.2], walled).0[1] >= 0.0);
    }
}
