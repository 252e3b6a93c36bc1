//! `facewire-fit wearers`: what knowing the wearer is worth, and whether a face looks right, on clips of wearers.

use std::ops::Range;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use facewire::calibration::{Guide, Observation, Take};
use facewire::capture::Content;
use facewire::config::Settings;
use facewire::playback::{Shown, TrackedFrame};
use facewire_face::{BLENDSHAPES, COEFFS, Camera, Group, Model, NeutralMode, Profile, Wears};
use rayon::prelude::*;

use crate::curves::{FRAME_US, LIDS, OPEN, SHUT, shut};
use crate::judge::figures::{Judgement, Phase, Row};
use crate::judge::load_model;
use crate::judge::set::{Clip, playback};
use crate::judge::tables::{WITH_INTERVALS, with_intervals};
use crate::output::Table;
use crate::statistics::{mean, standard_deviation};

#[derive(Debug, Args)]
#[command(after_help = "The clips are of people whom no fit has seen, but what counts as at rest was chosen on such
clips. All rows are judged on the same 20 seconds.
  nothing             the mean face of many people
  watched             what facewire has found while it watched the minute before
  never at rest       what it has found in a wearer who holds the last expression instead of being at rest
  neutral face        the mean of half a second at rest is taken as the neutral face
  calibrated          the guided calibration
  smiled              the guided calibration of a wearer who smiles when asked for a neutral face. Where it is
                      refused, nothing is known

Examples:
  facewire-fit film wearers --count 20 --script wearer
  facewire-fit wearers wearers")]
pub struct Options {
    /// Folder of clips, as `film --script wearer` makes them
    clips: PathBuf,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Draws of people for the confidence intervals
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(40..=100_000))]
    resamples: u64,
}

pub fn run(options: &Options) -> Result<()> {
    let model = load_model(options.model.as_deref())?;
    let films = Clip::load_all(&options.clips, true)?;
    let (mut rows, mut checks) = (Vec::new(), Vec::new());
    for knowledge in Knowledge::ALL {
        let learned = films.par_iter().map(|film| learn(film, &model, knowledge)).collect::<Result<Vec<_>>>()?;
        let judged =
            |(film, learned): (&Clip, &Learned)| film.person(&show(film, learned, JUDGED), film.parts.of(JUDGED), 0);
        let people = films.par_iter().zip(&learned).map(judged).collect();
        let judgement = Judgement::new(people, options.resamples);
        let cells = with_intervals(&judgement, Row::Blendshapes, Phase::All);
        rows.push([knowledge.name().to_owned()].into_iter().chain(cells).collect::<Vec<_>>());
        let known = learned.iter().filter(|learned| learned.is_known()).count();
        eprintln!("{}: something is known of {known} of {} people", knowledge.name(), films.len());
        let found: Vec<Checks> =
            films.par_iter().zip(&learned).map(|(film, learned)| Checks::new(film, learned)).collect();
        checks.push((knowledge, found));
    }
    println!("{}", Table::new(["known of the wearer"].into_iter().chain(WITH_INTERVALS), rows).text());
    println!("{}", table_of(&checks).text());
    print!("{}", turned(&checks));
    Ok(())
}

const NEUTRAL_FRAMES: u64 = 15;
/// The part that is judged, and the one before it.
const JUDGED: &str = "judged";
const TALK: &str = "talk";
/// Coefficient above which a frame shows an expression. Those of the gaze do not count.
const LEAST_EXPRESSION: f64 = 0.25;
/// Frames before a part that filters see, too.
const LEAD_IN: usize = 30;
const MOST_FRAMES: usize = 60 * 30;
/// Frames of the take `smile` in which the smile is held.
const SMILE: Range<usize> = 32..78;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knowledge {
    Nothing,
    Watched,
    /// What was found while a wearer who is never at rest talked.
    Restless,
    Neutral,
    Calibrated,
    Smiled,
}

