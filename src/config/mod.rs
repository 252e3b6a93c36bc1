//! Settings.

/// When the output leaves the last pose, and how fast.
#[derive(Debug, Clone, PartialEq)]
pub struct FailsafeSettings {
    pub live_ms: u32,
    pub hold_ms: u32,
    pub neutral_ms: u32,
    pub slew_per_s: f32,
}
