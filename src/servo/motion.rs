//! How a position follows its target within limits of speed and acceleration.

/// Longest time that one step accounts for, seconds. After a longer pause the motion goes on as if it had been paused.
const LONGEST_STEP_S: f32 = 0.1;
/// A position that is this close to its target is at its target: a twentieth of the smallest step of a servo board.
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
    position: f32,
    speed_per_s: f32,
}

impl Motion {
    /// A motion that rests at this position.
    pub fn at(position: f32) -> Self {
        Self { position, speed_per_s: 0.0 }
    }

    pub fn position(&self) -> f32 {
        self.position
    }

    /// Moves towards `target` for `step_s`, and returns the new position.
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

    fn limits(speed_per_s: f32, acceleration_per_s2: f32) -> Limits {
        Limits { speed_per_s, acceleration_per_s2 }
    }

    /// A target that no mapping should give.
    fn wild(random: &mut fastrand::Rng) -> f32 {
        match random.u32(0..8) {
            0 => f32::NAN,
            1 => f32::INFINITY,
            2 => f32::NEG_INFINITY,
            3 => (random.f32() - 0.5) * 1e30,
            4 => 0.0,
            5 => 1.0,
            _ => random.f32(),
        }
    }

    #[test]
    fn no_step_exceeds_position_speed_or_acceleration_whatever_the_target() {
        let mut random = fastrand::Rng::with_seed(1);
        for _ in 0..200 {
            let limits = limits(0.05 + 10.0 * random.f32(), 0.5 + 100.0 * random.f32());
            let (mut motion, mut target) = (Motion::at(random.f32()), 0.5);
            for _ in 0..500 {
                if random.u32(0..20) == 0 {
                    target = wild(&mut random);
                }
                let before = motion;
                motion.step(limits, target, STEP_S);
                let speed = (motion.position - before.position) / STEP_S;
                assert!((0.0..=1.0).contains(&motion.position));
                assert!(speed.abs() <= limits.speed_per_s + ARRIVED / STEP_S, "{speed} {limits:?}");
                let change = (motion.speed_per_s - before.speed_per_s).abs() / STEP_S;
                assert!(change <= limits.acceleration_per_s2 * (1.0 + ROUNDING) + ROUNDING, "{change} {limits:?}");
            }
        }
    }

    #[test]
    fn steps_of_uneven_length_keep_position_and_speed() {
        let mut random = fastrand::Rng::with_seed(2);
        let (limits, mut motion) = (limits(3.0, 20.0), Motion::at(0.0));
        for _ in 0..20_000 {
            let (before, step_s) = (motion.position, 0.2 * random.f32());
            motion.step(limits, wild(&mut random), step_s);
            assert!((0.0..=1.0).contains(&motion.position));
            let longest = limits.speed_per_s * step_s.min(LONGEST_STEP_S) + ARRIVED;
            assert!((motion.position - before).abs() <= longest);
        }
        for impossible in [0.0, -1.0, f32::NAN] {
            let before = motion;
            motion.step(limits, 0.5, impossible);
            assert_eq!(motion, before);
        }
    }

    #[test]
    fn without_limits_the_target_is_reached_in_no_time() {
        let mut motion = Motion::at(0.0);
        let reached = [0.0, f32::NAN, STEP_S].map(|step_s| motion.step(Limits::NONE, 0.7, step_s).to_bits());
        assert_eq!(reached, [0.7_f32.to_bits(); 3]);
    }

    #[test]
    fn a_step_arrives_without_overshoot_in_the_time_that_its_limits_allow() {
        for (limits, least_s, most_s) in [
            (limits(2.0, f32::INFINITY), 0.5, 0.52),
            (limits(f32::INFINITY, 4.0), 1.0, 1.1),
            // 0.5 s to speed up, 0.5 s to slow down, and half of the way at full speed.
            (limits(1.0, 2.0), 1.5, 1.6),
            (Limits::NONE, 0.02, 0.02),
        ] {
            let (mut motion, mut time_s) = (Motion::at(0.0), 0.0);
            while motion.position() < 1.0 {
                let before = motion.position();
                assert!(motion.step(limits, 1.0, STEP_S) >= before);
                time_s += STEP_S;
                assert!(time_s < 10.0, "{limits:?} {motion:?}");
            }
            assert!((least_s - ROUNDING..=most_s + ROUNDING).contains(&time_s), "{time_s} {limits:?}");
            assert_eq!(motion, Motion::at(1.0));
        }
    }
}
