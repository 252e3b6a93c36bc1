//! The built-in clip as a camera: repeated in real time, with timestamps of the monotonic clock, skipping frames for a reader
//! that is late. A script adds faults, so that operators can rehearse how links and receivers behave then.
//!
//! The clock of a rehearsal starts when the process first opens one, and keeps running while the camera is closed. What
//! happens depends on the script and on this clock alone. `live 5, gone 2` plays for 5 s, is unplugged for 2 s, and
//! repeats this. `random 7` plays parts of 2 s, of which every other one begins with a fault of random kind and length; the
//! number seeds the generator.

use std::mem::take;
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::{Duration, Instant};

use facewire_face::{Picture, Pixels};

use super::delivery::{Arrival, DeliveryCounter};
use super::{CaptureError, Clip, Content, Delivery, Description, Frame, FrameFault, FrameRate, Source, Tally};
use crate::clock::monotonic_us;
use crate::config::{Scene, Script};
use facewire_board::Impairment;

/// Largest number of frames that are skipped at once, so that a process that was stopped for hours continues soon.
const MAX_SKIPPED: u32 = 300;
const RANDOM_SCENE_US: u64 = 2_000_000;
const SHORTEST_FAULT_US: u64 = 100_000;
const GREY: u8 = 128;
/// In the dark, the clip's luma is divided by this. Luma is gamma-coded, so about one 150th of the light is left.
const DARKNESS: u8 = 10;
/// So many of the clip's 640 columns are outside of a cut-off picture, on its left. They hold a quarter of the face.
const CUT_OFF: usize = 270;
/// At half rate every other frame is delivered, and with losses all but every eighth.
const HALF_RATE: u64 = 2;
const LOSSY: u64 = 8;

pub(super) struct Rehearsal {
    clip: Clip,
    /// `None` plays the clip without faults.
    script: Option<Script>,
    /// Grey picture for the scenes that change the clip's pictures.
    canvas: Vec<u8>,
    sent: Sent,
    timeout: Duration,
    /// Whether half the width and height were asked for. The pictures keep their size: only their decoding is faster.
    is_small: bool,
    begun_us: u64,
    /// Time at which the next frame is due. The first call sets it.
    due_us: Option<u64>,
    /// Frames that are due earlier are left out.
    wanted_us: u64,
    tally: Tally,
}

impl Rehearsal {
    /// Opens the camera, for pictures of `width`. A silent camera has stalled after `timeout`.
    pub(super) fn open(script: Option<Script>, width: u32, timeout: Duration) -> Result<Self, CaptureError> {
        static BEGUN_US: OnceLock<u64> = OnceLock::new();
        let begun_us = *BEGUN_US.get_or_init(monotonic_us);
        let clip = Clip::looped()?;
        let sent = Sent::new(clip.frame_period_us().unwrap_or(FrameRate::FPS_30.period_us()));
        let Description { width: full, height, .. } = clip.describe();
        let is_small = 2 * width as usize <= full;
        let tally = Tally::default();
        // The clip without faults needs no picture of its own.
        let canvas = script.as_ref().map_or_else(Vec::new, |_| vec![GREY; full * height]);
        let due_us = None;
        let wanted_us = 0;
        let camera = Self { clip, script, canvas, sent, timeout, is_small, begun_us, due_us, wanted_us, tally };
        if camera.now().0 == Scene::Gone {
            let reason = "no camera is called rehearsal; its script has unplugged it for now";
            return Err(CaptureError::Absent(reason.to_owned()));
        }
        Ok(camera)
    }

    fn now(&self) -> (Scene, Duration) {
        let elapsed_us = monotonic_us().saturating_sub(self.begun_us);
        let (scene, left_us) = self.script.as_ref().map_or((Scene::Live, 0), |script| scene_at(script, elapsed_us));
        (scene, Duration::from_micros(left_us))
    }

    /// Skips the frames for which the reader is too late, and waits for the next one. Returns the time at which it is due.
    fn pace(&mut self) -> Result<u64, CaptureError> {
        let now_us = monotonic_us();
        let period_us = self.sent.period_us;
        let due_us = self.due_us.unwrap_or(now_us);
        let [for_newer, left_out] = frames_skipped(now_us, due_us, self.wanted_us, period_us);
        let count = for_newer.saturating_add(left_out);
        let captured_us = due_us + u64::from(count) * period_us;
        self.due_us = Some(captured_us + period_us);
        self.tally.for_newer = self.tally.for_newer.saturating_add(for_newer);
        self.tally.left_out = self.tally.left_out.saturating_add(left_out);
        for _ in 0..count.min(MAX_SKIPPED) {
            self.clip.skip()?;
        }
        sleep(Duration::from_micros(captured_us.saturating_sub(now_us)));
        Ok(captured_us)
    }

