//! Decides from looks at the picture, and from what the camera delivers, what makes tracking poor.
//!
//! Contract: [`Watch`] is pure: time is a number, and it neither allocates nor reads a clock. The thresholds of the picture
//! are where the coefficients fall to a correlation of 0.9 with those of the undisturbed film, and an impairment ends where
//! they are back at 0.95 (`cargo test --release --test impairments -- --ignored --nocapture` prints the figures).
//!
//! Limits: noise that a camera smooths away is not seen. Motion blur is not measured.

use super::look::{FaceLook, Light, Look};
use super::steady::{Steady, Verdict};
use crate::capture::Delivery;
use crate::impairment::{Impairment, ImpairmentSet};

/// A pair of thresholds: where an impairment begins, and where it ends.
type Thresholds = [f32; 2];

/// Contrast divided by the noise. Of people in dim light r was 0.90 and 0.93 at a clarity of 1.6 and 2.3, whatever the gain.
const CLARITY: Thresholds = [1.7, 2.3];
/// Contrast of a face, of 255 steps. Against the light r was 0.91 at 3.8 and 0.95 at 6.5, of the clip 0.90 at 7.5.
const CONTRAST: Thresholds = [5.0, 6.5];
/// Brightness of the surroundings divided by that of an unclear face, from which the light comes from behind.
const BACKLIGHT: f32 = 2.0;
/// Brightness of a picture without a face. The clip's face is no longer found at 14 to 50, depending on the noise.
const BRIGHTNESS: Thresholds = [20.0, 30.0];
/// Least contrast that a picture without a face is taken to have: a plain wall has none, and is not dark therefore.
const PLAIN: f32 = 10.0;
/// Brightness below which a picture without contrast is black.
const BLACK: f32 = 25.0;
/// Longer side of the face in pixels. r was 0.91 and 0.94 at 41 and 39 px, and 0.83 and 0.85 at 27 and 29.
const SIZE_PX: Thresholds = [38.0, 48.0];
/// The same as a part of the longer side of the picture. Below 0.11 the detector no longer finds the face again.
const SIZE: Thresholds = [0.12, 0.135];
/// Share of the face that is cut off. r was 0.90 from 0.04 (forehead) and 0.07 (chin) to 0.18 (a cheek).
const CUT_OFF: Thresholds = [0.08, 0.05];
/// Frame rate divided by the rate that the camera states. r was 0.82 at half the rate. Cameras that expose longer go from
/// 30 to 15 frames a second or less, and 25 a second is what light of 50 Hz asks for.
const RATE: Thresholds = [0.6, 0.75];
/// Share of the frames that are lost. r was 0.99 with 5 % and 0.97 with 10 %, so this is stricter than the others: each lost
/// frame makes the face stand still for a moment.
const LOST: Thresholds = [0.05, 0.02];

/// Number of impairments that are seen in the picture. The others are seen in what the camera delivers.
const OF_PICTURE: usize = 5;

/// Watches one camera.
#[derive(Debug)]
pub struct Watch {
    hold_us: u64,
    steady: [Steady; Self::FINDS.len()],
    present: ImpairmentSet,
}

impl Watch {
    /// The impairments that this watch can find.
    pub const FINDS: [Impairment; 7] = [
        Impairment::Black,
        Impairment::Dark,
        Impairment::Backlight,
        Impairment::SmallFace,
        Impairment::CutOffFace,
        Impairment::HalvedRate,
        Impairment::MissingFrames,
    ];

    /// Begins to watch a camera. An impairment begins, and ends, when the looks have said so for `hold_us`.
    pub fn new(hold_us: u64) -> Self {
        Self { hold_us, steady: Default::default(), present: ImpairmentSet::default() }
    }

    /// The impairments of this camera that are present.
    pub fn present(&self) -> ImpairmentSet {
        self.present
    }

    /// Judges a look at the picture at the time `now_us`.
    pub fn look(&mut self, look: &Look, now_us: u64) {
        self.judge(0, [black(look), dark(look), backlight(look), small(look), cut_off(look)], now_us);
    }

    /// Judges at the time `now_us` what the camera has delivered, which states a frame period in microseconds.
    pub fn delivery(&mut self, delivery: &Delivery, stated_us: Option<u64>, now_us: u64) {
        let rate = stated_us.map(|stated_us| delivery.fps() * stated_us as f32 / 1e6);
        let rate = rate.map_or(Verdict::Unknown, |rate| Verdict::of_great(rate, RATE));
        self.judge(OF_PICTURE, [rate, Verdict::of_small(delivery.lost_share(), LOST)], now_us);
    }

    /// Updates the impairments from number `first` on.
    fn judge<const COUNT: usize>(&mut self, first: usize, verdicts: [Verdict; COUNT], now_us: u64) {
        let judged = Self::FINDS.into_iter().zip(&mut self.steady).skip(first);
        for ((impairment, steady), verdict) in judged.zip(verdicts) {
            self.present.set(impairment, steady.update(verdict, now_us, self.hold_us));
        }
    }
}

impl Light {
    /// Contrast divided by noise.
    fn clarity(&self) -> f32 {
        self.contrast / self.noise
    }
}

