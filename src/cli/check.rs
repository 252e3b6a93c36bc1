//! `facewire check`: tries every part that the service needs, and reports which of them work.

mod camera;

use clap::Args;

use super::SettingsArgs;
use super::failure::{Failure, print};
use crate::calibration::{Store, Take, WearerName};
use crate::capture::{Clip, Frame, Source as _};
use crate::config::{NetworkSettings, Settings};
use crate::hardware::{self, Board, Flags, Sensors};
use crate::impairment::ImpairmentSet;
use crate::link::{Link, notes};
use crate::preflight::{load_solver, load_tracker, model_warning};
use facewire_face::Camera;
use facewire_face::{Landmarks, Tracker};

const EXAMPLES: &str = "\
Examples:
  facewire check
  facewire check --config facewire.toml

Bad settings are all named, and no device is touched (exit status 78). Otherwise every part is tried, and the \
exit status is that of the first that failed. The camera is watched for 3 seconds, in which somebody should look \
into it. POOR says what makes tracking poor although everything works, and what to do; it is no failure. Nor is NOTE, which \
names a sum of a servo channel or an adjustment that can leave its range and is then limited.";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CheckArgs {
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Checks all parts, and fails with the first error. Settings come first, so that bad settings touch no device.
pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    print("settings  ok\n")?;
    for note in notes(&settings) {
        print(&format!("settings  NOTE: {note}\n"))?;
    }
    let mut found = find_face(&settings.networks);
    let model = check_model(&settings, found.as_ref().ok().map(|(_, face)| face));
    let seen = camera::watch(&settings.camera, found.as_mut().ok().map(|(tracker, _)| tracker));
    // The board is looked at while it is still at work.
    let board = check_board(&settings);
    let wearer = check_wearer(&settings);
    let parts: [(_, Outcome); 5] = [
        ("model", model.map(intact)),
        ("wearer", wearer.map(intact)),
        ("networks", found.map(|_| intact("they find the face of the built-in clip".to_owned()))),
        ("camera", seen.map(|seen| (seen.to_string(), seen.impairments))),
        ("board", Ok(board)),
    ];
    let links = Link::check_all(&settings.links).into_iter();
    let links = links.map(|outcome| ("link", outcome.map(intact).map_err(Failure::from)));
    let mut first = None;
    for (part, outcome) in parts.into_iter().chain(links) {
        print(&lines(part, &outcome))?;
        first = first.or(outcome.err());
    }
    first.map_or(Ok(()), Err)
}

/// What was found at a part, and what impairs tracking there. That is no failure: the service works all the same.
type Outcome = Result<(String, ImpairmentSet), Failure>;

fn intact(found: String) -> (String, ImpairmentSet) {
    (found, ImpairmentSet::default())
}

fn check_board(settings: &Settings) -> (String, ImpairmentSet) {
    let root = hardware::root();
    let (board, readings) = (Board::detect(&root), Sensors::find(&root, &settings.hardware).read());
    let flags = Flags::ask();
    let shown = flags.map_or_else(String::new, |flags| format!("; {flags}"));
    let found = flags.map_or_else(ImpairmentSet::default, Flags::impairments);
    (format!("{}; {readings}{shown}", board.tell(settings.board)), readings.impairments().and(found))
}

fn lines(part: &str, outcome: &Outcome) -> String {
    match outcome {
        Ok((found, impairments)) => {
            let poor = impairments.iter().map(|impairment| format!("{part:<9} POOR: {}\n", impairment.sentence()));
            format!("{part:<9} ok: {found}\n") + &poor.collect::<String>()
        }
        Err(failure) => format!("{part:<9} FAILED: {}\n", failure.message()),
    }
}

/// Landmarks, and the size of the picture in which they were found.
type Face = (Landmarks, [f32; 2]);

/// Loads the networks, and finds the face in the first frame of the built-in clip.
fn find_face(settings: &NetworkSettings) -> Result<(Tracker, Face), Failure> {
    let mut tracker = load_tracker(settings)?;
    let mut clip = Clip::once()?;
    let frame = clip.next()?;
    let picture = frame.as_ref().and_then(Frame::picture);
    let picture = picture.ok_or_else(|| Failure::data("the built-in clip is empty".to_owned()))?;
    let none = || Failure::failed("they find no face in the built-in clip; run scripts/setup again".to_owned());
    let region = tracker.detect(picture)?.ok_or_else(none)?;
    let landmarks = tracker.landmarks(picture, &region)?.ok_or_else(none)?.clone();
    tracker.forget();
    Ok((tracker, (landmarks, [picture.width, picture.height].map(|side| side as f32))))
}

fn check_wearer(settings: &Settings) -> Result<String, Failure> {
    let store = Store::new(&settings.wearer.folder);
    let Some(name) = WearerName::new(&settings.wearer.name) else {
        return Ok("nobody's profile: `facewire calibrate` makes one, and wearer.name chooses it".to_owned());
    };
    let file = store.load(&name)?;
    let warning = model_warning(settings).map_or_else(String::new, |warning| format!("; {warning}"));
    let (takes, all, folder) = (file.takes.len(), Take::ALL.len(), store.folder().display());
    Ok(format!("{name}, {takes} of {all} takes; profiles in {folder}{warning}"))
}

/// Loads the blendshape model, and solves the face of the built-in clip if the networks have found it.
fn check_model(settings: &Settings, face: Option<&Face>) -> Result<String, Failure> {
    let mut solver = load_solver(settings)?;
    if let Some((landmarks, size_px)) = face {
        let camera = Camera::new(*size_px, settings.camera.horizontal_fov_deg);
        solver.solve(landmarks, &camera, 0).map_err(|error| Failure::failed(error.to_string()))?;
    }
    let path = &settings.solver.model;
    Ok(if path.is_empty() { "the built-in one".to_owned() } else { path.clone() })
}