impl Knowledge {
    const ALL: [Self; 6] =
        [Self::Nothing, Self::Watched, Self::Restless, Self::Neutral, Self::Calibrated, Self::Smiled];

    fn name(self) -> &'static str {
        ["nothing", "watched", "never at rest", "neutral face", "calibrated", "smiled"][self as usize]
    }
}

struct Learned {
    model: Model,
    profile: Profile,
    /// For each frame of the talk, the frame that the solver sees and learns from. Empty if it does not learn.
    watched_frames: Vec<usize>,
}

fn learn(clip: &Clip, model: &Model, knowledge: Knowledge) -> Result<Learned> {
    let profile = match knowledge {
        Knowledge::Nothing | Knowledge::Watched | Knowledge::Restless => Profile::default(),
        Knowledge::Neutral => clip.neutral(NEUTRAL_FRAMES)?.into(),
        Knowledge::Calibrated => calibrate(clip, model, "neutral")?.unwrap_or_default(),
        Knowledge::Smiled => calibrate(clip, model, "smile")?.unwrap_or_default(),
    };
    let watched_frames = match knowledge {
        Knowledge::Watched => clip.parts.of(TALK).collect(),
        Knowledge::Restless => without_rest(clip, clip.parts.of(TALK)),
        _ => Vec::new(),
    };
    Ok(Learned { model: model.clone(), profile, watched_frames })
}

/// Frames in which the wearer holds the last expression instead of being at rest.
fn without_rest(clip: &Clip, frames: Range<usize>) -> Vec<usize> {
    let mut last = frames.clone().find(|frame| is_expression(clip, *frame)).unwrap_or(frames.start);
    let held = |frame| {
        last = if is_expression(clip, frame) { frame } else { last };
        last
    };
    frames.map(held).collect()
}

/// Whether the face of this frame shows an expression. A movement of the eyes alone is not one.
fn is_expression(clip: &Clip, frame: usize) -> bool {
    let coefficients = BLENDSHAPES.iter().zip(&clip.truth.coefficients[frame]);
    coefficients.filter(|(name, _)| Group::of(name) != Group::Gaze).any(|(_, value)| *value > LEAST_EXPRESSION)
}

/// Guides the wearer through a calibration, in which frames of the part `at_rest` are shown for the neutral take. The
/// wearer begins a part again when it has ended. `None` if it was refused.
fn calibrate(clip: &Clip, model: &Model, at_rest: &str) -> Result<Option<Profile>> {
    let mut guide = Guide::new(model.clone(), Wears::Nothing);
    let (mut shown, mut since) = (None, 0);
    for number in 0..MOST_FRAMES {
        let Some(take) = guide.wanted() else { break };
        if shown != Some(take) {
            (shown, since) = (Some(take), 0);
        }
        let frames = match take {
            Take::Neutral if at_rest == "smile" => {
                let smile = clip.parts.of(at_rest);
                smile.start + SMILE.start..smile.start + SMILE.end
            }
            take => clip.parts.of(take.name()),
        };
        ensure!(!frames.is_empty(), "the clip has no part {}: render it again", take.name());
        let face = &clip.faces[frames.start + since % frames.len()];
        since += 1;
        guide.update(&observation(model, face, number as u64 * FRAME_US));
    }
    Ok(guide.outcome().and_then(Result::ok).map(|calibration| calibration.profile))
}

/// Returns what is shown in a part. What is learned by watching has been learned in the minute before the judged part.
fn show(clip: &Clip, learned: &Learned, part: &str) -> Vec<Shown> {
    let frames = clip.parts.of(part);
    let mode = if learned.watches() { NeutralMode::Auto } else { NeutralMode::Off };
    let mut playback = playback(None, &learned.model, learned.profile.clone(), mode);
    for (frame, watched) in clip.parts.of(TALK).zip(&learned.watched_frames) {
        let mut face = clip.faces[*watched].clone();
        face.time_us = clip.faces[frame].time_us;
        playback.show(&face);
    }
    let lead_in = frames.start.saturating_sub(LEAD_IN)..frames.start;
    let lead_in = if learned.watches() && part == JUDGED { frames.start..frames.start } else { lead_in };
    clip.faces[lead_in].iter().for_each(|face| _ = playback.show(face));
    clip.faces[frames].iter().map(|face| playback.show(face)).collect()
}

