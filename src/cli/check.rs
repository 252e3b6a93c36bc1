//! `facewire check`: tries every part that the service needs, and reports which of them work.

use std::io::{IsTerminal as _, stderr};

use facewire_face::{Camera, Landmarks, Method, Rotation, Tracker};

use super::SettingsArgs;
use super::failure::{Failure, print, say};
use crate::calibration::{Store, WearerName};
use crate::capture::{Clip, Frame, Motion, Source as _};
use crate::clock::monotonic_us;
use crate::config::{CameraSettings, NetworkSettings, Settings, SolverSettings};
use crate::link::{Link, notes};
use crate::pipeline::{StageTimes, find, load_solver, load_tracker, profile_warning};
use crate::service::OpenCamera;
use crate::watch::{MountTrial, Watch};
use facewire_board::{self as board, Flags, Impairment, ImpairmentSet, Machine, Sensors};

pub const EXAMPLES: &str = "\
Examples:
  facewire check
  facewire check --config facewire.toml

Bad settings are all named, and no device is touched (exit status 78). Otherwise every part is tried, and the \
exit status is that of the first that failed. The camera is watched for 3 seconds, in which somebody should look \
into it. POOR says what makes tracking poor although everything works, and what to do; it is no failure. Nor is NOTE, which \
names a sum of a servo channel or an adjustment that can leave its range and is then limited.";

/// Time for which the camera is watched, microseconds. It holds two windows in which deliveries are measured, of which
/// the first may be poor because the camera still sets its exposure.
const WATCH_US: u64 = 3_300_000;
/// Time for which an impairment must last, microseconds.
const HOLD_US: u64 = 1_000_000;

/// Frames on which the mounts of the camera are tried, twice as many as it takes if each shows the face.
const MOUNT_FRAMES: usize = 32;

/// What was found at a part, and what impairs tracking there, which is no failure.
type Outcome = Result<(String, ImpairmentSet), Failure>;

type Face = (Landmarks, [f32; 2]);

