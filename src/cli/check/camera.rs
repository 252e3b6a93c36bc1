//! Watches the camera for some seconds: its rate, the frames that it loses, the light, and the face.

use std::fmt;
use std::io::{IsTerminal as _, stderr};

use super::super::failure::say;
use crate::capture::{Delivery, Frame, monotonic_us};
use crate::config::CameraSettings;
use crate::impairment::ImpairmentSet;
use crate::service::OpenCamera;
use crate::watch::{Look, Watch};
use facewire_face::InferError;
use facewire_face::Tracker;

use super::Failure;

/// Time for which the camera is watched, microseconds. It holds two windows of what a camera delivers, of which the first
/// may be poor because the camera still sets its exposure.
const WATCH_US: u64 = 3_300_000;
/// Time for which an impairment must last, microseconds.
const HOLD_US: u64 = 1_000_000;

/// What was seen. Displays as one line.
#[derive(Default)]
pub struct Seen {
    camera: String,
    delivery: Option<Delivery>,
    /// The last look, and the last one with a face.
    look: Option<Look>,
    face_px: Option<f32>,
    /// Whether the networks could look for a face.
    has_tracker: bool,
    pub impairments: ImpairmentSet,
}

/// Opens the camera, waits for an intact frame, and watches the camera from then on.
pub fn watch(settings: &CameraSettings, tracker: Option<&mut Tracker>) -> Result<Seen, Failure> {
    let mut camera = OpenCamera::open(settings)?;
    let seen = watch_open(&mut camera, tracker)?;
    camera.close()?;
    Ok(seen)
}

fn watch_open(camera: &mut OpenCamera, mut tracker: Option<&mut Tracker>) -> Result<Seen, Failure> {
    if stderr().is_terminal() {
        say("watching the camera for 3 seconds: look into it");
    }
    let (camera_line, has_tracker) = (camera.source.describe().to_string(), tracker.is_some());
    let mut seen = Seen { camera: camera_line, has_tracker, ..Seen::default() };
    let stated_us = camera.source.frame_period_us();
    let mut watch = Watch::new(HOLD_US);
    let end_us = monotonic_us() + WATCH_US;
    while monotonic_us() < end_us {
        if let Some(frame) = camera.next()? {
            seen.look(&frame, tracker.as_deref_mut(), &mut watch)?;
        }
        if let Some(delivery) = camera.source.take_delivery() {
            watch.delivery(&delivery, stated_us, monotonic_us());
            seen.delivery = Some(delivery);
        }
    }
    seen.impairments = watch.present();
    Ok(seen)
}

impl Seen {
    fn look(&mut self, frame: &Frame, tracker: Option<&mut Tracker>, watch: &mut Watch) -> Result<(), InferError> {
        let Some(picture) = frame.picture() else { return Ok(()) };
        let landmarks = match tracker {
            Some(tracker) => match tracker.detect(picture)? {
                Some(region) => tracker.landmarks(picture, &region)?,
                None => None,
            },
            None => None,
        };
        let look = Look::at(picture, landmarks);
        watch.look(&look, frame.captured_us);
        self.face_px = look.face.map(|face| face.size_px).or(self.face_px);
        self.look = Some(look);
        Ok(())
    }
}

impl fmt::Display for Seen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.camera)?;
        if let Some(delivery) = &self.delivery {
            write!(f, "; delivers {:.1} frames a second", delivery.fps() * (1.0 - delivery.lost_share()))?;
        }
        if let Some(look) = &self.look {
            write!(f, "; brightness {:.0} of 255", look.picture.brightness)?;
        }
        match self.face_px {
            Some(size_px) => write!(f, "; a face of {size_px:.0} px"),
            None if self.has_tracker => f.write_str("; no face is in the picture now"),
            None => Ok(()),
        }
    }
}
