//! Settings of the filters and of the rules of anatomy.

use toml::de::DeValue;

use super::{
    section::{Section, section, write_setting},
    value::{Choice, Value},
};
use crate::solve::{FilterKind, Group, Rules};

impl Choice for FilterKind {
    const ALL: &'static [(&'static str, Self)] = &[
        ("off", Self::Off),
        ("kalman", Self::Kalman),
        ("moving-average", Self::MovingAverage),
        ("time-weighted-average", Self::TimeWeightedAverage),
        ("low-pass", Self::LowPass),
        ("gated-average", Self::GatedAverage),
        ("one-euro", Self::OneEuro),
    ];
}

section! {
    /// How each part of the face is smoothed over time.
    SmoothingSettings {
        /// Filter of the lids (eyeBlink, eyeSquint, eyeWide):
        /// - "off": none
        /// - "gated-average", "one-euro", "kalman": smooth small changes and follow large ones at once
        /// - "moving-average", "time-weighted-average", "low-pass": smooth everything, and delay it
        lids: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time over which the filter averages small changes. A longer time smooths more and follows later. 0 turns the
        /// filter off. A time shorter than two frame periods smooths little or nothing.
        lids_ms: u32 = 350, 0..=350, " (ms)";
        /// Filter of the direction in which the eyes look (eyeLook). It takes the values of `lids`.
        gaze: FilterKind = FilterKind::Kalman, (), "";
        /// Time of this filter.
        gaze_ms: u32 = 200, 0..=350, " (ms)";
        /// Filter of the brows.
        brows: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time of this filter.
        brows_ms: u32 = 350, 0..=350, " (ms)";
        /// Filter of the mouth.
        mouth: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time of this filter.
        mouth_ms: u32 = 350, 0..=350, " (ms)";
        /// Filter of the jaw.
        jaw: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time of this filter.
        jaw_ms: u32 = 220, 0..=350, " (ms)";
        /// Filter of cheeks and nose.
        cheeks: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time of this filter.
        cheeks_ms: u32 = 350, 0..=350, " (ms)";
        /// Filter of the rotation and position of the head.
        head: FilterKind = FilterKind::GatedAverage, (), "";
        /// Time of this filter.
        head_ms: u32 = 350, 0..=350, " (ms)";
    }
}

impl SmoothingSettings {
    /// The filter of a group of coefficients and its time in milliseconds.
    #[must_use]
    pub fn of(&self, group: Group) -> (FilterKind, u32) {
        match group {
            Group::Lids => (self.lids, self.lids_ms),
            Group::Gaze => (self.gaze, self.gaze_ms),
            Group::Brows => (self.brows, self.brows_ms),
            Group::Mouth => (self.mouth, self.mouth_ms),
            Group::Jaw => (self.jaw, self.jaw_ms),
            Group::Cheeks => (self.cheeks, self.cheeks_ms),
        }
    }
}

section! {
    /// Rules of anatomy that the coefficients obey.
    PlausibilitySettings {
        /// A blink closes both lids alike, and a wink leaves the other eye open.
        lids: bool = true, (), "";
        /// In a blink, the eye keeps its direction, which the camera cannot see then.
        gaze: bool = true, (), "";
        /// Movements in opposite directions, such as jawLeft and jawRight, are not shown together.
        opposed: bool = true, (), "";
        /// mouthClose is at most jawOpen.
        mouth_close: bool = true, (), "";
        /// Coefficients up to this value are sent as 0, so that a face at rest does not tremble. Those above three times
        /// this value are unchanged. The dead zone does not apply to eyeLook.
        dead_zone: f32 = 0.02, 0.0..=0.2, "";
    }
}

impl PlausibilitySettings {
    /// The rules that these settings turn on.
    #[must_use]
    pub fn rules(&self) -> Rules {
        let Self { lids, gaze, opposed, mouth_close, dead_zone } = *self;
        Rules { mouth_close, opposed, lids, gaze, dead_zone }
    }
}
