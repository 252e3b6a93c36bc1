//! How fast the face may move from packet to packet.

use std::time::Duration;

use facewire_packet::{Packet, State};

/// The default of `failsafe.slew_per_s`.
const SLEW_PER_S: f32 = 4.0;
/// Age and coefficients are rounded on the wire.
const WIRE_S: f32 = 0.0002;
const WIRE_STEP: f32 = 2.0 / 65535.0;
/// The age of a packet counts no further, microseconds.
const OLDEST_US: u32 = 6_553_500;

/// Checks that only a live face moves faster than the limit, and not with its first packet.
pub fn assert_slew(last: &Packet, next: &Packet) {
    let is_followed = last.state == State::Live && next.state == State::Live;
    if is_followed || [last, next].iter().any(|packet| packet.age_us >= OLDEST_US) {
        return;
    }
    let sent_us = |packet: &Packet| packet.capture_us.wrapping_add(packet.age_us);
    let elapsed = Duration::from_micros(sent_us(next).wrapping_sub(sent_us(last)).into());
    let limit = SLEW_PER_S * (elapsed.as_secs_f32() + WIRE_S) + WIRE_STEP;
    let steps = last.coefficients.iter().zip(next.coefficients).map(|(last, next)| (next - last).abs());
    let step = steps.fold(0.0, f32::max);
    assert!(step <= limit, "a step of {step} in {elapsed:?}: from {last:?} to {next:?}");
}
