//! A motion from 0 to 1 within limits of speed and acceleration.

/// Longest time that one step accounts for, seconds. After a longer pause the motion goes on as if it had been paused.
const LONGEST_STEP_S: f32 = 0.1;
/// A position this close to its target counts as there: 0.1 µs in a range of 1000 µs, where a Maestro's step is 0.25.
const ARRIVED: f32 = 1e-4;

/// Limits of a motion, in units of its range from 0 to 1. Infinity means no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    pub speed_per_s: f32,
    pub acceleration_per_s2: f32,
}

impl Limits {
    /// A motion without limits is always at its target.
    pub const NONE: Self = Self { speed_per_s: f32::INFINITY, acceleration_per_s2: f32::INFINITY };
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    pub position: f32,
    speed_per_s: f32,
}

impl Motion {
    pub fn at(position: f32) -> Self {
        Self { position, speed_per_s: 0.0 }
    }

    pub fn step(&mut self, limits: Limits, target: f32, step_s: f32) -> f32 {
        let target = if target.is_nan() { self.position } else { target.clamp(0.0, 1.0) };
        if limits == Limits::NONE {
            *self = Self::at(target);
        }
        if !(step_s > 0.0) {
            return self.position;
        }
        let step_s = step_s.min(LONGEST_STEP_S);
        let way = target - self.position;
        let change_per_s = limits.acceleration_per_s2 * step_s;
        let fastest = braking_speed(way.abs(), limits.acceleration_per_s2, step_s).min(limits.speed_per_s);
        let wanted = fastest.copysign(way);
        let speed_per_s = wanted.clamp(self.speed_per_s - change_per_s, self.speed_per_s + change_per_s);
        let reached = self.position + speed_per_s * step_s;
        let can_stop = self.speed_per_s.abs().max(speed_per_s.abs()) <= change_per_s;
        let is_there = can_stop && (reached - target).abs() <= ARRIVED;
        *self = if is_there {
            Self::at(target)
        } else {
            // Only steps of uneven length carry a motion beyond its range, and then by a fraction of a step.
            Self { position: reached.clamp(0.0, 1.0), speed_per_s }
        };
        self.position
    }
}

/// Returns the highest speed of this step from which the motion can still stop within `way`: v with
/// v² / 2a + v * step = way.
fn braking_speed(way: f32, acceleration_per_s2: f32, step_s: f32) -> f32 {
    if acceleration_per_s2.is_infinite() {
        return way / step_s;
    }
    let change_per_s = acceleration_per_s2 * step_s;
    (change_per_s * change_per_s + 2.0 * acceleration_per_s2 * way).sqrt() - change_per_s
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f32 = 0.02;
    const ROUNDING: f32 = 1e-4;

    fn wild(random: &mut fastrand::Rng) -> f32 {
        let [large, any] = [(random.f32() - 0.5) * 1e30, random.f32()];
        let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, large, 0.0, 1.0, any, any];
        values[random.usize(..values.len())]
    }

    #[test]
    fn no_step_exceeds_position_speed_or_acceleration_whatever_the_target_and_however_long_it_takes() {
        let mut random = fastrand::Rng::with_seed(1);
        for is_even in [true, false].into_iter().cycle().take(400) {
            let (speed_per_s, acceleration_per_s2) = (0.05 + 10.0 * random.f32(), 0.5 + 100.0 * random.f32());
            let limits = Limits { speed_per_s, acceleration_per_s2 };
            let (mut motion, mut target) = (Motion::at(random.f32()), 0.5);
            for _ in 0..500 {
                if random.u32(0..20) == 0 {
                    target = wild(&mut random);
                }
                let (before, step_s) = (motion, if is_even { STEP_S } else { 0.2 * random.f32() });
                motion.step(limits, target, step_s);
                let counted_s = step_s.min(0.1);
                assert!((0.0..=1.0).contains(&motion.position));
                let way = (motion.position - before.position).abs();
                assert!(way <= speed_per_s * counted_s * (1.0 + ROUNDING) + 1e-4, "{way} {step_s} {limits:?}");
                let change_per_s = (motion.speed_per_s - before.speed_per_s).abs();
                let most_per_s = acceleration_per_s2 * counted_s * (1.0 + ROUNDING) + ROUNDING;
                assert!(!is_even || change_per_s <= most_per_s, "{change_per_s} {limits:?}");
            }
        }
    }

    #[test]
    fn a_step_arrives_without_overshoot_in_the_time_that_its_limits_allow() {
        assert_eq!(Motion::at(0.0).step(Limits::NONE, 0.7, 0.0), 0.7, "no limits take no time");
        for (speed_per_s, acceleration_per_s2, least_s, most_s) in [
            (2.0, f32::INFINITY, 0.5, 0.52),
            (f32::INFINITY, 4.0, 1.0, 1.1),
            // 0.5 s to speed up, 0.5 s to slow down, and half of the way at full speed.
            (1.0, 2.0, 1.5, 1.6),
            (f32::INFINITY, f32::INFINITY, 0.02, 0.02),
        ] {
            let limits = Limits { speed_per_s, acceleration_per_s2 };
            let (mut motion, mut time_s) = (Motion::at(0.0), 0.0);
            while motion.position < 1.0 && time_s < 10.0 {
                let before = motion.position;
                assert!(motion.step(limits, 1.0, STEP_S) >= before);
                time_s += STEP_S;
            }
            assert!((least_s - ROUNDING..=most_s + ROUNDING).contains(&time_s), "{time_s} {limits:?}");
            assert_eq!(motion, Motion::at(1.0));
        }
    }
}
