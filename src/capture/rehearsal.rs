//! The built-in clip as a camera with faults, so that operators can rehearse how links and receivers behave then.
//!
//! The clock of a rehearsal starts when the process first opens one, and keeps running while the camera is closed. What
//! happens depends on the script and on this clock alone. `live 5, gone 2` plays for 5 s, is unplugged for 2 s, and
//! repeats this. `random 7` has a fault of random kind and length in every other 2 s; the number seeds the generator.

use std::mem::take;
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::Duration;

use super::{
    CaptureError, Clip, Content, Description, Frame, FrameFault, Paced, Picture, Pixels, Skipped, Source, monotonic_us,
};
use crate::config::{Scene, Script};
use crate::impairment::{Impairment, ImpairmentSet};

/// Length of a random scene, and of the live scene after it.
const RANDOM_SCENE_US: u64 = 2_000_000;
/// Shortest random fault.
const SHORTEST_FAULT_US: u64 = 100_000;
/// Luma of the picture without a face.
const GREY: u8 = 128;

impl Script {
    /// Returns the scene at a time since the start, and how long it lasts from then on, both in microseconds.
    fn at(&self, elapsed_us: u64) -> (Scene, u64) {
        match self {
            Self::Scenes(scenes) => at(scenes, elapsed_us),
            Self::Random(seed) => random_at(*seed, elapsed_us),
        }
    }
}

fn at(scenes: &[(Scene, u64)], elapsed_us: u64) -> (Scene, u64) {
    let total_us: u64 = scenes.iter().map(|(_, length_us)| length_us).sum();
    let mut left_us = elapsed_us.checked_rem(total_us).unwrap_or(0);
    for (scene, length_us) in scenes {
        if left_us < *length_us {
            return (*scene, length_us - left_us);
        }
        left_us -= length_us;
    }
    (Scene::Live, 0)
}

/// Odd scenes are live. Even scenes begin with a fault, and are live afterwards.
fn random_at(seed: u64, elapsed_us: u64) -> (Scene, u64) {
    let (number, begun_us) = (elapsed_us / RANDOM_SCENE_US, elapsed_us % RANDOM_SCENE_US);
    let mut random = fastrand::Rng::with_seed(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number);
    let fault = random.choice(Scene::RANDOM).unwrap_or(Scene::Live);
    let fault_us = random.u64(SHORTEST_FAULT_US..RANDOM_SCENE_US);
    if number % 2 == 0 && begun_us < fault_us {
        (fault, fault_us - begun_us)
    } else {
        (Scene::Live, RANDOM_SCENE_US - begun_us)
    }
}

/// The camera of a rehearsal.
#[derive(Debug)]
pub struct Rehearsal {
    script: Script,
    film: Paced<Clip>,
    grey: Vec<u8>,
    timeout: Duration,
    begun_us: u64,
    /// Time that slow scenes have added to the decoding.
    slowness: Duration,
}

impl Rehearsal {
    /// Opens the camera of a rehearsal. A silent camera has stalled after `timeout`.
    ///
    /// # Errors
    /// [`CaptureError::NotFound`] while the camera is unplugged, [`CaptureError::Decoder`] without memory.
    pub fn open(script: Script, timeout: Duration) -> Result<Self, CaptureError> {
        static BEGUN_US: OnceLock<u64> = OnceLock::new();
        let begun_us = *BEGUN_US.get_or_init(monotonic_us);
        let film = Clip::looped()?;
        let pixels = film.describe().width * film.describe().height;
        let (film, grey, slowness) = (Paced::new(film), vec![GREY; pixels], Duration::ZERO);
        let rehearsal = Self { script, film, grey, timeout, begun_us, slowness };
        match rehearsal.now() {
            (Scene::Gone, _) => Err(gone()),
            _ => Ok(rehearsal),
        }
    }

    fn now(&self) -> (Scene, Duration) {
        let (scene, left_us) = self.script.at(monotonic_us().saturating_sub(self.begun_us));
        (scene, Duration::from_micros(left_us))
    }

    fn faceless(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let Some(frame) = self.film.next()? else { return Ok(None) };
        let Some(&Picture { width, height, .. }) = frame.picture() else { return Ok(None) };
        let pixels = Pixels::Grey { data: &self.grey, stride: width };
        let picture = Picture::new(width, height, pixels, true);
        Ok(picture.map(|picture| Frame { content: Content::Picture(picture), ..frame }))
    }

    /// The next frame, after a decoding that takes this many frame periods longer.
    fn slow(&mut self, periods: u32) -> Result<Option<Frame<'_>>, CaptureError> {
        let added = Duration::from_micros(self.film.frame_period_us().unwrap_or(0)) * periods;
        self.slowness += added;
        let frame = self.film.next();
        sleep(added);
        frame
    }

    fn damaged(&mut self) -> CaptureError {
        match self.film.next() {
            Ok(Some(frame)) => CaptureError::Frame { number: frame.number, fault: FrameFault::Corrupt },
            Ok(None) => CaptureError::Gone,
            Err(error) => error,
        }
    }
}