impl Learned {
    fn is_known(&self) -> bool {
        self.watches() || self.profile != Profile::default()
    }

    fn watches(&self) -> bool {
        !self.watched_frames.is_empty()
    }
}

fn observation(model: &Model, face: &TrackedFrame, time_us: u64) -> Observation {
    let frame = face.frame();
    let camera = Camera::new(frame.size_px(), Settings::default().camera.horizontal_fov_deg);
    let seen = if let Content::Face { face, .. } = frame.content { face } else { None };
    Observation::new(model, seen, &camera, time_us, false)
}

const STILL: [&str; 3] = ["still-bright", "still-dim", "still-dark"];
/// Frames of such a part that count: its last two seconds.
const STILL_FRAMES: usize = 60;
/// A blink must be seen within this many frames of the truth, and be over after as many.
const BLINK_FRAMES: usize = 3;
const OPEN_FRAMES: usize = 12;
/// Yaw from which on a face counts as turned.
const TURNED_DEG: f64 = 28.0;
/// A coefficient of a turned face at rest is listed from here on.
const LISTED: f64 = 0.05;

struct Checks {
    /// For each light, the mean standard deviation of the coefficients, raw and sent, and that of the head in degrees.
    still: [[f64; 3]; STILL.len()],
    /// Number of blinks of either eye, how many reached [`SHUT`], and how many returned below [`OPEN`].
    blinks: [usize; 3],
    leaks: Vec<f64>,
    turned: [f64; COEFFS],
}

impl Checks {
    fn new(clip: &Clip, learned: &Learned) -> Self {
        Self {
            still: STILL.map(|part| still(&show(clip, learned, part))),
            blinks: blinks(clip, &show(clip, learned, "blinks")),
            leaks: leaks(clip, &show(clip, learned, "winks")),
            turned: turned_at_rest(clip, &show(clip, learned, "turned")),
        }
    }
}

fn still(shown: &[Shown]) -> [f64; 3] {
    let solved: Vec<_> = shown.iter().rev().take(STILL_FRAMES).filter_map(|shown| shown.solution.as_ref()).collect();
    let spread = |value: &dyn Fn(usize, usize) -> f32, shape: usize| {
        standard_deviation(&(0..solved.len()).map(|frame| f64::from(value(frame, shape))).collect::<Vec<_>>())
    };
    let all = |value: &dyn Fn(usize, usize) -> f32| mean((0..COEFFS - 1).map(|shape| spread(value, shape)));
    let angles = |frame: usize, axis: usize| solved[frame].head.yaw_pitch_roll_deg()[axis];
    [
        all(&|frame, shape| solved[frame].raw.0[shape]),
        all(&|frame, shape| solved[frame].smoothed.0[shape]),
        (0..3).map(|axis| spread(&angles, axis).powi(2)).sum::<f64>().sqrt(),
    ]
}

fn values(shown: &[Shown], shape: usize, frames: Range<usize>) -> impl Iterator<Item = f64> {
    let frames = frames.start.min(shown.len())..frames.end.min(shown.len());
    shown[frames].iter().map(move |shown| f64::from(shown.pose.coefficients[shape]))
}

fn blinks(clip: &Clip, shown: &[Shown]) -> [usize; 3] {
    let truth = &clip.truth.coefficients[clip.parts.of("blinks")];
    let mut counts = [0; 3];
    for (lid, blink) in LIDS.iter().flat_map(|lid| shut(truth, *lid).into_iter().map(move |blink| (*lid, blink))) {
        let highest = values(shown, lid, blink.start..blink.end + BLINK_FRAMES).fold(0.0, f64::max);
        let lowest = values(shown, lid, blink.end..blink.end + OPEN_FRAMES).fold(1.0, f64::min);
        counts = [counts[0] + 1, counts[1] + usize::from(highest > SHUT), counts[2] + usize::from(lowest < OPEN)];
    }
    counts
}