/// Checks all parts, and fails with the first error. Settings come first, so that bad settings touch no device.
pub fn run(arguments: &SettingsArgs, settings_only: bool) -> Result<(), Failure> {
    let settings = arguments.load()?;
    print("settings  ok\n")?;
    for note in notes(&settings) {
        print(&format!("settings  NOTE: {note}\n"))?;
    }
    if settings_only {
        return Ok(());
    }
    let mut found = find_face(&settings.networks);
    let model = check_model(&settings, found.as_ref().ok().map(|(_, face)| face));
    let seen = watch(&settings.camera, found.as_mut().ok().map(|(tracker, _)| tracker));
    // The sensors are read right after this work, so that they show the board under load.
    let board = check_board(&settings);
    let intact = |found: String| (found, ImpairmentSet::default());
    let parts: [(_, Outcome); 5] = [
        ("model", model.map(intact)),
        ("wearer", check_wearer(&settings).map(intact)),
        ("networks", found.map(|_| intact("they find the face of the built-in clip".to_owned()))),
        ("camera", seen),
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

fn lines(part: &str, outcome: &Outcome) -> String {
    match outcome {
        Ok((found, impairments)) => {
            let poor = impairments.iter().map(|impairment| format!("{part:<9} POOR: {}\n", impairment.sentence()));
            format!("{part:<9} ok: {found}\n") + &poor.collect::<String>()
        }
        Err(failure) => format!("{part:<9} FAILED: {}\n", failure.message),
    }
}

fn check_board(settings: &Settings) -> (String, ImpairmentSet) {
    let root = board::root();
    let machine = Machine::detect(&root);
    let (line, slowing) = Sensors::find(&root, &settings.hardware).read(0.0);
    let flags = Flags::ask();
    let shown = flags.map_or_else(String::new, |flags| format!("; {flags}"));
    let found = flags.map_or_else(ImpairmentSet::default, Flags::impairments);
    (format!("{}; {line}{shown}", machine.tell(settings.board)), slowing.and(found))
}

fn find_face(settings: &NetworkSettings) -> Result<(Tracker, Face), Failure> {
    let mut tracker = load_tracker(settings)?;
    let mut clip = Clip::once()?;
    let frame = clip.next()?.ok_or_else(|| Failure::data("the built-in clip is empty".to_owned()))?;
    let found = find(Some(&mut tracker), &mut StageTimes::default(), &frame)?;
    let none = || {
        Failure::failed(
            "they find no face in the built-in clip: install facewire again, or run scripts/setup".to_owned(),
        )
    };
    let landmarks = found.ok_or_else(none)?.landmarks.clone();
    tracker.forget();
    Ok((tracker, (landmarks, frame.size_px())))
}

fn check_wearer(settings: &Settings) -> Result<String, Failure> {
    let store = Store::new(&settings.wearer.folder);
    let Some(name) = WearerName::new(&settings.wearer.name) else {
        return Ok("no profile is in use: `facewire calibrate` makes one, and wearer.name chooses it".to_owned());
    };
    let file = store.load(&name)?;
    let warning =
        profile_warning(&name, &file, settings.wearer.wears, &settings.solver).map(|warning| format!("; {warning}"));
    let takes = file.takes.len();
    let folder = store.folder().display();
    Ok(format!("{name}, {takes} takes; profiles in {folder}{}", warning.unwrap_or_default()))
}

/// Loads the blendshape model, and solves the face of the built-in clip if the networks have found it.
fn check_model(settings: &Settings, face: Option<&Face>) -> Result<String, Failure> {
    let mut solver = load_solver(settings)?;
    if let Some((landmarks, size_px)) = face {
        let camera = Camera::new(*size_px, settings.camera.horizontal_fov_deg);
        solver.solve(landmarks, &camera, 0).map_err(|error| Failure::failed(error.to_string()))?;
    }
    let SolverSettings { method, model: path } = &settings.solver;
    Ok(match *method {
        _ if !path.is_empty() => path.clone(),
        Method::Paper => "the built-in formulas of the paper".to_owned(),
        _ => "the built-in network".to_owned(),
    })
}

fn watch(settings: &CameraSettings, mut tracker: Option<&mut Tracker>) -> Outcome {
    let mut camera = OpenCamera::open(settings)?;
    if stderr().is_terminal() {
        say("watching the camera for 3 seconds: look into it");
    }
    let mut found = camera.source.describe().to_string();
    let mut watch = Watch::new(HOLD_US);
    let mut delivered = None;
    let mut last_look = None;
    let mut face_px = None;
    let mut motion = Motion::Moving;
    let end_us = monotonic_us() + WATCH_US;
    while monotonic_us() < end_us {
        if let Some(frame) = camera.next()? {
            let found = find(tracker.as_deref_mut(), &mut StageTimes::default(), &frame)?;
            last_look = watch.frame(&frame, found, false).or(last_look);
            face_px = last_look.and_then(|look| look.face).map(|face| face.size_px).or(face_px);
        }
        camera.check()?;
        motion = camera.source.take_tally().motion;
        delivered = watch.deliveries(&mut *camera.source).or(delivered);
    }
    let turned = tracker.as_deref_mut().map(|tracker| try_mount(&mut camera, tracker)).transpose()?.flatten();
    camera.source.close()?;
    if let Some(delivery) = delivered {
        let fps = delivery.fps() * (1.0 - delivery.lost_share());
        found += &format!("; delivers {fps:.1} frames a second");
    }
    if let Some(look) = last_look {
        found += &format!("; brightness {:.0} of 255", look.picture.brightness);
    }
    match face_px {
        Some(size_px) => found += &format!("; a face of {size_px:.0} px"),
        None if tracker.is_some() => found += "; no face is in the picture now",
        None => {}
    }
    if let Some(rotation) = turned.filter(|rotation| *rotation != settings.rotation) {
        let degrees = rotation.degrees();
        found += &format!("; the face stands upright with another rotation: set camera.rotation = {degrees}");
    }
    let mut impairments = watch.present();
    impairments.set(Impairment::FrozenPicture, motion != Motion::Moving);
    Ok((found, impairments))
}

/// Returns the turn after which the camera shows an upright face, if it shows a face at all.
fn try_mount(camera: &mut OpenCamera, tracker: &mut Tracker) -> Result<Option<Rotation>, Failure> {
    let mut trial = MountTrial::default();
    for _ in 0..MOUNT_FRAMES {
        if let Some(picture) = camera.next()?.as_ref().and_then(Frame::picture) {
            trial.add(tracker, picture)?;
        }
        if trial.is_complete() {
            break;
        }
    }
    Ok(trial.best())
}
