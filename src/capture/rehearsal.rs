//! The built-in clip as a camera with faults, so that operators can rehearse how links and receivers behave then.
//!
//! The clock of a rehearsal starts when the process first opens one, and keeps running while the camera is closed. What
//! happens depends on the script and on this clock alone. `live 5, gone 2` plays for 5 s, is unplugged for 2 s, and
//! repeats this. `random 7` has a fault of random kind and length in every other 2 s; the number seeds the generator.

use std::mem::take;
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::Duration;

use facewire_face::{Picture, Pixels};

use super::clip::Paced;
use super::delivery::{Arrival, DeliveryCounter};
use super::{CaptureError, Clip, Content, Delivery, Description, Frame, FrameFault, Skipped, Source, monotonic_us};
use crate::config::{Scene, Script};
use crate::impairment::{Impairment, ImpairmentSet};

/// Length of a random scene, and of the live scene after it.
const RANDOM_SCENE_US: u64 = 2_000_000;
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

/// The camera of a rehearsal.
#[derive(Debug)]
pub(super) struct Rehearsal {
    script: Script,
    film: Paced,
    /// Memory for pictures that are made of those of the clip.
    canvas: Vec<u8>,
    sent: Sent,
    timeout: Duration,
    /// Whether half the width and height were asked for. The pictures keep their size: only their decoding is faster.
    is_small: bool,
    begun_us: u64,
    /// Time that slow scenes have added to the decoding.
    slowness: Duration,
}

impl Rehearsal {
    /// Opens the camera of a rehearsal, for pictures of `width`. A silent camera has stalled after `timeout`.
    pub(super) fn open(script: Script, width: u32, timeout: Duration) -> Result<Self, CaptureError> {
        static BEGUN_US: OnceLock<u64> = OnceLock::new();
        let begun_us = *BEGUN_US.get_or_init(monotonic_us);
        let film = Paced::new(Clip::looped()?);
        let sent = Sent::new(film.frame_period_us().unwrap_or(0));
        let Description { width: full, height, .. } = film.describe();
        let is_small = 2 * width as usize <= full;
        let (canvas, slowness) = (vec![GREY; full * height], Duration::ZERO);
        let rehearsal = Self { script, film, canvas, sent, timeout, is_small, begun_us, slowness };
        if rehearsal.now().0 == Scene::Gone {
            let reason = "no camera is called rehearsal; its script has unplugged it for now";
            return Err(CaptureError::Absent(reason.to_owned()));
        }
        Ok(rehearsal)
    }

    fn now(&self) -> (Scene, Duration) {
        let (scene, left_us) = scene_at(&self.script, monotonic_us().saturating_sub(self.begun_us));
        (scene, Duration::from_micros(left_us))
    }

    /// Returns how many frame periods a scene adds to the decoding of a frame.
    fn added_periods(&self, scene: Scene) -> f64 {
        match scene {
            Scene::Slow(periods) => periods.into(),
            Scene::SlowJpeg if self.is_small => 0.5,
            Scene::SlowJpeg => 2.0,
            _ => 0.0,
        }
    }
}

impl Source for Rehearsal {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let (scene, left) = self.now();
        match scene {
            Scene::Damaged => {
                let number = self.film.next()?.map_or(0, |frame| frame.number);
                return Err(CaptureError::Frame { number, fault: FrameFault::Corrupt });
            }
            Scene::Silent if left >= self.timeout => {
                sleep(self.timeout);
                return Err(CaptureError::stalled(self.timeout));
            }
            Scene::Silent | Scene::Hung => sleep(left),
            Scene::Gone => return Err(CaptureError::Gone),
            _ => {}
        }
        if self.sent.withholds_next(scene) {
            self.film.next()?;
        }
        let added = Duration::from_micros(self.sent.period_us).mul_f64(self.added_periods(scene));
        let Some(frame) = self.film.next()? else { return Ok(None) };
        self.sent.count(scene, frame.number, frame.captured_us);
        self.slowness += added;
        sleep(added);
        let Some(&Picture { width, height, pixels: Pixels::Planar { planes: [luma, ..], .. }, .. }) = frame.picture()
        else {
            return Ok(Some(frame));
        };
        match scene {
            Scene::NoFace => self.canvas.fill(GREY),
            Scene::Dark => self.canvas.iter_mut().zip(luma).for_each(|(dark, luma)| *dark = luma / DARKNESS),
            Scene::CutOff => {
                for (row, from) in self.canvas.chunks_exact_mut(width).zip(luma.chunks_exact(width)) {
                    let kept = from.iter().skip(CUT_OFF).chain(std::iter::repeat(&GREY));
                    row.iter_mut().zip(kept).for_each(|(pixel, luma)| *pixel = *luma);
                }
            }
            _ => return Ok(Some(frame)),
        }
        let picture = Picture::new(width, height, Pixels::Grey { data: &self.canvas, stride: width }, true);
        Ok(picture.map(|picture| Frame { content: Content::Picture(picture), ..frame }))
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.film.leave_out_until(captured_us);
    }

    fn take_skipped(&mut self) -> Skipped {
        self.film.take_skipped()
    }

    fn take_delivery(&mut self) -> Option<Delivery> {
        self.sent.delivery.take()
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

    fn has_smaller_mode(&self) -> bool {
        self.now().0 == Scene::SlowJpeg && !self.is_small
    }

    fn describe(&self) -> Description<'_> {
        Description { origin: "rehearsal", ..self.film.describe() }
    }
}