impl Source for Rehearsal {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        match self.now() {
            (Scene::Live | Scene::Hot | Scene::Undervoltage, _) => self.film.next(),
            (Scene::Slow(periods), _) => self.slow(periods),
            (Scene::NoFace, _) => self.faceless(),
            (Scene::Damaged, _) => Err(self.damaged()),
            (Scene::Silent, left) if left >= self.timeout => {
                sleep(self.timeout);
                Err(CaptureError::Stalled { waited_ms: u64::try_from(self.timeout.as_millis()).unwrap_or(u64::MAX) })
            }
            (Scene::Silent | Scene::Hung, left) => {
                sleep(left);
                self.film.next()
            }
            (Scene::Gone, _) => Err(CaptureError::Gone),
        }
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.film.leave_out_until(captured_us);
    }

    fn take_skipped(&mut self) -> Skipped {
        self.film.take_skipped()
    }

    fn take_decoding(&mut self) -> Duration {
        self.film.take_decoding() + take(&mut self.slowness)
    }

    fn rehearsed(&self) -> ImpairmentSet {
        let mut rehearsed = ImpairmentSet::default();
        let (scene, _) = self.now();
        rehearsed.set(Impairment::Hot, scene == Scene::Hot);
        rehearsed.set(Impairment::Undervoltage, scene == Scene::Undervoltage);
        rehearsed
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.film.frame_period_us()
    }

    fn describe(&self) -> Description<'_> {
        Description { origin: "rehearsal", ..self.film.describe() }
    }
}

fn gone() -> CaptureError {
    CaptureError::NotFound { wanted: "rehearsal".to_owned(), hint: "its script has unplugged it for now".to_owned() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn script(device: &str) -> Script {
        Script::of(device).unwrap().unwrap()
    }

    #[test]
    fn scenes_follow_each_other_and_repeat() {
        let script = script("rehearsal: live 5, gone 2.5,no-face 1");
        assert_eq!(script.at(0), (Scene::Live, 5 * S));
        assert_eq!(script.at(5 * S - 1), (Scene::Live, 1));
        assert_eq!(script.at(5 * S), (Scene::Gone, 5 * S / 2));
        assert_eq!(script.at(8 * S), (Scene::NoFace, S / 2));
        assert_eq!(script.at(17 * S / 2), (Scene::Live, 5 * S));
    }

    #[test]
    fn a_random_rehearsal_has_every_scene_and_depends_on_its_seed() {
        let scenes = |seed| -> Vec<Scene> {
            let script = script(&format!("rehearsal: random {seed}"));
            (0..200).map(|number| script.at(number * RANDOM_SCENE_US).0).collect()
        };
        for (name, scene) in Scene::ALL {
            assert_eq!(scenes(7).contains(&scene), Scene::RANDOM.contains(&scene), "{name}");
        }
        assert_eq!(scenes(7), scenes(7));
        assert_ne!(scenes(7), scenes(8));
        assert!(scenes(7).into_iter().skip(1).step_by(2).all(|scene| scene == Scene::Live));
    }

    #[test]
    fn a_slow_board_takes_its_time_to_decode_and_a_hot_one_says_so() {
        let play = |scene: &str| {
            let script = script(&format!("rehearsal: {scene} 60"));
            Rehearsal::open(script, Duration::from_millis(1)).unwrap()
        };
        let mut slow = play("slow-4");
        let captured_us = slow.next().unwrap().unwrap().captured_us;
        assert!(monotonic_us() - captured_us >= 4 * 33_333);
        assert!(slow.take_decoding() >= Duration::from_micros(4 * 33_333));
        assert!(slow.take_decoding().is_zero());
        let rehearsed = ["slow-4", "live", "hot", "undervoltage"].map(|scene| play(scene).rehearsed().to_string());
        assert_eq!(rehearsed, ["none", "none", "hot", "undervoltage"]);
    }

    #[test]
    fn each_fault_looks_like_that_of_a_camera() {
        let play = |scene: &str| {
            let script = script(&format!("rehearsal: {scene} 60"));
            Rehearsal::open(script, Duration::from_millis(1))
        };
        assert!(matches!(play("gone"), Err(CaptureError::NotFound { .. })));
        assert!(matches!(play("silent").unwrap().next(), Err(CaptureError::Stalled { waited_ms: 1 })));
        assert!(matches!(play("damaged").unwrap().next(), Err(CaptureError::Frame { number: 0, .. })));
        let mut faceless = play("no-face").unwrap();
        let frame = faceless.next().unwrap().unwrap();
        assert!(
            matches!(frame.picture().unwrap().pixels, Pixels::Grey { data, .. } if data.iter().all(|luma| *luma == GREY))
        );
    }
}
