//! Arithmetic with points of `N` numbers.

/// The point on the way from `from` to `to` after this share of it.
pub fn towards<const N: usize>(from: [f32; N], to: [f32; N], share: f32) -> [f32; N] {
    let mut out = from;
    out.iter_mut().zip(to).for_each(|(value, to)| *value += share * (to - *value));
    out
}

/// `a - b`.
pub fn difference<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    let mut out = a;
    out.iter_mut().zip(b).for_each(|(value, b)| *value -= b);
    out
}

/// Adds `weight` times `point` to `sum`.
pub fn add<const N: usize>(sum: &mut [f32; N], weight: f32, point: [f32; N]) {
    sum.iter_mut().zip(point).for_each(|(sum, value)| *sum += weight * value);
}

/// The square of the length of a vector.
pub fn square<const N: usize>(point: [f32; N]) -> f32 {
    point.iter().map(|value| value * value).sum()
}
