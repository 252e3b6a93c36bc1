//! How fast the face may move from packet to packet.

use std::time::Duration;

use facewire_packet::{Packet, State};

/// The default of `failsafe.slew_per_s`.
const SLEW_PER_S: f32 = 4.0;
/// The packet rounds ages and coefficients: these are the steps.
const WIRE_S: f32 = 0.0002;
const WIRE_STEP: f32 = 2.0 / 65535.0;
/// The greatest age that a packet can express, microseconds.
const OLDEST_US: u32 = 6_553_500;

/// Checks that the face does not move faster than the limit, except from one live packet to the next.
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