/// Returns the scene at a time since the start, and how long it lasts from then on, both in microseconds.
fn scene_at(script: &Script, elapsed_us: u64) -> (Scene, u64) {
    let scenes = match script {
        Script::Scenes(scenes) => scenes,
        Script::Random(seed) => return random_at(*seed, elapsed_us),
    };
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

/// Which frames of the clip the camera has sent.
#[derive(Debug)]
struct Sent {
    period_us: u64,
    /// Number of the last frame of the clip that was played.
    last: Option<u64>,
    delivery: DeliveryCounter,
}

impl Sent {
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

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn script(device: &str) -> Script {
        Script::of(device).unwrap().unwrap()
    }

    fn play(scene: &str, width: u32) -> Result<Rehearsal, CaptureError> {
        Rehearsal::open(script(&format!("rehearsal: {scene} 60")), width, Duration::from_millis(1))
    }

    #[test]
    fn scenes_follow_each_other_and_repeat() {
        let script = script("rehearsal: live 5, gone 2.5,no-face 1");
        let table = [
            (0, Scene::Live, 5 * S),
            (5 * S - 1, Scene::Live, 1),
            (5 * S, Scene::Gone, 5 * S / 2),
            (8 * S, Scene::NoFace, S / 2),
        ];
        for (elapsed_us, scene, left_us) in table {
            assert_eq!(scene_at(&script, elapsed_us), (scene, left_us));
            assert_eq!(scene_at(&script, elapsed_us + 17 * S / 2), (scene, left_us));
        }
    }

    #[test]
    fn a_random_rehearsal_has_every_fault_and_depends_on_its_seed() {
        let scenes = |seed| -> Vec<Scene> {
            (0..200).map(|number| scene_at(&Script::Random(seed), number * RANDOM_SCENE_US).0).collect()
        };
        assert!(Scene::RANDOM.iter().all(|scene| scenes(7).contains(scene)));
        assert!(scenes(7) == scenes(7) && scenes(7) != scenes(8));
        assert!(scenes(7).into_iter().skip(1).step_by(2).all(|scene| scene == Scene::Live));
    }

    #[test]
    fn a_slow_board_takes_its_time_to_decode_and_a_fourth_of_it_for_small_pictures() {
        let mut slow = play("slow-4", 640).unwrap();
        let captured_us = slow.next().unwrap().unwrap().captured_us;
        assert!(monotonic_us() - captured_us >= 4 * 33_333);
        assert!(slow.take_decoding() >= Duration::from_micros(4 * 33_333) && slow.take_decoding().is_zero());
        let [full, small] = [640, 320].map(|width| play("slow-jpeg", width).unwrap());
        let [full_periods, small_periods] = [&full, &small].map(|camera| camera.added_periods(Scene::SlowJpeg));
        assert!((full_periods - 4.0 * small_periods).abs() < 1e-9);
        assert_eq!([full, small, slow].map(|camera| camera.has_smaller_mode()), [true, false, false]);
    }

    #[test]
    fn each_fault_looks_like_that_of_a_camera() {
        assert!(matches!(play("gone", 640), Err(CaptureError::Absent(_))));
        let silent = play("silent", 640).unwrap().next().unwrap_err().to_string();
        assert!(silent.contains("sent nothing for 1 ms"), "{silent}");
        assert!(matches!(play("damaged", 640).unwrap().next(), Err(CaptureError::Frame { number: 0, .. })));
        let mut faceless = play("no-face", 640).unwrap();
        let Pixels::Grey { data, .. } = faceless.next().unwrap().unwrap().picture().unwrap().pixels else { panic!() };
        assert!(data.iter().all(|luma| *luma == GREY));
        let rehearsed = |scene| play(scene, 640).unwrap().rehearsed().to_string();
        assert_eq!(["slow-4", "live", "hot", "undervoltage"].map(rehearsed), ["none", "none", "hot", "undervoltage"]);
    }

    #[test]
    fn a_camera_at_half_rate_loses_nothing_and_a_lossy_one_keeps_its_rate() {
        for (scene, fps, lost_percent) in
            [(Scene::Live, 30.0, 0.0), (Scene::HalfRate, 15.0, 0.0), (Scene::Lossy, 30.0, 11.0)]
        {
            let (mut sent, mut clip) = (Sent::new(33_333), 0..);
            let delivery = loop {
                if sent.withholds_next(scene) {
                    clip.next();
                }
                let number = clip.next().unwrap();
                sent.count(scene, number, number * 33_333);
                if let Some(delivery) = sent.delivery.take() {
                    break delivery;
                }
            };
            assert_eq!((delivery.fps().round(), (delivery.lost_share() * 100.0).round()), (fps, lost_percent));
        }
    }
}
