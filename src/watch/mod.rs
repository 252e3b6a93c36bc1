//! Decides from looks at the picture, and from what the camera delivers, what makes tracking poor. The service watches
//! while it runs, and `facewire check` for three seconds.
//!
//! Contract: [`Watch`] does not allocate. The thresholds of the
//! picture are where the coefficients become poor ("Where tracking becomes poor" in docs/faults.md has the figures).
//! Limits: noise that a camera smooths away is not seen. Motion blur is not measured.

mod look;
mod mount;

pub use look::{FaceLook, Light, Look};
pub use mount::MountTrial;

use facewire_face::Face;

use crate::capture::{Delivery, Frame, Source};
use crate::clock::monotonic_us;
use facewire_board::{Impairment, ImpairmentSet};

/// A pair of thresholds: where an impairment begins, and where it ends.
type Thresholds = [f32; 2];

/// Contrast divided by noise.
const CLARITY: Thresholds = [1.7, 2.3];
/// Contrast of a face, of 255 steps.
const CONTRAST: Thresholds = [5.0, 6.5];
/// From this ratio of the surroundings' brightness to that of an unclear face on, the light comes from behind.
const BACKLIGHT: f32 = 2.0;
/// Brightness of a picture without a face.
const BRIGHTNESS: Thresholds = [20.0, 30.0];
/// Least contrast that a picture without a face is taken to have: a plain wall has none, and is not dark for that reason.
const PLAIN: f32 = 10.0;
/// Brightness below which a picture without contrast is black.
const BLACK: f32 = 25.0;
/// Longer side of the face in pixels, and as a part of the longer side of the picture.
const SIZE_PX: Thresholds = [38.0, 48.0];
const SIZE: Thresholds = [0.12, 0.135];
/// Share of the face outside the picture.
const CUT_OFF: Thresholds = [0.08, 0.05];
/// The mesh network's score of a face, which is above for one in view, whatever covers its mouth.
const SCORE: Thresholds = [15.0, 17.0];
/// Angle between the eyes' line and the picture's rows, degrees.
const ROLL_DEG: Thresholds = [50.0, 40.0];
/// Frame rate divided by the rate that the camera states. Cameras that expose longer go from 30 to 15 frames a second or
/// less, and 25 a second is what light of 50 Hz asks for.
const RATE: Thresholds = [0.6, 0.75];
/// Share of the frames that are lost. Each of them makes the face stand still for a moment.
const LOST: Thresholds = [0.05, 0.02];
/// Number of impairments that are seen in the picture. The others are seen in what the camera delivers.
const OF_PICTURE: usize = 6;
/// Time from one look at the picture to the next, microseconds.
const LOOK_US: u64 = 250_000;
/// Longest time that one look stands for, microseconds. Looks at the clip come every 0.3 s, those at a slow camera and
/// at what it delivers every 1.5 s.
const MAX_STEP_US: u64 = 2_000_000;

/// What one look says about an impairment: how much the time since the last look counts for it, in quarters. Of two
/// verdicts on the same impairment the greater one holds.
type Verdict = i64;
const POOR: Verdict = 4;
/// The value lies between the thresholds.
const BETWEEN: Verdict = 0;
/// There is nothing to judge, for example no face.
const UNKNOWN: Verdict = -1;
const FINE: Verdict = -4;

/// Judges a value that is poor below the first threshold, and fine from the second on.
fn poor_if_low(value: f32, [poor, fine]: Thresholds) -> Verdict {
    match value {
        _ if value < poor => POOR,
        _ if value < fine => BETWEEN,
        _ => FINE,
    }
}

/// Judges a value that is poor above the first threshold, and fine up to the second.
fn poor_if_high(value: f32, thresholds: Thresholds) -> Verdict {
    poor_if_low(-value, thresholds.map(|threshold| -threshold))
}

/// An impairment over time. It begins when looks have said so for the time `hold_us` more than they have denied it, and
/// ends likewise, so that it does not come and go with every look.
#[derive(Debug, Clone, Copy, Default)]
struct Steady {
    evidence_us: u64,
    last_us: Option<u64>,
    is_present: bool,
}

impl Steady {
    fn update(&mut self, verdict: Verdict, now_us: u64, hold_us: u64) -> bool {
        let since_us = now_us.saturating_sub(self.last_us.replace(now_us).unwrap_or(now_us)).min(MAX_STEP_US);
        self.evidence_us = self.evidence_us.saturating_add_signed(verdict * since_us as i64 / 4).min(hold_us);
        self.is_present = self.evidence_us == hold_us || (self.is_present && self.evidence_us > 0);
        self.is_present
    }
}

pub struct Watch {
    hold_us: u64,
    last_look_us: u64,
    steady: [Steady; Self::FINDS.len()],
    present: ImpairmentSet,
}

impl Watch {
    pub const FINDS: [Impairment; 8] = {
        use Impairment::{Backlight, Black, CutOffFace, Dark, DoubtfulFace, HalvedRate, MissingFrames, SmallFace};
        [Black, Dark, Backlight, SmallFace, CutOffFace, DoubtfulFace, HalvedRate, MissingFrames]
    };

