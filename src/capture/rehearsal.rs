//! The built-in clip as a camera with faults, so that operators can rehearse how links and receivers behave then.
//!
//! The clock of a rehearsal starts when the process first opens one, and keeps running while the camera is closed. What
//! happens depends on the script and on this clock alone. `live 5, gone 2` plays for 5 s, is unplugged for 2 s, and
//! repeats this. `random 7` has a fault of random kind and length in every other 2 s; the number seeds the generator.

mod script;
mod stage;

use std::mem::take;
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::Duration;

use self::stage::{Stage, Tally};
use super::{CaptureError, Clip, Delivery, Description, Frame, FrameFault, Skipped, Source, monotonic_us};
use crate::config::{Scene, Script};
use crate::impairment::{Impairment, ImpairmentSet};

/// The camera of a rehearsal.
#[derive(Debug)]
pub struct Rehearsal {
    script: Script,
    stage: Stage,
    tally: Tally,
    timeout: Duration,
    /// Whether half the width and height were asked for. The pictures keep their size: only their decoding is faster.
    is_small: bool,
    begun_us: u64,
    /// Time that slow scenes have added to the decoding.
    slowness: Duration,
}

impl Rehearsal {
    /// Opens the camera of a rehearsal, for pictures of `width`. A silent camera has stalled after `timeout`.
    ///
    /// # Errors
    /// [`CaptureError::NotFound`] while the camera is unplugged, [`CaptureError::Decoder`] without memory.
    pub fn open(script: Script, width: u32, timeout: Duration) -> Result<Self, CaptureError> {
        static BEGUN_US: OnceLock<u64> = OnceLock::new();
        let begun_us = *BEGUN_US.get_or_init(monotonic_us);
        let film = Clip::looped()?;
        let tally = Tally::new(film.frame_period_us().unwrap_or(0));
        let is_small = usize::try_from(width).is_ok_and(|width| 2 * width <= film.describe().width);
        let (stage, slowness) = (Stage::new(film), Duration::ZERO);
        let rehearsal = Self { script, stage, tally, timeout, is_small, begun_us, slowness };
        match rehearsal.now() {
            (Scene::Gone, _) => Err(gone()),
            _ => Ok(rehearsal),
        }
    }

    fn now(&self) -> (Scene, Duration) {
        let (scene, left_us) = self.script.at(monotonic_us().saturating_sub(self.begun_us));
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
        let added = Duration::from_micros(self.tally.period_us).mul_f64(self.added_periods(scene));
        let frame = self.stage.play(scene)?;
        if let Some(frame) = &frame {
            self.tally.count(scene, frame.number, frame.captured_us);
        }
        self.slowness += added;
        sleep(added);
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

    fn has_smaller_mode(&self) -> bool {
        self.now().0 == Scene::SlowJpeg && !self.is_small
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.stage.film.frame_period_us()
    }

    fn describe(&self) -> Description<'_> {
        Description { origin: "rehearsal", ..self.stage.film.describe() }
    }
}

fn gone() -> CaptureError {
    CaptureError::NotFound { wanted: "rehearsal".to_owned(), hint: "its script has unplugged it for now".to_owned() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::Pixels;
    use super::*;

    fn script(device: &str) -> Script {
        Script::of(device).unwrap().unwrap()
    }

    #[test]
    fn a_slow_board_takes_its_time_to_decode_and_a_hot_one_says_so() {
        let play = |scene: &str| {
            let script = script(&format!("rehearsal: {scene} 60"));
            Rehearsal::open(script, 640, Duration::from_millis(1)).unwrap()
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
    fn small_pictures_take_a_fourth_of_the_time_to_decode_where_decoding_is_slow() {
        let play = |scene: &str, width| {
            Rehearsal::open(script(&format!("rehearsal: {scene} 60")), width, Duration::from_millis(1)).unwrap()
        };
        let (full, small) = (play("slow-jpeg", 640), play("slow-jpeg", 320));
        let [full_periods, small_periods] = [&full, &small].map(|camera| camera.added_periods(Scene::SlowJpeg));
        assert!((full_periods - 4.0 * small_periods).abs() < 1e-9);
        assert!(full.has_smaller_mode() && !small.has_smaller_mode() && !play("slow-4", 640).has_smaller_mode());
    }

    #[test]
    fn each_fault_looks_like_that_of_a_camera() {
        let play = |scene: &str| {
            let script = script(&format!("rehearsal: {scene} 60"));
            Rehearsal::open(script, 640, Duration::from_millis(1))
        };
        assert!(matches!(play("gone"), Err(CaptureError::NotFound { .. })));
        assert!(matches!(play("silent").unwrap().next(), Err(CaptureError::Stalled { waited_ms: 1 })));
        assert!(matches!(play("damaged").unwrap().next(), Err(CaptureError::Frame { number: 0, .. })));
        let mut faceless = play("no-face").unwrap();
        let frame = faceless.next().unwrap().unwrap();
        assert!(
            matches!(frame.picture().unwrap().pixels, Pixels::Grey { data, .. } if data.iter().all(|luma| *luma == 128))
        );
    }
}
