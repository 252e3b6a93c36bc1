//! Watches the open camera, and tells the counters what impairs tracking.

use std::sync::Arc;

use super::counters::Counters;
use crate::capture::{Frame, Source, monotonic_us};
use crate::watch::{Look, Watch};
use facewire_face::Landmarks;

/// Time from one look at the picture to the next, microseconds.
const LOOK_US: u64 = 250_000;
/// Time for which an impairment must last, and be gone, before it is told, microseconds.
const HOLD_US: u64 = 3_000_000;

/// Watches for the hot loop: between a frame and the next it neither allocates nor waits.
#[derive(Debug)]
pub(super) struct Watcher {
    counters: Arc<Counters>,
    watch: Watch,
    /// Frame period that the camera states.
    stated_us: Option<u64>,
    /// Capture of the picture that was looked at last.
    last_look_us: u64,
}

impl Watcher {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        Self { counters, watch: Watch::new(HOLD_US), stated_us: None, last_look_us: 0 }
    }

    /// Begins with another camera.
    pub(super) fn camera_opened(&mut self, camera: &dyn Source) {
        self.stated_us = camera.frame_period_us();
    }

    /// A camera that is closed impairs nothing.
    pub(super) fn camera_closed(&mut self) {
        self.watch = Watch::new(HOLD_US);
        self.tell();
    }

    /// Looks at a picture, if the last look was long enough ago, and at the face that was found in it.
    pub(super) fn look(&mut self, frame: &Frame, face: Option<&Landmarks>) {
        let Some(picture) = frame.picture() else { return };
        // The timestamps of some drivers step back.
        if frame.captured_us.abs_diff(self.last_look_us) >= LOOK_US {
            self.last_look_us = frame.captured_us;
            self.watch.look(&Look::at(picture, face), frame.captured_us);
            self.tell();
        }
    }

    /// Judges what the camera has delivered, if a window is complete.
    pub(super) fn count(&mut self, camera: &mut dyn Source) {
        if let Some(delivery) = camera.take_delivery() {
            self.watch.delivery(&delivery, self.stated_us, monotonic_us());
            self.tell();
        }
    }

    /// Whether the light is too poor to calibrate.
    pub(super) fn is_dark(&self) -> bool {
        self.watch.present().is_dark()
    }

    fn tell(&self) {
        let present = self.watch.present();
        for impairment in Watch::FINDS {
            self.counters.impairments.set(impairment, present.contains(impairment));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Content;
    use facewire_face::{Picture, Pixels};

    #[test]
    fn a_camera_whose_timestamps_step_back_is_watched_all_the_same() {
        let counters = Arc::new(Counters::default());
        let mut watcher = Watcher::new(Arc::clone(&counters));
        let pixels = Pixels::Grey { data: &[0; 64 * 64], stride: 64 };
        let content = Content::Picture(Picture::new(64, 64, pixels, true).unwrap());
        let mut look = |captured_us| watcher.look(&Frame { content, captured_us, number: 0 }, None);
        look(3_600_000_000);
        (0..16).for_each(|number| look(5_000_000 + number * LOOK_US));
        assert_eq!(counters.impairments.present().to_string(), "black");
    }
}
