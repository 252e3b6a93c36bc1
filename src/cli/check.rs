//! `facewire check`: tries every part that the service needs, and reports which of them work.

use clap::Args;

use super::SettingsArgs;
use super::failure::{Failure, print};
use crate::capture::{Clip, Frame, Source as _};
use crate::config::{CameraSettings, NetworkSettings, Settings};
use crate::face::Landmarks;
use crate::hardware::{self, Board, Flags, Sensors};
use crate::impairment::ImpairmentSet;
use crate::link::Link;
use crate::preflight::{load_solver, load_tracker};
use crate::service::{await_picture, open_camera};
use crate::solve::Camera;

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

/// Checks all parts, and fails with the first error. Settings come first, so that bad settings touch no device.
pub(super) fn run(args: &CheckArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    print("settings  ok\n")?;
    let face = clip_face(&settings.networks);
    let parts = [
        ("model", check_model(&settings, face.as_ref().ok())),
        ("networks", face.map(|_| "they find the face of the built-in clip".to_owned())),
        ("camera", check_camera(&settings.camera)),
    ];
    // The board is looked at while it is still at work.
    check_board(&settings)?;
    let links = Link::check_all(&settings.links).into_iter().map(|outcome| ("link", outcome.map_err(Failure::from)));
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

/// Reads the sensors of the board. What impairs tracking is no failure: the service works all the same.
fn check_board(settings: &Settings) -> Result<(), Failure> {
    let root = hardware::root();
    let (board, readings) = (Board::detect(&root), Sensors::find(&root, &settings.hardware).read());
    let flags = Flags::ask();
    let shown = flags.map_or_else(String::new, |flags| format!("; {flags}"));
    print(&format!("board     ok: {}; {readings}{shown}\n", board.tell(settings.board)))?;
    let found = flags.map_or_else(ImpairmentSet::default, Flags::impairments);
    print_impairments("board", readings.impairments().and(found))
}

/// Prints a line for each impairment that was found at a part.
fn print_impairments(part: &str, found: ImpairmentSet) -> Result<(), Failure> {
    found.iter().try_for_each(|impairment| print(&format!("{part:<9} POOR: {}\n", impairment.sentence())))
}

/// Landmarks, and the size of the picture in which they were found.
type Face = (Landmarks, [f32; 2]);

/// Loads the networks, and finds the face in the first frame of the built-in clip.
fn clip_face(settings: &NetworkSettings) -> Result<Face, Failure> {
    let mut tracker = load_tracker(settings)?;
    let mut clip = Clip::once()?;
    let frame = clip.next()?;
    let picture = frame.as_ref().and_then(Frame::picture);
    let picture = picture.ok_or_else(|| Failure::data("the built-in clip is empty".to_owned()))?;
    let none = || Failure::failed("they find no face in the built-in clip; run scripts/setup again".to_owned());
    let region = tracker.detect(picture)?.ok_or_else(none)?;
    let landmarks = tracker.landmarks(picture, &region)?.ok_or_else(none)?;
    Ok((landmarks.clone(), [picture.width, picture.height].map(|side| side as f32)))
}

/// Loads the blendshape model, and solves the face of the built-in clip if the networks have found it.
fn check_model(settings: &Settings, face: Option<&Face>) -> Result<String, Failure> {
    let mut solver = load_solver(&settings.solver)?;
    if let Some((landmarks, size_px)) = face {
        let camera = Camera::new(*size_px, settings.camera.horizontal_fov_deg);
        solver.solve(landmarks, &camera, 0).map_err(|error| Failure::failed(error.to_string()))?;
    }
    let path = &settings.solver.model;
    Ok(if path.is_empty() { "the built-in one".to_owned() } else { path.clone() })
}

/// Opens the camera and waits for an intact frame.
fn check_camera(settings: &CameraSettings) -> Result<String, Failure> {
    let mut camera = open_camera(settings)?;
    let described = camera.describe().to_string();
    await_picture(&mut *camera, || {})?;
    camera.close()?;
    Ok(described)
}
