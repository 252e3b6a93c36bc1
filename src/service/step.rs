//! The steps of the pipeline, from all that it can do down to what a very slow board can do.
//!
//! docs/service.md tells what each step costs in milliseconds and in accuracy; `scripts/measure-steps` measures both.

use std::fmt;
use std::time::Duration;

/// Longest time between two processed frames. A face that moves less often than twice a second is of no use, and the
/// failsafe would take longer to notice a lost camera.
const LONGEST_PERIOD: Duration = Duration::from_millis(500);
/// What a frame takes if the heads take turns, in percent of a frame on which all heads run, with its decoding. The step
/// is a small one, so that the difference between machines matters little.
const TURNS_PERCENT: u32 = 90;

/// A step. A later one takes less of the processor's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Step {
    /// Every frame, with all networks.
    #[default]
    Full,
    /// Every frame; of the three networks for lips and eyes, one runs on each frame.
    Turns,
    /// Every second frame, with all networks; the later ones likewise.
    Half,
    Third,
    Quarter,
    Sixth,
    Eighth,
    Twelfth,
}

impl Step {
    pub const ALL: [Self; 8] =
        [Self::Full, Self::Turns, Self::Half, Self::Third, Self::Quarter, Self::Sixth, Self::Eighth, Self::Twelfth];

    /// The step with this name, for arguments.
    pub fn parse(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL.into_iter().find(|step| step.name() == name).ok_or_else(|| format!("give one of {}", names()))
    }

    /// Its name, and of how many frames of the camera one is processed.
    fn row(self) -> (&'static str, u32) {
        match self {
            Self::Full => ("full", 1),
            Self::Turns => ("turns", 1),
            Self::Half => ("half", 2),
            Self::Third => ("third", 3),
            Self::Quarter => ("quarter", 4),
            Self::Sixth => ("sixth", 6),
            Self::Eighth => ("eighth", 8),
            Self::Twelfth => ("twelfth", 12),
        }
    }

    /// The name in the status line, in the metrics and in arguments.
    pub fn name(self) -> &'static str {
        self.row().0
    }

    /// Of how many frames of the camera one is processed.
    pub fn every(self) -> u32 {
        self.row().1
    }

    /// Whether the networks for lips and eyes take turns.
    pub fn has_turns(self) -> bool {
        self == Self::Turns
    }

    /// What the step does, for the log.
    pub(super) fn sentence(self) -> String {
        match self {
            Self::Full => "every frame is processed".to_owned(),
            Self::Turns => "the networks for lips and eyes take turns".to_owned(),
            lower => format!("one frame in {} is processed", lower.every()),
        }
    }

    /// Time between two processed frames of a camera with this frame period. A step that was chosen for a faster camera
    /// takes more frames of this one.
    pub(super) fn period(self, camera: Duration) -> Duration {
        (camera * self.every()).min(LONGEST_PERIOD.max(camera))
    }

    /// Whether the step is not too slow for a camera with this frame period.
    pub(super) fn suits(self, camera: Duration) -> bool {
        self.every() == 1 || camera * self.every() <= LONGEST_PERIOD
    }

    /// How long a frame takes on this step, if it takes this long with all networks.
    pub(super) fn busy(self, full: Duration) -> Duration {
        if self.has_turns() { full * TURNS_PERCENT / 100 } else { full }
    }

    /// How long a frame would take with all networks, if it takes this long on this step.
    pub(super) fn full_busy(self, busy: Duration) -> Duration {
        if self.has_turns() { busy * 100 / TURNS_PERCENT } else { busy }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FPS_30: Duration = Duration::from_micros(33_333);

    #[test]
    fn each_step_takes_less_of_the_processors_time_than_the_one_before() {
        let busy = Duration::from_millis(100);
        let share = |step: Step| step.busy(busy).div_duration_f64(step.period(FPS_30));
        assert!(Step::ALL.windows(2).all(|pair| share(pair[1]) < share(pair[0])));
        assert_eq!(Step::Turns.full_busy(Step::Turns.busy(busy)), busy);
    }

    #[test]
    fn no_step_is_slower_than_two_frames_a_second() {
        let last = |fps: u32| Step::ALL.into_iter().rfind(|step| step.suits(Duration::from_secs(1) / fps));
        assert_eq!(
            [60, 30, 15, 5, 1].map(last),
            [Some(Step::Twelfth), Some(Step::Twelfth), Some(Step::Sixth), Some(Step::Half), Some(Step::Turns)]
        );
        let after_a_fast_camera = |fps: u32| Step::Twelfth.period(Duration::from_secs(1) / fps);
        assert_eq!([5, 1].map(after_a_fast_camera), [LONGEST_PERIOD, Duration::from_secs(1)]);
    }
}