    /// Begins to watch a camera. An impairment begins, and ends, when the looks have said so for `hold_us`.
    pub fn new(hold_us: u64) -> Self {
        Self { hold_us, last_look_us: 0, steady: Default::default(), present: ImpairmentSet::default() }
    }

    pub fn present(&self) -> ImpairmentSet {
        self.present
    }

    /// Whether the face is hardly recognised, or turned.
    pub fn is_doubtful(&self) -> bool {
        self.present.contains(Impairment::DoubtfulFace)
    }

    /// Looks at a picture, if the last look was long enough ago, and at the face that was found in it. `is_turned` says that the
    /// face is upright in another rotation of the picture.
    pub fn frame(&mut self, frame: &Frame, face: Option<Face>, is_turned: bool) -> Option<Look> {
        let picture = frame.picture()?;
        // The timestamps of some drivers step back.
        if frame.captured_us.abs_diff(self.last_look_us) < LOOK_US {
            return None;
        }
        self.last_look_us = frame.captured_us;
        let look = Look::at(picture, face);
        self.look(&look, is_turned, frame.captured_us);
        Some(look)
    }

    /// Judges what the camera has delivered, whenever it tells. Returns what it told.
    pub fn deliveries(&mut self, camera: &mut dyn Source) -> Option<Delivery> {
        let delivery = camera.take_delivery()?;
        self.delivery(&delivery, camera.frame_period_us(), monotonic_us());
        Some(delivery)
    }

    /// Judges a look at the picture at the time `now_us`.
    pub fn look(&mut self, look: &Look, is_turned: bool, now_us: u64) {
        let of_face = |judge: fn(FaceLook) -> Verdict| look.face.map_or(UNKNOWN, judge);
        let is_black =
            look.face.is_none() && look.picture.brightness < BLACK && look.picture.contrast < look.picture.noise;
        let dark = match look.face {
            Some(face) if is_backlit(face) => FINE,
            Some(face) => unclear(face),
            None if is_black => FINE,
            None => poor_if_low(look.picture.brightness, BRIGHTNESS)
                .max(poor_if_low(look.picture.contrast.max(PLAIN) / look.picture.noise, CLARITY)),
        };
        let backlit = of_face(|face| if is_backlit(face) { unclear(face) } else { FINE });
        let small = of_face(|face| poor_if_low(face.size_px, SIZE_PX).max(poor_if_low(face.size, SIZE)));
        let cut_off = of_face(|face| poor_if_high(face.cut_off, CUT_OFF));
        let doubtful = match [dark, backlit, small, cut_off].into_iter().max() {
            _ if is_turned && look.face.is_some() => POOR,
            // That may be why.
            Some(POOR | BETWEEN) => UNKNOWN,
            _ => of_face(|face| poor_if_low(face.score, SCORE).max(poor_if_high(face.roll_deg.abs(), ROLL_DEG))),
        };
        let verdicts = [if is_black { POOR } else { FINE }, dark, backlit, small, cut_off, doubtful];
        self.judge(0, verdicts, now_us);
    }

    /// Judges what the camera has delivered up to `now_us`. The camera states a frame period of `stated_us` microseconds.
    fn delivery(&mut self, delivery: &Delivery, stated_us: Option<u64>, now_us: u64) {
        let rate = stated_us.map(|stated_us| delivery.fps() * stated_us as f32 / 1e6);
        let rate = rate.map_or(UNKNOWN, |rate| poor_if_low(rate, RATE));
        self.judge(OF_PICTURE, [rate, poor_if_high(delivery.lost_share(), LOST)], now_us);
    }

    fn judge<const COUNT: usize>(&mut self, first: usize, verdicts: [Verdict; COUNT], now_us: u64) {
        let judged = Self::FINDS.into_iter().zip(&mut self.steady).skip(first);
        for ((impairment, steady), verdict) in judged.zip(verdicts) {
            self.present.set(impairment, steady.update(verdict, now_us, self.hold_us));
        }
    }
}

fn is_backlit(face: FaceLook) -> bool {
    face.surroundings > BACKLIGHT * face.light.brightness
}

fn unclear(face: FaceLook) -> Verdict {
    let Light { contrast, noise, .. } = face.light;
    poor_if_low(contrast / noise, CLARITY).max(poor_if_low(contrast, CONTRAST))
}

#[cfg(test)]
mod tests {
    use facewire_face::{Picture, Pixels};

    use super::*;
    use crate::capture::Content;

    const HOLD_US: u64 = 3_000_000;

    /// Returns after how many looks, which are 0.25 s apart, the impairment changed.
    fn changes(verdicts: &[(Verdict, usize)]) -> Vec<usize> {
        let mut steady = Steady::default();
        let mut was_present = false;
        let looks = verdicts.iter().flat_map(|(verdict, count)| std::iter::repeat_n(*verdict, *count)).enumerate();
        let mut is_change = |(look, verdict)| {
            let is_present = steady.update(verdict, 5_000_000 + look as u64 * 250_000, HOLD_US);
            std::mem::replace(&mut was_present, is_present) != is_present
        };
        looks.filter(|look| is_change(*look)).map(|(look, _)| look).collect()
    }

