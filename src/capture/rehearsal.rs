//! The built-in clip as a camera with faults, so that operators can rehearse how links and receivers behave then.
//!
//! The clock of a rehearsal starts when the process first opens one, and keeps running while the camera is closed. What
//! happens depends on the script and on this clock alone. `live 5, gone 2` plays for 5 s, is unplugged for 2 s, and
//! repeats this. `random 7` has a fault of random kind and length in every other 2 s; the number seeds the generator.

use std::mem::take;
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::Duration;

use super::delivery::{Arrival, Delivery, DeliveryCounter};
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
/// Part of the clip's brightness in the dark: one 150th of its light.
const DARKNESS: u8 = 10;
/// Columns of the clip, of 640, that are outside the picture. They hold a quarter of the face.
const CUT_OFF: usize = 270;
/// At half rate every other frame is delivered, and with losses all but every eighth.
const HALF_RATE: u64 = 2;
const LOSSY: u64 = 8;

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
    stage: Stage,
    tally: Tally,
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
        let tally = Tally::new(film.frame_period_us().unwrap_or(0));
        let stage = Stage { film: Paced::new(film), canvas: vec![GREY; pixels] };
        let rehearsal = Self { script, stage, tally, timeout, begun_us, slowness: Duration::ZERO };
        match rehearsal.now() {
            (Scene::Gone, _) => Err(gone()),
            _ => Ok(rehearsal),
        }
    }

    fn now(&self) -> (Scene, Duration) {
        let (scene, left_us) = self.script.at(monotonic_us().saturating_sub(self.begun_us));
        (scene, Duration::from_micros(left_us))
    }

    fn damaged(&mut self) -> CaptureError {
        match self.stage.film.next() {
            Ok(Some(frame)) => CaptureError::Frame { number: frame.number, fault: FrameFault::Corrupt },
            Ok(None) => CaptureError::Gone,
            Err(error) => error,
        }
    }
}

impl Source for Rehearsal {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let (scene, left) = self.now();
        match scene {
            Scene::Damaged => return Err(self.damaged()),
            Scene::Silent if left >= self.timeout => {
                sleep(self.timeout);
                let waited_ms = u64::try_from(self.timeout.as_millis()).unwrap_or(u64::MAX);
                return Err(CaptureError::Stalled { waited_ms });
            }
            Scene::Silent | Scene::Hung => sleep(left),
            Scene::Gone => return Err(CaptureError::Gone),
            _ => {}
        }
        if self.tally.withholds_next(scene) {
            self.stage.film.next()?;
        }
        let frame = self.stage.play(scene)?;
        if let Some(frame) = &frame {
            self.tally.count(scene, frame.number, frame.captured_us);
        }
        if let Scene::Slow(periods) = scene {
            let added = Duration::from_micros(self.tally.period_us) * periods;
            self.slowness += added;
            sleep(added);
        }
        Ok(frame)
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.stage.film.leave_out_until(captured_us);
    }

    fn take_skipped(&mut self) -> Skipped {
        self.stage.film.take_skipped()
    }

    fn take_delivery(&mut self) -> Option<Delivery> {
        self.tally.delivery.take()
    }

    fn take_decoding(&mut self) -> Duration {
        self.stage.film.take_decoding() + take(&mut self.slowness)
    }

    fn rehearsed(&self) -> ImpairmentSet {
        let mut rehearsed = ImpairmentSet::default();
        let (scene, _) = self.now();
        rehearsed.set(Impairment::Hot, scene == Scene::Hot);
        rehearsed.set(Impairment::Undervoltage, scene == Scene::Undervoltage);
        rehearsed
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.stage.film.frame_period_us()
    }

    fn describe(&self) -> Description<'_> {
        Description { origin: "rehearsal", ..self.stage.film.describe() }
    }
}

/// The clip, and a canvas for pictures that are made of it.
#[derive(Debug)]
struct Stage {
    film: Paced<Clip>,
    canvas: Vec<u8>,
}

/// Makes a luma plane of the one of the clip, whose rows are `width` bytes apart.
type Paint = fn(luma: &[u8], width: usize, canvas: &mut [u8]);