/// Whether the picture shows nothing at all, as with a cap on the lens.
fn is_black(look: &Look) -> bool {
    look.face.is_none() && look.picture.brightness < BLACK && look.picture.clarity() < 1.0
}

fn black(look: &Look) -> Verdict {
    if is_black(look) { Verdict::Poor } else { Verdict::Fine }
}

fn dark(look: &Look) -> Verdict {
    match look.face {
        Some(face) if is_backlit(&face) => Verdict::Fine,
        Some(face) => unclear(&face),
        None if is_black(look) => Verdict::Fine,
        None => Verdict::of_great(look.picture.brightness, BRIGHTNESS)
            .or(Verdict::of_great(look.picture.contrast.max(PLAIN) / look.picture.noise, CLARITY)),
    }
}

fn backlight(look: &Look) -> Verdict {
    match look.face {
        Some(face) if is_backlit(&face) => unclear(&face),
        Some(_) => Verdict::Fine,
        None => Verdict::Unknown,
    }
}

fn is_backlit(face: &FaceLook) -> bool {
    face.surroundings > BACKLIGHT * face.light.brightness
}

fn unclear(face: &FaceLook) -> Verdict {
    Verdict::of_great(face.light.clarity(), CLARITY).or(Verdict::of_great(face.light.contrast, CONTRAST))
}

fn small(look: &Look) -> Verdict {
    let judge = |face: FaceLook| Verdict::of_great(face.size_px, SIZE_PX).or(Verdict::of_great(face.size, SIZE));
    look.face.map_or(Verdict::Unknown, judge)
}

fn cut_off(look: &Look) -> Verdict {
    look.face.map_or(Verdict::Unknown, |face| Verdict::of_small(face.cut_off, CUT_OFF))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face in good light, large and whole.
    const FACE: FaceLook = FaceLook {
        light: Light { brightness: 110.0, contrast: 28.0, noise: 2.0 },
        surroundings: 140.0,
        size_px: 200.0,
        size: 0.3,
        cut_off: 0.0,
    };

    /// Returns what is told after looks of 4 s.
    fn told(face: Option<FaceLook>, picture: Light) -> String {
        let mut watch = Watch::new(3_000_000);
        (0..16).for_each(|look| watch.look(&Look { picture, face }, look * 250_000));
        watch.present().to_string()
    }

    fn with_face(change: impl Fn(&mut FaceLook)) -> String {
        let mut face = FACE;
        change(&mut face);
        told(Some(face), FACE.light)
    }

    #[test]
    fn each_impairment_of_the_picture_has_its_threshold() {
        assert_eq!(with_face(|_| {}), "none");
        assert_eq!(with_face(|face| face.light.noise = 20.0), "dark");
        assert_eq!(with_face(|face| face.light.contrast = 4.9), "dark");
        assert_eq!(with_face(|face| face.light.contrast = 5.1), "none");
        assert_eq!(with_face(|face| face.size_px = 37.0), "small-face");
        assert_eq!(with_face(|face| face.size = 0.11), "small-face");
        assert_eq!(with_face(|face| face.cut_off = 0.1), "cut-off-face");
    }

    #[test]
    fn a_dark_face_is_no_fault_while_it_is_clear_and_backlit_where_it_is_not() {
        let face = |contrast| with_face(|face| face.light = Light { brightness: 40.0, contrast, noise: 2.0 });
        assert_eq!([12.0, 4.0].map(face), ["none", "backlight"]);
    }

    #[test]
    fn a_picture_without_a_face_is_black_dark_noisy_or_in_order() {
        let light = |brightness, contrast, noise| told(None, Light { brightness, contrast, noise });
        assert_eq!(light(2.0, 0.0, 0.5), "black");
        assert_eq!(light(15.0, 8.0, 2.0), "dark");
        assert_eq!(light(60.0, 10.0, 20.0), "dark");
        assert_eq!(light(128.0, 0.0, 0.5), "none", "a wall");
        assert_eq!(light(60.0, 10.0, 3.0), "none");
    }

    /// Returns what is told after four windows in which a camera sent frames at this rate and lost this share of them.
    fn delivered(fps: f32, lost: f32, stated_us: Option<u64>) -> String {
        let mut watch = Watch::new(3_000_000);
        let sent = (fps * 1.5).round();
        let delivery = Delivery { time_us: 1_500_000, sent: sent as u64, lost: (sent * lost).round() as u64 };
        (0..4).for_each(|window| watch.delivery(&delivery, stated_us, window * 1_500_000));
        watch.present().to_string()
    }

    #[test]
    fn half_of_the_stated_rate_and_lost_frames_are_told_apart() {
        let stated_us = Some(33_333);
        assert_eq!(delivered(30.0, 0.0, stated_us), "none");
        assert_eq!(delivered(25.0, 0.0, stated_us), "none", "light of 50 Hz");
        assert_eq!(delivered(15.0, 0.0, stated_us), "halved-rate");
        assert_eq!(delivered(7.5, 0.0, stated_us), "halved-rate");
        assert_eq!(delivered(30.0, 0.1, stated_us), "missing-frames");
        assert_eq!(delivered(15.0, 0.0, Some(66_667)), "none", "the camera was opened at this rate");
        assert_eq!(delivered(15.0, 0.0, None), "none", "the camera states no rate");
    }
}