    #[test]
    fn an_impairment_comes_after_three_seconds_goes_after_three_and_stays_as_it_is_while_looks_alternate() {
        let flicker = [(POOR, 1), (FINE, 1)].repeat(100);
        assert!(changes(&flicker).is_empty());
        assert_eq!(changes(&[(POOR, 20), (FINE, 20)]), [12, 31]);
        assert_eq!(changes(&[vec![(POOR, 14)], flicker].concat()), [12]);
        assert_eq!(changes(&[(POOR, 13), (BETWEEN, 200)]), [12]);
        assert_eq!(changes(&[(POOR, 13), (UNKNOWN, 100)]), [12, 60], "the face has left");
        let mut after_a_pause = Steady::default();
        assert!([0, 86_400_000_000].iter().all(|at_us| !after_a_pause.update(POOR, *at_us, HOLD_US)));
    }

    /// A face in good light, large and whole.
    const FACE: FaceLook = FaceLook {
        light: Light { brightness: 110.0, contrast: 28.0, noise: 2.0 },
        surroundings: 140.0,
        size_px: 200.0,
        size: 0.3,
        cut_off: 0.0,
        score: 24.0,
        roll_deg: 5.0,
    };

    fn told(face: Option<FaceLook>, picture: Light) -> String {
        let mut watch = Watch::new(HOLD_US);
        (0..16).for_each(|look| watch.look(&Look { picture, face }, false, look * 250_000));
        watch.present().to_string()
    }

    #[test]
    fn each_impairment_of_a_face_and_of_a_picture_without_one_has_its_threshold() {
        let light = |brightness, contrast, noise| Light { brightness, contrast, noise };
        for (face, want) in [
            (FACE, "none"),
            (FaceLook { light: light(110.0, 28.0, 20.0), ..FACE }, "dark"),
            (FaceLook { light: light(110.0, 4.9, 2.0), ..FACE }, "dark"),
            (FaceLook { light: light(110.0, 5.1, 2.0), ..FACE }, "none"),
            (FaceLook { light: light(40.0, 12.0, 2.0), ..FACE }, "none"),
            (FaceLook { light: light(40.0, 4.0, 2.0), ..FACE }, "backlight"),
            (FaceLook { size_px: 37.0, ..FACE }, "small-face"),
            (FaceLook { size: 0.11, ..FACE }, "small-face"),
            (FaceLook { cut_off: 0.1, ..FACE }, "cut-off-face"),
            (FaceLook { score: 14.0, ..FACE }, "doubtful-face"),
            (FaceLook { roll_deg: -88.0, ..FACE }, "doubtful-face"),
            (FaceLook { roll_deg: 178.0, ..FACE }, "doubtful-face"),
        ] {
            assert_eq!(told(Some(face), FACE.light), want, "{face:?}");
        }
        let told = |brightness, contrast, noise| told(None, Light { brightness, contrast, noise });
        assert_eq!([told(2.0, 0.0, 0.5), told(15.0, 8.0, 2.0), told(60.0, 10.0, 20.0)], ["black", "dark", "dark"]);
        assert_eq!([told(128.0, 0.0, 0.5), told(60.0, 10.0, 3.0)], ["none"; 2], "a wall, and good light");
    }

    #[test]
    fn a_camera_whose_timestamps_step_back_is_watched_all_the_same() {
        let mut watch = Watch::new(HOLD_US);
        let content =
            Content::Picture(Picture::new(64, 64, Pixels::Grey { data: &[0; 64 * 64], stride: 64 }, true).unwrap());
        for captured_us in [3_600_000_000].into_iter().chain((0..16).map(|look| 5_000_000 + look * LOOK_US)) {
            watch.frame(&Frame { content, captured_us, number: 0 }, None, false);
        }
        assert_eq!(watch.present().to_string(), "black");
    }

    #[test]
    fn half_of_the_stated_rate_and_lost_frames_are_told_apart() {
        for (what, fps, lost, stated_us, want) in [
            ("light of 50 Hz", 25.0, 0.0, Some(33_333), "none"),
            ("half the rate", 15.0, 0.0, Some(33_333), "halved-rate"),
            ("a bad cable", 30.0, 0.1, Some(33_333), "missing-frames"),
            ("the camera was opened at this rate", 15.0, 0.0, Some(66_667), "none"),
            ("the camera states no rate", 15.0, 0.0, None, "none"),
        ] {
            let mut watch = Watch::new(HOLD_US);
            let sent = f32::round(fps * 1.5);
            let delivery = Delivery { time_us: 1_500_000, sent: sent as u64, lost: f32::round(sent * lost) as u64 };
            (0..4).for_each(|window| watch.delivery(&delivery, stated_us, window * 1_500_000));
            assert_eq!(watch.present().to_string(), want, "{what}");
        }
    }
}