fn leaks(clip: &Clip, shown: &[Shown]) -> Vec<f64> {
    let truth = &clip.truth.coefficients[clip.parts.of("winks")];
    let other = |lid: usize| LIDS[usize::from(lid == LIDS[0])];
    let winks = LIDS.iter().flat_map(|lid| shut(truth, *lid).into_iter().map(move |wink| (*lid, wink)));
    winks.map(|(lid, wink)| values(shown, other(lid), wink).fold(0.0, f64::max)).collect()
}

fn turned_at_rest(clip: &Clip, shown: &[Shown]) -> [f64; COEFFS] {
    let poses = &clip.truth.pose_deg[clip.parts.of("turned")];
    let turned: Vec<&Shown> =
        shown.iter().zip(poses).filter(|(_, pose)| pose[0].abs() > TURNED_DEG).map(|(shown, _)| shown).collect();
    core::array::from_fn(|shape| mean(turned.iter().map(|shown| f64::from(shown.pose.coefficients[shape]))))
}

fn table_of(all: &[(Knowledge, Vec<Checks>)]) -> Table {
    let heads = ["known of the wearer", "jitter at rest, raw: bright, dim, dark", "sent", "share", "head (degrees)"];
    let heads = heads.into_iter().chain(["blinks above 0.9", "below 0.1 again", "wink: other eye, median", "most"]);
    Table::new(heads, all.iter().map(|(knowledge, people)| row(*knowledge, people)))
}

fn row(knowledge: Knowledge, people: &[Checks]) -> Vec<String> {
    let light = |which: usize, light: usize| mean(people.iter().map(|person| person.still[light][which]));
    let lights = |which: usize, decimals: usize| {
        let texts: Vec<String> = (0..STILL.len()).map(|at| format!("{:.decimals$}", light(which, at))).collect();
        texts.join(", ")
    };
    let shares: Vec<String> = (0..STILL.len()).map(|at| format!("{:.2}", light(1, at) / light(0, at))).collect();
    let count = |which: usize| people.iter().map(|person| person.blinks[which]).sum::<usize>();
    let mut leaks: Vec<f64> = people.iter().flat_map(|person| person.leaks.iter().copied()).collect();
    leaks.sort_by(f64::total_cmp);
    let leak = |index: usize| leaks.get(index).map_or_else(|| "-".to_owned(), |leak| format!("{leak:.2}"));
    vec![
        knowledge.name().to_owned(),
        lights(0, 4),
        lights(1, 4),
        shares.join(", "),
        lights(2, 2),
        format!("{} of {}", count(1), count(0)),
        format!("{} of {}", count(2), count(0)),
        leak(leaks.len() / 2),
        leak(leaks.len().saturating_sub(1)),
    ]
}

/// Lists the coefficients that a face at rest shows when it is turned by 30 degrees.
fn turned(all: &[(Knowledge, Vec<Checks>)]) -> String {
    let line = |(knowledge, people): &(Knowledge, Vec<Checks>)| {
        let value = |shape: usize| mean(people.iter().map(|person| person.turned[shape]));
        let mut high: Vec<(f64, &str)> =
            (0..COEFFS).map(|shape| (value(shape), BLENDSHAPES[shape])).filter(|(value, _)| *value > LISTED).collect();
        high.sort_by(|a, b| b.0.total_cmp(&a.0));
        let names: Vec<String> = high.iter().map(|(value, name)| format!("{name} {value:.2}")).collect();
        let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        format!("at rest, turned by 30 degrees, above {LISTED}, {}: {names}\n", knowledge.name())
    };
    all.iter().map(line).collect()
}
