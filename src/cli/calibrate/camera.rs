//! Calibration without a service: opens the camera of the settings, and guides the wearer.

use super::super::failure::{Failure, say};
use super::Display;
use crate::calibration::{Calibration, Guide, Observation};
use crate::capture::{CaptureError, Frame, Source, monotonic_us};
use crate::config::Settings;
use crate::pipeline::Pipeline;
use crate::service::{await_picture, open_camera};
use crate::watch::{Look, Watch};

/// Time for which poor light must last before the guide waits for better light, microseconds.
const HOLD_US: u64 = 1_000_000;
/// Time from one look at the light to the next, microseconds.
const LOOK_US: u64 = 250_000;

/// Guides the wearer in front of the camera.
pub(super) fn calibrate(settings: &Settings) -> Result<Calibration, Failure> {
    say("no service answers: opening the camera");
    let mut pipeline = Pipeline::load(settings)?;
    let mut camera = open_camera(&settings.camera)?;
    await_picture(&mut *camera, || {})?;
    let outcome = guide(&mut *camera, &mut pipeline);
    // A camera that does not close must not cost the result.
    if let Err(error) = camera.close() {
        say(error);
    }
    outcome
}

fn guide(camera: &mut dyn Source, pipeline: &mut Pipeline) -> Result<Calibration, Failure> {
    let (mut guide, mut display) = (Guide::new(pipeline.solver.model.clone()), Display::new());
    let mut light = Light { watch: Watch::new(HOLD_US), looked_us: 0 };
    loop {
        if let Some(outcome) = guide.outcome() {
            return outcome.map_err(|refusal| Failure::failed(refusal.end()));
        }
        match camera.next() {
            Ok(Some(frame)) => guide.update(&observe(&frame, pipeline, &mut light)?),
            Ok(None) => return Err(CaptureError::Gone.into()),
            Err(CaptureError::Frame { .. }) => guide.update(&Observation::nothing(monotonic_us())),
            Err(error) => return Err(error.into()),
        }
        display.show(&guide.progress())?;
    }
}

/// Watches the light.
struct Light {
    watch: Watch,
    looked_us: u64,
}

fn observe(frame: &Frame, pipeline: &mut Pipeline, light: &mut Light) -> Result<Observation, Failure> {
    let landmarks = pipeline.find(frame)?.map(|face| face.landmarks);
    if let Some(picture) = frame.picture()
        && frame.captured_us.abs_diff(light.looked_us) >= LOOK_US
    {
        light.looked_us = frame.captured_us;
        light.watch.look(&Look::at(picture, landmarks), frame.captured_us);
    }
    let observation = pipeline.observe(frame, light.watch.present().is_dark());
    if !observation.shows_face() {
        pipeline.forget_face();
    }
    Ok(observation)
}