    /// Returns the time, in frame periods, by which the scene lengthens the decoding of a frame.
    fn added_periods(&self, scene: Scene) -> f64 {
        match scene {
            Scene::Slow2 => 2.0,
            Scene::Slow4 => 4.0,
            Scene::Slow8 => 8.0,
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
            Scene::Silent if left >= self.timeout => {
                sleep(self.timeout);
                return Err(CaptureError::stalled(self.timeout));
            }
            Scene::Silent | Scene::Hung => sleep(left),
            Scene::Gone => return Err(CaptureError::Gone),
            _ => {}
        }
        let mut captured_us = self.pace()?;
        if Sent::sequence(scene, self.sent.next).is_none() {
            self.clip.skip()?;
            captured_us = self.pace()?;
        }
        let added = Duration::from_micros(self.sent.period_us).mul_f64(self.added_periods(scene));
        let begun = Instant::now();
        let Some(frame) = self.clip.next()? else { return Ok(None) };
        self.tally.decoding += begun.elapsed() + added;
        let frame = Frame { captured_us, ..frame };
        if scene == Scene::Damaged {
            return Err(CaptureError::Frame { number: frame.number, fault: FrameFault::Corrupt });
        }
        self.sent.count(scene, frame.number, captured_us);
        sleep(added);
        let Some(picture) = frame.picture() else { return Ok(Some(frame)) };
        let Pixels::Planar { planes: [luma, ..], .. } = picture.pixels() else { return Ok(Some(frame)) };
        let [width, height] = [picture.width(), picture.height()];
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
        self.wanted_us = captured_us;
    }

    fn take_delivery(&mut self) -> Option<Delivery> {
        self.script.as_ref().and_then(|_| self.sent.delivery.take())
    }

    fn take_tally(&mut self) -> Tally {
        let scene = self.now().0;
        let mut tally = take(&mut self.tally);
        tally.rehearsed.set(Impairment::Hot, scene == Scene::Hot);
        tally.rehearsed.set(Impairment::Undervoltage, scene == Scene::Undervoltage);
        tally
    }

    fn has_smaller_mode(&self) -> bool {
        self.now().0 == Scene::SlowJpeg && !self.is_small
    }

    fn describe(&self) -> Description<'_> {
        let clip = self.clip.describe();
        Description { origin: if self.script.is_some() { "rehearsal" } else { clip.origin }, ..clip }
    }
}

/// Counts the frames to skip, of which the first is due at `due_us`: those from `wanted_us` on that are older than the
/// newest one, and those before `wanted_us`.
fn frames_skipped(now_us: u64, due_us: u64, wanted_us: u64, period_us: u64) -> [u32; 2] {
    let count = |periods: u64| u32::try_from(periods).unwrap_or(u32::MAX);
    let left_out = count(wanted_us.saturating_sub(due_us).div_ceil(period_us));
    let older = count(now_us.saturating_sub(due_us) / period_us);
    [older.saturating_sub(left_out), left_out]
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
    let number = elapsed_us / RANDOM_SCENE_US;
    let begun_us = elapsed_us % RANDOM_SCENE_US;
    let mut random = fastrand::Rng::with_seed(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number);
    let fault = random.choice(Scene::RANDOM).unwrap_or(Scene::Live);
    let fault_us = random.u64(SHORTEST_FAULT_US..RANDOM_SCENE_US);
    if number.is_multiple_of(2) && begun_us < fault_us {
        (fault, fault_us - begun_us)
    } else {
        (Scene::Live, RANDOM_SCENE_US - begun_us)
    }
}

/// Which frames of the clip the camera has sent.
struct Sent {
    period_us: u64,
    /// Number of the first frame of the clip that was not counted yet.
    next: u64,
    delivery: DeliveryCounter,
}

impl Sent {
    fn new(period_us: u64) -> Self {
        Self { period_us, next: 0, delivery: DeliveryCounter::new(period_us) }
    }

    /// The camera's own number of a frame of the clip; `None` if the frame does not arrive.
    fn sequence(scene: Scene, number: u64) -> Option<u64> {
        match scene {
            Scene::HalfRate => number.is_multiple_of(HALF_RATE).then_some(number / HALF_RATE),
            Scene::Lossy => (!number.is_multiple_of(LOSSY)).then_some(number),
            _ => Some(number),
        }
    }

