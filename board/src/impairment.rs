//! What makes tracking poor although every part works, and what the operator can do about it.
//!
//! Detectors set an impairment in [`Impairments`], and clear it when it has passed. They apply hysteresis.

use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

/// Declares the impairments: the name in the status line and in the metrics, and a sentence with the remedy.
macro_rules! impairments {
    ($( $(#[doc = $doc:literal])* $variant:ident = $name:literal, $sentence:literal; )*) => {
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Impairment {
            $( $(#[doc = $doc])* $variant, )*
        }

        impl Impairment {
            pub const ALL: [Self; [$( $name ),*].len()] = [$( Self::$variant ),*];

            fn bit(self) -> u32 {
                1 << self as u32
            }

            pub fn name(self) -> &'static str {
                match self {
                    $( Self::$variant => $name, )*
                }
            }

            pub fn sentence(self) -> &'static str {
                match self {
                    $( Self::$variant => $sentence, )*
                }
            }
        }
    };
}

impairments! {
    Black = "black",
        "the picture is black: open the shutter of the camera, take the cap off its lens, or switch on a light";
    /// Also a picture that is noisy because the camera amplifies little light.
    Dark = "dark", "the picture is dark or noisy: light the face from the front";
    Backlight = "backlight",
        "the face is much darker than what is behind it: turn away from the window, or light the face from the front";
    SmallFace = "small-face",
        "the face is small in the picture: move closer to the camera, or choose a larger picture";
    CutOffFace = "cut-off-face",
        "a part of the face is outside the picture: turn the camera, or move back";
    DoubtfulFace = "doubtful-face",
        "the face is hardly recognised or lies on its side: uncover it and look at the camera; if the camera is mounted on its \
         side or upside down, set camera.rotation, which `facewire check` proposes";
    TurnedAway = "turned-away",
        "the face is turned away: look towards the camera, or place the camera where the wearer looks";
    HalvedRate = "halved-rate",
        "the camera delivers about half its frame rate or less, as many do to expose longer: add light, or keep the rate with \
         `v4l2-ctl -d /dev/videoN --set-ctrl=exposure_dynamic_framerate=0` (older kernels call it exposure_auto_priority)";
    MissingFrames = "missing-frames",
        "frames get lost or damaged between camera and board: give the camera a USB port of its own instead of a hub, use a \
         short cable, set camera.format = \"mjpeg\", or choose a smaller picture";
    /// That of a camera counts as none. That of a program may be a photo.
    FrozenPicture = "frozen-picture",
        "the picture does not change at all: open the shutter of the camera, add light, or unplug it and plug it in again; if a \
         program sends the picture, restart that program";
    Undervoltage = "undervoltage",
        "the supply voltage is too low, so that the board slows down: use a stronger power supply and a short cable";
    /// The board has reduced its clock rate, or is about to.
    Hot = "hot", "the board is so hot that it slows down: add a heat sink or a fan, or let air reach it";
    SlowGovernor = "slow-governor",
        "a processor saves power and so runs slower than it could: write \"performance\" or \"schedutil\" to \
         /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor";
}

/// A set of impairments. Displays as their names with commas between them, or as `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ImpairmentSet(u32);

impl ImpairmentSet {
    pub fn contains(self, impairment: Impairment) -> bool {
        self.0 & impairment.bit() != 0
    }

    /// Whether there is too little light on the face, for whatever reason.
    pub fn is_dark(self) -> bool {
        [Impairment::Black, Impairment::Dark, Impairment::Backlight].into_iter().any(|poor| self.contains(poor))
    }

    pub fn set(&mut self, impairment: Impairment, is_present: bool) {
        self.0 = if is_present { self.0 | impairment.bit() } else { self.0 & !impairment.bit() };
    }

    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub fn iter(self) -> impl Iterator<Item = Impairment> {
        Impairment::ALL.into_iter().filter(move |impairment| self.contains(*impairment))
    }
}

impl fmt::Display for ImpairmentSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = self.iter().map(Impairment::name).collect();
        f.write_str(if names.is_empty() { "none".to_owned() } else { names.join(",") }.as_str())
    }
}

/// The present impairments of a running service, and how often each has begun. Any thread may set one.
#[derive(Debug, Default)]
pub struct Impairments {
    present: AtomicU32,
    begun: [AtomicU64; Impairment::ALL.len()],
}

impl Impairments {
    pub fn set_all(&self, judged: impl IntoIterator<Item = Impairment>, present: ImpairmentSet) {
        judged.into_iter().for_each(|impairment| self.set(impairment, present.contains(impairment)));
    }

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

    pub fn present(&self) -> ImpairmentSet {
        ImpairmentSet(self.present.load(Relaxed))
    }

    pub fn begun(&self) -> impl Iterator<Item = (&'static str, u64)> {
        Impairment::ALL.into_iter().zip(&self.begun).map(|(impairment, begun)| (impairment.name(), begun.load(Relaxed)))
    }
}
