//! `facewire check`: says of every part whether it works, before anything relies on it.

use clap::Args;

use super::SettingsArgs;
use super::failure::{Failure, print};
use crate::capture::{DEMO, open_file};
use crate::config::{CameraSettings, Settings, SolverSettings};
use crate::link::Link;
use crate::pipeline::{Pipeline, Rejected, Solver};
use crate::service::open_camera;

const EXAMPLES: &str = "\
Examples:
  facewire check
  facewire check --config facewire.toml

Bad settings are all named, and no device is touched (exit status 78). Otherwise every part is tried, and the \
exit status is that of the first that failed.";

/// Arguments of `facewire check`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct CheckArgs {
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Checks everything, and fails with the first trouble found. Settings come first: bad ones touch no device.
pub(super) fn run(args: &CheckArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    print("settings  ok\n")?;
    let parts = [
        ("model", check_model(&settings)),
        ("networks", check_networks(&settings)),
        ("camera", check_camera(&settings.camera)),
    ];
    let links = settings.links.iter().map(|link| ("link", Link::check(link).map_err(Failure::from)));
    let mut first = None;
    for (part, outcome) in parts.into_iter().chain(links) {
        match outcome {
            Ok(found) => print(&format!("{part:<9} ok: {found}\n"))?,
            Err(failure) => {
                print(&format!("{part:<9} FAILED: {}\n", failure.message()))?;
                first.get_or_insert(failure);
            }
        }
    }
    first.map_or(Ok(()), Err)
}

/// Loads the blendshape model.
fn check_model(settings: &Settings) -> Result<String, Failure> {
    Solver::load(settings)?;
    let path = &settings.solver.model;
    Ok(if path.is_empty() { "the built-in one".to_owned() } else { path.clone() })
}

/// Loads the networks and runs them, with the built-in model, on a frame of the built-in clip, whose face they must find.
fn check_networks(settings: &Settings) -> Result<String, Failure> {
    let settings = Settings { solver: SolverSettings::default(), ..settings.clone() };
    let mut pipeline = Pipeline::load(&settings)?;
    let mut clip = open_file(DEMO)?;
    let Some(frame) = clip.next()? else { return Err(Failure::data("the built-in clip is empty".to_owned())) };
    match pipeline.process(&frame) {
        Ok(_) => Ok("they find the face of the built-in clip".to_owned()),
        Err(Rejected::Infer(error)) => Err(error.into()),
        Err(rejected) => {
            Err(Failure::failed(format!("the built-in clip gives nothing: {rejected}; run scripts/setup again")))
        }
    }
}

/// Opens the camera and waits for one frame.
fn check_camera(settings: &CameraSettings) -> Result<String, Failure> {
    let mut camera = open_camera(settings)?;
    let described = camera.describe().to_string();
    camera.next()?;
    Ok(described)
}
