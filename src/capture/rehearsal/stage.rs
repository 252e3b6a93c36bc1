//! The pictures of a scene, and which of its frames arrive.

use super::super::delivery::{Arrival, DeliveryCounter};
use super::super::{CaptureError, Clip, Content, Frame, Paced, Picture, Pixels, Source as _};
use crate::config::Scene;

/// Luma of the picture without a face.
const GREY: u8 = 128;
/// Part of the clip's brightness in the dark: one 150th of its light.
const DARKNESS: u8 = 10;
/// Columns of the clip, of 640, that are outside the picture. They hold a quarter of the face.
const CUT_OFF: usize = 270;
/// At half rate every other frame is delivered, and with losses all but every eighth.
const HALF_RATE: u64 = 2;
const LOSSY: u64 = 8;

/// The clip, and a canvas for pictures that are made of it.
#[derive(Debug)]
pub(super) struct Stage {
    pub(super) film: Paced<Clip>,
    canvas: Vec<u8>,
}

/// Makes a luma plane of the one of the clip, whose rows are `width` bytes apart.
type Paint = fn(luma: &[u8], width: usize, canvas: &mut [u8]);

impl Stage {
    pub(super) fn new(film: Clip) -> Self {
        let pixels = film.describe().width * film.describe().height;
        Self { film: Paced::new(film), canvas: vec![GREY; pixels] }
    }

    pub(super) fn play(&mut self, scene: Scene) -> Result<Option<Frame<'_>>, CaptureError> {
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
pub(super) struct Tally {
    pub(super) period_us: u64,
    /// Number of the last frame of the clip that was played.
    last: Option<u64>,
    pub(super) delivery: DeliveryCounter,
}

impl Tally {
    pub(super) fn new(period_us: u64) -> Self {
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

    pub(super) fn withholds_next(&self, scene: Scene) -> bool {
        !Self::sequence(scene, self.last.map_or(0, |last| last + 1)).1
    }

    /// Counts a frame of the clip, and those before it for which the reader was too late: a driver delivers them all.
    pub(super) fn count(&mut self, scene: Scene, number: u64, captured_us: u64) {
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
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::super::Delivery;
    use super::*;

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
}
