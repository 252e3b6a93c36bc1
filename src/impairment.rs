//! What makes tracking poor although every part works, and what the operator can do about it.
//!
//! `facewire check` looks for impairments once. The service looks for them all the time: whoever detects one sets it in
//! [`Impairments`], and clears it when it has passed. The detectors apply hysteresis, so that an impairment does not come
//! and go from frame to frame.

use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

/// Number of impairments.
pub(crate) const COUNT: usize = Impairment::ALL.len();

/// A condition under which tracking is poor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Impairment {
    /// The picture is black, as with a closed shutter.
    Black,
    /// The picture is dark, or noisy because the camera amplifies little light.
    Dark,
    /// The face is much darker than what is behind it.
    Backlight,
    /// The face has few pixels.
    SmallFace,
    /// A part of the face is outside the picture.
    CutOffFace,
    /// The camera delivers half its rate or less, as cameras do that expose longer in dim light.
    HalvedRate,
    /// Frames get lost between the camera and the service.
    MissingFrames,
    /// The supply voltage of the board is too low.
    Undervoltage,
    /// The board is so hot that it has reduced its clock rate, or is about to.
    Hot,
    /// A processor runs slower than it could, because its governor saves power.
    SlowGovernor,
}

impl Impairment {
    /// Every impairment.
    pub const ALL: [Self; 10] = [
        Self::Black,
        Self::Dark,
        Self::Backlight,
        Self::SmallFace,
        Self::CutOffFace,
        Self::HalvedRate,
        Self::MissingFrames,
        Self::Undervoltage,
        Self::Hot,
        Self::SlowGovernor,
    ];

    /// The name in the status line and in the metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Black => "black",
            Self::Dark => "dark",
            Self::Backlight => "backlight",
            Self::SmallFace => "small-face",
            Self::CutOffFace => "cut-off-face",
            Self::HalvedRate => "halved-rate",
            Self::MissingFrames => "missing-frames",
            Self::Undervoltage => "undervoltage",
            Self::Hot => "hot",
            Self::SlowGovernor => "slow-governor",
        }
    }

    /// One sentence: what is the matter, and its remedy.
    #[must_use]
    pub fn sentence(self) -> &'static str {
        match self {
            Self::Black => {
                "the picture is black: open the shutter of the camera, take the cap off its lens, or switch on a light"
            }
            Self::Dark => "the picture is dark or noisy: light the face from the front",
            Self::Backlight => {
                "the face is much darker than what is behind it: turn away from the window, or light the face from the front"
            }
            Self::SmallFace => {
                "the face is small in the picture: move closer to the camera, or choose a larger picture"
            }
            Self::CutOffFace => "a part of the face is outside the picture: turn the camera, or move back",
            Self::HalvedRate => {
                "the camera delivers about half its frame rate or less, as many do to expose longer: add light, or keep the \
                 rate with `v4l2-ctl -d /dev/videoN --set-ctrl=exposure_dynamic_framerate=0` (older kernels \
                 call it exposure_auto_priority)"
            }
            Self::MissingFrames => {
                "frames get lost or damaged between camera and board: give the camera a USB port of its own instead of a \
                 hub, use a short cable, set camera.format = \"mjpeg\", or choose a smaller picture"
            }
            Self::Undervoltage => {
                "the supply voltage is too low, so that the board slows down: use a stronger power supply and a short cable"
            }
            Self::Hot => "the board is so hot that it slows down: add a heat sink or a fan, or let air reach it",
            Self::SlowGovernor => {
                "a processor saves power and so runs slower than it could: write \"performance\" or \"schedutil\" to \
                 /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
            }
        }
    }

    fn bit(self) -> u32 {
        1 << self as u32
    }
}

/// A set of impairments. Displays as their names with commas between them, or as `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ImpairmentSet(u32);

impl ImpairmentSet {
    /// Whether the set contains an impairment.
    #[must_use]
    pub fn contains(self, impairment: Impairment) -> bool {
        self.0 & impairment.bit() != 0
    }

    /// Whether there is too little light on the face, for whatever reason.
    #[must_use]
    pub fn is_dark(self) -> bool {
        [Impairment::Black, Impairment::Dark, Impairment::Backlight].into_iter().any(|poor| self.contains(poor))
    }

    /// Adds or removes an impairment.
    pub fn set(&mut self, impairment: Impairment, is_present: bool) {
        self.0 = if is_present { self.0 | impairment.bit() } else { self.0 & !impairment.bit() };
    }

    /// Returns the impairments of both sets.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Iterates over the impairments of the set.
    pub fn iter(self) -> impl Iterator<Item = Impairment> {
        Impairment::ALL.into_iter().filter(move |impairment| self.contains(*impairment))
    }
}

impl fmt::Display for ImpairmentSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::default() {
            return f.write_str("none");
        }
        for (index, impairment) in self.iter().enumerate() {
            f.write_str(if index == 0 { "" } else { "," })?;
            f.write_str(impairment.name())?;
        }
        Ok(())
    }
}

/// The present impairments of a running service, and how often each has begun. Any thread may set one.
#[derive(Debug, Default)]
pub struct Impairments {
    present: AtomicU32,
    begun: [AtomicU64; COUNT],
}

impl Impairments {
    /// States whether an impairment is present. Counts it if it was not present before.
    pub fn set(&self, impairment: Impairment, is_present: bool) {
        let bit = impairment.bit();
        if !is_present {
            self.present.fetch_and(!bit, Relaxed);
        } else if self.present.fetch_or(bit, Relaxed) & bit == 0
            && let Some(begun) = self.begun.get(impairment as usize)
        {
            begun.fetch_add(1, Relaxed);
        }
    }

    /// Returns the present impairments.
    #[must_use]
    pub fn present(&self) -> ImpairmentSet {
        ImpairmentSet(self.present.load(Relaxed))
    }

    /// Returns the name of each impairment and how often it has begun, in the order of [`Impairment::ALL`].
    #[must_use]
    pub fn begun(&self) -> [(&'static str, u64); COUNT] {
        let mut counts = Impairment::ALL.map(|impairment| (impairment.name(), 0));
        for ((_, count), begun) in counts.iter_mut().zip(&self.begun) {
            *count = begun.load(Relaxed);
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_impairment_is_counted_when_it_begins_and_not_while_it_lasts() {
        let impairments = Impairments::default();
        let hot = |is_present| impairments.set(Impairment::Hot, is_present);
        [true, true, false, false, true].into_iter().for_each(hot);
        impairments.set(Impairment::Dark, true);
        assert_eq!(impairments.present().to_string(), "dark,hot");
        let begun: Vec<_> = impairments.begun().into_iter().filter(|(_, count)| *count > 0).collect();
        assert_eq!(begun, [("dark", 1), ("hot", 2)]);
        hot(false);
        impairments.set(Impairment::Dark, false);
        assert_eq!(impairments.present().to_string(), "none");
    }

    #[test]
    fn each_impairment_has_a_place_of_its_own_and_says_what_to_do() {
        for (index, impairment) in Impairment::ALL.into_iter().enumerate() {
            assert_eq!(impairment as usize, index);
            assert!(impairment.sentence().contains(": "), "{}", impairment.name());
        }
    }
}