impl Stage {
    fn play(&mut self, scene: Scene) -> Result<Option<Frame<'_>>, CaptureError> {
        match scene {
            Scene::NoFace => self.painted(|_, _, canvas| canvas.fill(GREY)),
            Scene::Dark => self.painted(darken),
            Scene::CutOff => self.painted(shift),
            _ => self.film.next(),
        }
    }

    fn painted(&mut self, paint: Paint) -> Result<Option<Frame<'_>>, CaptureError> {
        let Some(frame) = self.film.next()? else { return Ok(None) };
        let Some(&Picture { width, height, pixels, .. }) = frame.picture() else { return Ok(None) };
        if let Pixels::Planar { planes: [luma, ..], .. } = pixels {
            paint(luma, width, &mut self.canvas);
        }
        let pixels = Pixels::Grey { data: &self.canvas, stride: width };
        let picture = Picture::new(width, height, pixels, true);
        Ok(picture.map(|picture| Frame { content: Content::Picture(picture), ..frame }))
    }
}

fn darken(luma: &[u8], _: usize, canvas: &mut [u8]) {
    for (dark, luma) in canvas.iter_mut().zip(luma) {
        *dark = luma / DARKNESS;
    }
}

/// Moves the clip to the left.
fn shift(luma: &[u8], width: usize, canvas: &mut [u8]) {
    for (row, from) in canvas.chunks_exact_mut(width).zip(luma.chunks_exact(width)) {
        let kept = from.iter().skip(CUT_OFF).chain(std::iter::repeat(&GREY));
        row.iter_mut().zip(kept).for_each(|(pixel, luma)| *pixel = *luma);
    }
}

/// Which frames of the clip the camera has delivered.
#[derive(Debug)]
struct Tally {
    period_us: u64,
    /// Number of the last frame of the clip that was played.
    last: Option<u64>,
    delivery: DeliveryCounter,
}

impl Tally {
    fn new(period_us: u64) -> Self {
        Self { period_us, last: None, delivery: DeliveryCounter::new(period_us) }
    }

    /// The camera's own number of a frame of the clip, and whether the frame arrives.
    fn sequence(scene: Scene, number: u64) -> (u64, bool) {
        match scene {
            Scene::HalfRate => (number / HALF_RATE, number.is_multiple_of(HALF_RATE)),
            Scene::Lossy => (number, !number.is_multiple_of(LOSSY)),
            _ => (number, true),
        }
    }

    fn withholds_next(&self, scene: Scene) -> bool {
        !Self::sequence(scene, self.last.map_or(0, |last| last + 1)).1
    }

    /// Counts a frame of the clip, and those before it for which the reader was too late: a driver delivers them all.
    fn count(&mut self, scene: Scene, number: u64, captured_us: u64) {
        let first = self.last.replace(number).map_or(number, |last| (last + 1).min(number));
        for earlier in first..=number {
            let (sequence, arrives) = Self::sequence(scene, earlier);
            if arrives {
                let captured_us = captured_us.saturating_sub((number - earlier) * self.period_us);
                let sequence = u32::try_from(sequence).unwrap_or(0);
                self.delivery.arrived(Arrival { sequence, captured_us, taken_us: captured_us });
            }
        }
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
    fn a_random_rehearsal_has_every_fault_and_depends_on_its_seed() {
        let scenes = |seed| -> Vec<Scene> {
            let script = script(&format!("rehearsal: random {seed}"));
            (0..200).map(|number| script.at(number * RANDOM_SCENE_US).0).collect()
        };
        for scene in Scene::RANDOM {
            assert!(scenes(7).contains(&scene), "{scene:?}");
        }
        assert_eq!(scenes(7), scenes(7));
        assert_ne!(scenes(7), scenes(8));
        assert!(scenes(7).into_iter().skip(1).step_by(2).all(|scene| scene == Scene::Live));
    }

    /// What the camera of a scene delivers in the first window.
    fn delivered(scene: Scene) -> Delivery {
        let period_us = 33_333;
        let mut tally = Tally::new(period_us);
        let mut clip = 0..;
        loop {
            if tally.withholds_next(scene) {
                clip.next();
            }
            let number = clip.next().unwrap();
            tally.count(scene, number, number * period_us);
            if let Some(delivery) = tally.delivery.take() {
                return delivery;
            }
        }
    }

    #[test]
    fn a_camera_at_half_rate_loses_nothing_and_a_lossy_one_keeps_its_rate() {
        let seen = |scene| (delivered(scene).fps().round(), (delivered(scene).lost_share() * 100.0).round());
        assert_eq!(seen(Scene::Live), (30.0, 0.0));
        assert_eq!(seen(Scene::HalfRate), (15.0, 0.0));
        assert_eq!(seen(Scene::Lossy), (30.0, 11.0));
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
