//! The script of a rehearsal: a camera that plays the built-in clip with faults.
//!
//! `rehearsal: live 5, gone 2` plays for 5 s, is unplugged for 2 s, and starts over. `rehearsal: random 7` has random
//! faults, the same ones for each seed. This module only reads the script; `capture` plays it.

use super::value::{Choice as _, choices};

/// Longest scene of a script, seconds.
const LONGEST_SCENE_S: f64 = 86_400.0;

choices! {
    /// What the camera does for a while: it shows a grey picture, damaged, dark or cut-off pictures; delivers no frame
    /// (silent), neither a frame nor an error (hung) or every other frame, like a camera that exposes longer; loses every
    /// eighth frame; or plays the clip on a board that takes so many frame periods to decode a frame. A slow JPEG decoder
    /// takes two, and half of one for half the width and height.
    pub enum Scene: Live = "live", NoFace = "no-face", Damaged = "damaged", Silent = "silent", Hung = "hung",
    Gone = "gone", Dark = "dark", CutOff = "cut-off", HalfRate = "half-rate", Lossy = "lossy", Slow2 = "slow-2",
    Slow4 = "slow-4", Slow8 = "slow-8", SlowJpeg = "slow-jpeg", Hot = "hot", Undervoltage = "undervoltage"
}

impl Scene {
    /// The scenes of a random rehearsal: each tells by itself what receivers then see.
    pub const RANDOM: [Self; 6] = [Self::Live, Self::NoFace, Self::Damaged, Self::Silent, Self::Hung, Self::Gone];
}

/// A sequence of scenes that repeats for ever.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Script {
    /// Scenes and their lengths in microseconds.
    Scenes(Vec<(Scene, u64)>),
    /// Random faults from this seed.
    Random(u64),
}

/// A rehearsal whose script cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BadScript;

impl Script {
    /// Describes a valid script; the text follows "give".
    pub const EXPECTED: &'static str = "a rehearsal such as \"rehearsal: live 5, gone 2.5\" of the scenes live, no-face, \
         damaged, silent, hung, gone, dark, cut-off, half-rate, lossy, slow-2, slow-4, slow-8, slow-jpeg, hot and \
         undervoltage with their seconds, or \"rehearsal: random 7\"";

    /// Reads the script in the camera setting `device`. Returns `None` if the setting names no rehearsal.
    pub fn of(device: &str) -> Option<Result<Self, BadScript>> {
        device.strip_prefix("rehearsal:").map(|script| Self::parse(script).ok_or(BadScript))
    }

    fn parse(script: &str) -> Option<Self> {
        if let Some(seed) = script.trim().strip_prefix("random ") {
            return seed.trim().parse().ok().map(Self::Random);
        }
        let scene = |text: &str| {
            let (name, length) = text.trim().split_once(' ')?;
            let (_, scene) = Scene::ALL.iter().find(|(known, _)| *known == name)?;
            let length_s: f64 = length.trim().parse().ok()?;
            (0.001..=LONGEST_SCENE_S).contains(&length_s).then(|| (*scene, (length_s * 1e6).round() as u64))
        };
        script.split(',').map(scene).collect::<Option<_>>().map(Self::Scenes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_is_read_or_refused_and_another_camera_setting_is_none() {
        let scenes = vec![(Scene::Live, 5_000_000), (Scene::Gone, 2_500_000), (Scene::NoFace, 1_000_000)];
        assert_eq!(Script::of("rehearsal: live 5, gone 2.5,no-face 1"), Some(Ok(Script::Scenes(scenes))));
        assert_eq!(Script::of("rehearsal: random 7"), Some(Ok(Script::Random(7))));
        assert_eq!(Script::of("/dev/video0"), None);
        for bad in ["", "live", "live 0", "live -1", "live x", "live 3,", "nap 3", "random", "random x", "live 1e9"] {
            assert_eq!(Script::of(&format!("rehearsal:{bad}")), Some(Err(BadScript)), "{bad}");
        }
    }
}