    /// Counts a frame of the clip, and those before it for which the reader was too late: a driver delivers them all.
    fn count(&mut self, scene: Scene, number: u64, captured_us: u64) {
        for earlier in self.next..=number {
            let captured_us = captured_us.saturating_sub((number - earlier) * self.period_us);
            if let Some(sequence) = Self::sequence(scene, earlier) {
                self.delivery.arrived(Arrival { sequence: sequence as u32, captured_us, taken_us: captured_us });
            }
        }
        self.next = number + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn play(scene: &str, width: u32) -> Result<Rehearsal, CaptureError> {
        let script = Script::of(&format!("rehearsal: {scene} 60")).unwrap().unwrap();
        Rehearsal::open(Some(script), width, Duration::from_millis(1))
    }

    #[test]
    fn scenes_follow_each_other_and_repeat_and_random_ones_have_every_fault_and_depend_on_their_seed() {
        let script = Script::Scenes(vec![(Scene::Live, 5 * S), (Scene::Gone, 5 * S / 2), (Scene::NoFace, S)]);
        let want = [(Scene::Live, 5 * S), (Scene::Live, 1), (Scene::Gone, 5 * S / 2), (Scene::NoFace, S / 2)];
        for period_us in [0, 17 * S / 2] {
            assert_eq!([0, 5 * S - 1, 5 * S, 8 * S].map(|elapsed_us| scene_at(&script, period_us + elapsed_us)), want);
        }
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
        let added = Duration::from_micros(4 * 33_333);
        assert!(Duration::from_micros(monotonic_us() - captured_us) >= added);
        assert!(slow.take_tally().decoding >= added && slow.take_tally().decoding.is_zero());
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
        let Pixels::Grey { data, .. } = faceless.next().unwrap().unwrap().picture().unwrap().pixels() else { panic!() };
        assert!(data.iter().all(|luma| *luma == GREY));
        let rehearsed = |scene| play(scene, 640).unwrap().take_tally().rehearsed.to_string();
        assert_eq!(["slow-4", "live", "hot", "undervoltage"].map(rehearsed), ["none", "none", "hot", "undervoltage"]);
    }

    #[test]
    fn a_camera_at_half_rate_loses_nothing_and_a_lossy_one_keeps_its_rate() {
        let table = [(Scene::Live, 30.0, 0, false), (Scene::HalfRate, 15.0, 0, false), (Scene::Lossy, 30.0, 5, true)];
        for (scene, fps, lost, withholds_next) in table {
            let mut sent = Sent::new(33_333);
            // The reader takes every third frame.
            (2..48).step_by(3).for_each(|number| sent.count(scene, number, number * 33_333));
            let delivery = sent.delivery.take().unwrap();
            assert_eq!((delivery.fps().round(), delivery.lost), (fps, lost), "{scene:?}");
            assert_eq!(Sent::sequence(scene, sent.next).is_none(), withholds_next, "{scene:?}");
        }
    }

    #[test]
    fn a_late_reader_gets_the_newest_frame_that_is_due() {
        for (now_us, wanted_us, skipped, what) in [
            (109, 0, [0, 0], "still the newest"),
            (110, 0, [1, 0], "late"),
            (135, 0, [3, 0], "later"),
            (99, 125, [0, 3], "the frame that is due at 130 is the first wanted one"),
            (155, 125, [2, 3], "of the wanted ones the newest"),
            (u64::MAX, 0, [u32::MAX, 0], "no overflow"),
        ] {
            assert_eq!(frames_skipped(now_us, 100, wanted_us, 10), skipped, "{what}");
        }
    }

    #[test]
    fn frames_carry_the_monotonic_time_at_which_they_were_due_and_skipped_ones_are_counted() {
        const PERIOD_US: u64 = 33_333;
        for (wanted_periods, late_periods) in [(0, 0), (2, 0), (0, 5)] {
            let mut camera = Rehearsal::open(None, 640, Duration::ZERO).unwrap();
            let mut first_us = camera.next().unwrap().unwrap().captured_us;
            if late_periods > 0 {
                first_us = monotonic_us() - (late_periods + 1) * PERIOD_US;
                camera.due_us = Some(first_us + PERIOD_US);
            }
            camera.leave_out_until(first_us + wanted_periods * PERIOD_US);
            let (captured_us, number) = camera.next().unwrap().map(|frame| (frame.captured_us, frame.number)).unwrap();
            let Tally { for_newer, left_out, .. } = camera.take_tally();
            let periods = u64::from(for_newer + left_out) + 1;
            assert_eq!((captured_us, number), (first_us + periods * PERIOD_US, periods));
            assert!(captured_us <= monotonic_us() && u64::from(for_newer) >= late_periods);
            assert_eq!(u64::from(left_out), wanted_periods.saturating_sub(1));
            assert_eq!(camera.take_tally(), Tally::default());
        }
    }
}
