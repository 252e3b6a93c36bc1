//! `facewire calibrate`: guides the wearer through some poses, and keeps what they tell.
//!
//! A running service holds the camera, so it is asked first. Without a service the command opens the camera
//! itself. The profile is written at the end alone: Ctrl-C leaves the former one.

use std::io::{self, IsTerminal as _};
use std::time::SystemTime;

use clap::Args;
use rustix::termios::tcgetwinsize;

use super::SettingsArgs;
use super::failure::{Failure, print, say};
use crate::calibration::{Calibration, Guide, Observation, Store, WearerName};
use crate::clock::{monotonic_us, seconds_since_1970};
use crate::config::Settings;
use crate::pipeline::{Pipeline, Rejected};
use crate::service::{DEFAULT_WEARER, OpenCamera};
use crate::watch::Watch;
use facewire_packet::control::{Connection, KeptProfile, Listed, Phase, Progress, Reply, Request, Take};

const EXAMPLES: &str = "\
Examples:
  facewire calibrate                        calibrate the wearer in use, or \"default\"
  facewire calibrate --wearer anna          make or replace the profile of anna
  facewire calibrate --list                 who has a profile, and which one is in use
  facewire calibrate --use anna             let the running service use it from now on
  sudo facewire calibrate --wearer anna     if the service runs as another user

It takes about 20 seconds: look into the camera, and do what the display asks for. With wearer.wears = \"headset\" or \
\"mask\", it asks only for what is in view. A service that runs is asked, because it holds the camera; its settings count \
then, and not those of --config. Otherwise the camera of the settings is opened. Ctrl-C ends it, and any former profile \
stays. After the next start, the service uses the wearer that \
wearer.name of its settings names.";

/// Time for which poor light must last before the guide waits for better light.
const HOLD_US: u64 = 1_000_000;

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CalibrateArgs {
    /// The wearer whose profile is made: 1 to 32 letters, digits, - or _ [default: the wearer in use, or "default"]
    #[arg(long, value_name = "NAME", value_parser = WearerName::parse, conflicts_with_all = ["list", "use", "use_none", "delete"])]
    wearer: Option<WearerName>,
    /// List the wearers who have a profile, and calibrate nobody
    #[arg(long, conflicts_with_all = ["use", "use_none", "delete"])]
    list: bool,
    /// Let the running service use the profile of this wearer until its next start, and calibrate nobody
    #[arg(long, value_name = "NAME", value_parser = WearerName::parse, conflicts_with_all = ["use_none", "delete"])]
    r#use: Option<WearerName>,
    /// Let the running service use nobody's profile until its next start, and calibrate nobody
    #[arg(long, conflicts_with = "delete")]
    use_none: bool,
    /// Delete the profile of this wearer, and calibrate nobody
    #[arg(long, value_name = "NAME", value_parser = WearerName::parse)]
    delete: Option<WearerName>,
    #[command(flatten)]
    settings: SettingsArgs,
}

impl CalibrateArgs {
    fn request(&self) -> Request {
        let text = |name: &WearerName| name.to_string();
        match (&self.delete, &self.r#use) {
            (Some(name), _) => Request::Delete { wearer: text(name) },
            (None, Some(name)) => Request::Use { wearer: Some(text(name)) },
            (None, None) if self.use_none => Request::Use { wearer: None },
            (None, None) if self.list => Request::List {},
            (None, None) => Request::Calibrate { wearer: self.wearer.as_ref().map(text) },
        }
    }
}

pub fn run(args: &CalibrateArgs) -> Result<(), Failure> {
    match Connection::open().map_err(Failure::failed)? {
        Some(connection) => by_service(connection, &args.request()),
        None => without_service(args),
    }
}

fn by_service(mut connection: Connection, request: &Request) -> Result<(), Failure> {
    connection.ask(request).map_err(Failure::failed)?;
    let mut shown = None;
    loop {
        match connection.reply().map_err(Failure::failed)? {
            Reply::Progress(progress) => show(&progress, &mut shown)?,
            Reply::Calibrated(report) => return print(&told(&report, "The service uses it from now on.")),
            Reply::Wearers { wearers, in_use, folder } => return print(&listed(&wearers, in_use.as_deref(), &folder)),
            Reply::Done(sentence) => return print(&format!("{sentence}\n")),
            Reply::Refused(sentence) => return Err(Failure::failed(sentence)),
            _ => {}
        }
    }
}

fn without_service(args: &CalibrateArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let store = Store::new(&settings.wearer.folder);
    let in_use = WearerName::new(&settings.wearer.name);
    if let Some(name) = &args.delete {
        store.delete(name)?;
        return print(&format!("the profile of {name} is deleted\n"));
    }
    if args.list {
        let in_use = in_use.as_ref().map(WearerName::as_str);
        return print(&listed(&store.list()?, in_use, &store.folder().display().to_string()));
    }
    if args.r#use.is_some() || args.use_none {
        let remedy = "set wearer.name in its settings, or start it";
        return Err(Failure::failed(format!("no service runs here that could be told; {remedy}")));
    }
    let Some(name) = args.wearer.clone().or(in_use).or_else(|| WearerName::new(DEFAULT_WEARER)) else { return Ok(()) };
    if let Some(why) = store.why_not_replace(&name, settings.wearer.wears) {
        return Err(Failure::failed(why));
    }
    print(&told(&store.keep(&name, calibrate_here(&settings)?)?, ""))
}

