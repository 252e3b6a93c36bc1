//! A smooth rise.

/// Rises from 0 to 1 between two values, without a step or a kink.
pub fn smoothstep(value: f32, [from, to]: [f32; 2]) -> f32 {
    let u = ((value - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}