fn told(report: &KeptProfile, use_it: &str) -> String {
    let KeptProfile { wearer, path, taken, left_out, refused, warning } = report;
    let asked_for = taken.len() + left_out.len();
    let first = format!("{path}: {} of {asked_for} takes, {refused} refused. {use_it}", taken.len());
    let left_out = left_out.iter().map(|(take, why)| {
        let name = take.name();
        format!("\n  {name} was left out, and its blendshapes keep general values. {why}.")
    });
    let last = format!("\nTo use it after every start, set in the settings: [wearer] name = \"{wearer}\"\n");
    let warning = warning.as_ref().map_or_else(String::new, |warning| format!("\n{warning}"));
    [first, left_out.collect(), warning, last].concat()
}

fn listed(wearers: &[Listed], in_use: Option<&str>, folder: &str) -> String {
    let now_s = seconds_since_1970(SystemTime::now());
    let line = |Listed { wearer, profile }: &Listed| {
        let mark = if in_use == Some(wearer) { '*' } else { ' ' };
        match profile {
            Ok((made_s, takes)) => {
                let days = now_s.saturating_sub(*made_s) / 86_400;
                format!("{mark} {wearer:<32} {takes:2} takes, {days} days old\n")
            }
            Err(error) => format!("{mark} {wearer:<32} cannot be used: {error}\n"),
        }
    };
    let none = if wearers.is_empty() { "  none: `facewire calibrate --wearer NAME` makes one\n" } else { "" };
    format!("profiles in {folder}, * in use:\n{}{none}", wearers.iter().map(line).collect::<String>())
}

fn calibrate_here(settings: &Settings) -> Result<Calibration, Failure> {
    say("no service answers: opening the camera");
    let mut pipeline = Pipeline::load(settings, true)?;
    let mut camera = OpenCamera::open(&settings.camera)?;
    let outcome = guide(&mut camera, &mut pipeline);
    // A camera that does not close must not cost the result.
    camera.source.close().unwrap_or_else(say);
    outcome
}

fn guide(camera: &mut OpenCamera, pipeline: &mut Pipeline) -> Result<Calibration, Failure> {
    let mut guide = Guide::new(pipeline.solver.model().clone(), pipeline.solver.wears());
    let mut shown = None;
    let mut watch = Watch::new(HOLD_US);
    let mut observed_us = monotonic_us();
    loop {
        if let Some(outcome) = guide.outcome() {
            return outcome.map_err(|refusal| Failure::failed(refusal.end()));
        }
        let observation = match camera.next()? {
            // A few damaged frames are no silence.
            None if monotonic_us().saturating_sub(observed_us) as f32 / 1e6 <= guide.gap_s() => continue,
            None => Observation::nothing(monotonic_us()),
            Some(frame) => {
                let processed = pipeline.process(&frame);
                watch.frame(&frame, processed.face, false);
                let observation = processed.observe(watch.present().is_dark());
                if let Err(Rejected::Infer(error)) = processed.solved {
                    return Err(error.into());
                }
                observation
            }
        };
        observed_us = monotonic_us();
        guide.update(&observation);
        show(&guide.progress(), &mut shown)?;
    }
}

/// Shows progress on standard output: three lines that are drawn anew on a terminal, and a line for each change otherwise.
fn show(progress: &Progress, last: &mut Option<Progress>) -> Result<(), Failure> {
    let last = last.replace(progress.clone());
    let shown = lines(progress);
    if !io::stdout().is_terminal() {
        let [task, _, state] = shown;
        let is_shown = last.is_some_and(|last| last.says_the_same(progress));
        return if is_shown { Ok(()) } else { print(&format!("{task}: {}\n", state.trim_start())) };
    }
    let begin = match last {
        Some(_) => "\x1b[3F", // to the beginning of the line three lines above
        None => "Sit as usual, face the camera, and keep your head still.\n",
    };
    // A line that does not fit would be wrapped, and the next picture would be drawn a line too low.
    let width = tcgetwinsize(io::stdout()).map_or(80, |size| usize::from(size.ws_col).max(20) - 1);
    let drawn = shown.map(|line| format!("\x1b[2K{}\n", line.chars().take(width).collect::<String>()));
    print(&[begin, &drawn.concat()].concat())
}

fn lines(progress: &Progress) -> [String; 3] {
    let Progress { take, done, of, phase, measured, seen, .. } = progress;
    let task = format!("[{:2}/{of}] {take}", (done + 1).min(*of));
    let measured = format!("        measured {}", bar(*measured));
    let bars = if *take == Take::Neutral { measured } else { format!("{measured}  seen {}", bar(*seen)) };
    let refused = progress.last_refusal.map(|why| format!("   (refused {}: {why})", progress.refused));
    let refused = refused.unwrap_or_default();
    let state = match (phase, progress.waits_for) {
        (Phase::Measure, _) => "hold it".to_owned(),
        (Phase::Ended, None) => "measured".to_owned(),
        (Phase::Ended, Some(_)) => "ended without a profile".to_owned(),
        (_, Some(why)) => format!("waiting. {why}"),
        (Phase::GetReady, None) => "get ready".to_owned(),
        (Phase::Wait, None) => "waiting".to_owned(),
    };
    [task, bars, format!("        {state}{refused}")]
}

fn bar(share: f32) -> String {
    let full = (share.clamp(0.0, 1.0) * 24.0).round() as usize;
    "█".repeat(full) + &"░".repeat(24 - full)
}
