//! A clip of a wearer, and what can be learned of the wearer from its parts.

use std::ops::Range;
use std::path::Path;

use anyhow::{Result, ensure};
use facewire::calibration::{Guide, Observation, Take};
use facewire::capture::Content;
use facewire::config::Settings;
use facewire::pipeline::Pipeline;
use facewire::playback::{Face, Playback, Shown, neutral_of};
use facewire::preflight::shaping;
use facewire_face::{BLENDSHAPES, COEFFS, Camera, Group, Model, NeutralMode, Profile, Solver};

use crate::curves::{Parts, Truth, runs};
use crate::judge::figures::{Person, SolvedFaces};
use crate::judge::set::{load_each, track};
use crate::output::Table;
use crate::statistics::{mean, standard_deviation};

/// Frames at rest that are taken as the neutral face.
const NEUTRAL_FRAMES: u64 = 15;
/// The part that is judged, and the one before it.
const JUDGED: &str = "judged";
const TALK: &str = "talk";
/// Coefficient above which a frame shows an expression. Those of the gaze do not count.
const LEAST_EXPRESSION: f64 = 0.25;
/// Frames before a part that filters see, too.
const LEAD_IN: usize = 30;
/// Time between frames.
const FRAME_US: u64 = 33_333;
/// Longest calibration.
const MOST_FRAMES: usize = 60 * 30;
/// Frames of the take `smile` in which the smile is held.
const SMILE: Range<usize> = 32..78;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knowledge {
    Nothing,
    Watched,
    /// What was found while a wearer who is never at rest talked.
    Restless,
    Neutral,
    Calibrated,
    Smiled,
}

impl Knowledge {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Nothing, Self::Watched, Self::Restless, Self::Neutral, Self::Calibrated, Self::Smiled];

    pub fn name(self) -> &'static str {
        ["nothing", "watched", "never at rest", "neutral face", "calibrated", "smiled"][self as usize]
    }
}

pub struct Learned {
    model: Model,
    profile: Profile,
    /// For each frame of the talk, the frame that the solver sees and learns from. Empty if it does not learn.
    watched_frames: Vec<usize>,
}

pub struct Film {
    name: String,
    faces: Vec<Face>,
    pub truth: Truth,
    pub parts: Parts,
}

pub fn load(folder: &Path) -> Result<Vec<Film>> {
    load_each(folder, Film::load)
}

impl Film {
    fn load(path: &Path) -> Result<Self> {
        let csv = path.with_extension("csv");
        let truth = Truth::load(&csv)?;
        let parts = Parts::load(&path.with_extension("parts.csv"))?;
        let faces = track(path)?;
        truth.fits(&csv, faces.len())?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, faces, truth, parts })
    }

    pub fn learn(&self, model: &Model, knowledge: Knowledge) -> Result<Learned> {
        let profile = match knowledge {
            Knowledge::Nothing | Knowledge::Watched | Knowledge::Restless => Profile::default(),
            Knowledge::Neutral => {
                Profile { neutral: Some(neutral_of(&self.faces, &(0..NEUTRAL_FRAMES))?), ..Profile::default() }
            }
            Knowledge::Calibrated => self.calibrate(model, "neutral")?.unwrap_or_default(),
            Knowledge::Smiled => self.calibrate(model, "smile")?.unwrap_or_default(),
        };
        let watched_frames = match knowledge {
            Knowledge::Watched => self.parts.of(TALK).collect(),
            Knowledge::Restless => self.without_rest(self.parts.of(TALK)),
            _ => Vec::new(),
        };
        Ok(Learned { model: model.clone(), profile, watched_frames })
    }

    /// Frames in which the wearer holds the last expression instead of being at rest.
    fn without_rest(&self, frames: Range<usize>) -> Vec<usize> {
        let mut last = frames.clone().find(|frame| self.is_expression(*frame)).unwrap_or(frames.start);
        frames
            .map(|frame| {
                if self.is_expression(frame) {
                    last = frame;
                }
                last
            })
            .collect()
    }

    /// Whether the face of this frame shows an expression. A movement of the eyes alone is not one.
    fn is_expression(&self, frame: usize) -> bool {
        let coefficients = BLENDSHAPES.iter().zip(&self.truth.coefficients[frame]);
        coefficients.filter(|(name, _)| Group::of(name) != Group::Gaze).any(|(_, value)| *value > LEAST_EXPRESSION)
    }

    /// Guides the wearer through a calibration, in which frames of the part `at_rest` are shown for the neutral take. The
    /// wearer begins a part again when it has ended. `None` if it was refused.
    fn calibrate(&self, model: &Model, at_rest: &str) -> Result<Option<Profile>> {
        let mut guide = Guide::new(model.clone());
        let (mut shown, mut since) = (None, 0);
        for number in 0..MOST_FRAMES {
            let Some(take) = guide.wanted() else { break };
            if shown != Some(take) {
                (shown, since) = (Some(take), 0);
            }
            let frames = match take {
                Take::Neutral if at_rest == "smile" => {
                    let smile = self.parts.of(at_rest);
                    smile.start + SMILE.start..smile.start + SMILE.end
                }
                take => self.parts.of(take.name()),
            };
            ensure!(!frames.is_empty(), "the clip has no part {}: render it again", take.name());
            let face = &self.faces[frames.start + since % frames.len()];
            since += 1;
            guide.update(&observation(model, face, number as u64 * FRAME_US));
        }
        Ok(guide.outcome().and_then(Result::ok).map(|calibration| calibration.profile))
    }

    pub fn judged(&self, learned: &Learned) -> Person {
        let frames = self.parts.of(JUDGED);
        let shown = self.show(learned, JUDGED);
        let faces = SolvedFaces {
            estimates: shown.iter().map(|shown| shown.pose.coefficients.map(f64::from)).collect(),
            truths: self.truth.coefficients[frames.clone()].to_vec(),
            is_neutral: vec![false; frames.len()],
        };
        Person::new(self.name.clone(), &faces, true)
    }

    /// Returns what is shown in a part. What is learned by watching has been learned in the minute before the judged part.
    pub fn show(&self, learned: &Learned, part: &str) -> Vec<Shown> {
        let frames = self.parts.of(part);
        let mut playback = learned.playback();
        for (frame, watched) in self.parts.of(TALK).zip(&learned.watched_frames) {
            let mut face = self.faces[*watched].clone();
            face.time_us = self.faces[frame].time_us;
            playback.show(&face);
        }
        let lead_in = frames.start.saturating_sub(LEAD_IN)..frames.start;
        let lead_in = if learned.watches() && part == JUDGED { frames.start..frames.start } else { lead_in };
        self.faces[lead_in].iter().for_each(|face| _ = playback.show(face));
        self.faces[frames].iter().map(|face| playback.show(face)).collect()
    }
}

impl Learned {
    pub fn is_known(&self) -> bool {
        self.watches() || self.profile != Profile::default()
    }

    fn watches(&self) -> bool {
        !self.watched_frames.is_empty()
    }

    fn playback(&self) -> Playback {
        let settings = Settings::default();
        let mut solver = Solver::new(self.model.clone(), self.profile.clone(), shaping(&settings));
        solver.neutral_mode = if self.watches() { NeutralMode::Auto } else { NeutralMode::Off };
        let pipeline = Pipeline::for_landmarks(solver, settings.camera.horizontal_fov_deg);
        Playback::new(pipeline, &settings.failsafe)
    }
}

fn observation(model: &Model, face: &Face, time_us: u64) -> Observation {
    let frame = face.frame();
    let camera = Camera::new(frame.size_px(), Settings::default().camera.horizontal_fov_deg);
    let seen = if let Content::Face { face, .. } = frame.content { face } else { None };
    Observation::new(model, seen, &camera, time_us, false)
}

/// Parts in which the face holds still.
const STILL: [&str; 3] = ["still-bright", "still-dim", "still-dark"];
/// Frames of such a part that count: its last two seconds.
const STILL_FRAMES: usize = 60;
/// `eyeBlinkLeft` and `eyeBlinkRight`.
const LIDS: [usize; 2] = [0, 7];
/// A blink must be seen within this many frames of the truth, and be over after as many.
const BLINK_FRAMES: usize = 3;
const OPEN_FRAMES: usize = 12;
/// What a blink must reach, and what it must return below.
const SHUT: f64 = 0.9;
const OPEN: f64 = 0.1;
/// Yaw from which on a face counts as turned.
const TURNED_DEG: f64 = 28.0;
/// A coefficient of a turned face at rest is listed from here on.
const LISTED: f64 = 0.05;

pub struct Checks {
    /// For each light, the mean standard deviation of the coefficients, raw and sent, and that of the head in degrees.
    still: [[f64; 3]; STILL.len()],
    /// Number of blinks of either eye, how many reached [`SHUT`], and how many returned below [`OPEN`].
    blinks: [usize; 3],
    /// The highest value of the open eye in each wink.
    leaks: Vec<f64>,
    /// The mean of each coefficient while the head is turned.
    turned: [f64; COEFFS],
}

impl Checks {
    pub fn new(film: &Film, learned: &Learned) -> Self {
        Self {
            still: STILL.map(|part| still(&film.show(learned, part))),
            blinks: blinks(film, &film.show(learned, "blinks")),
            leaks: leaks(film, &film.show(learned, "winks")),
            turned: turned_at_rest(film, &film.show(learned, "turned")),
        }
    }
}

fn still(shown: &[Shown]) -> [f64; 3] {
    let solved: Vec<_> = shown.iter().rev().take(STILL_FRAMES).filter_map(|shown| shown.solution.as_ref()).collect();
    let spread = |value: &dyn Fn(usize, usize) -> f32, shape: usize| {
        standard_deviation(&(0..solved.len()).map(|frame| f64::from(value(frame, shape))).collect::<Vec<_>>())
    };
    let all = |value: &dyn Fn(usize, usize) -> f32| mean((0..COEFFS - 1).map(|shape| spread(value, shape)));
    let angles = |frame: usize, axis: usize| {
        let head = &solved[frame].head;
        head.yaw_pitch_roll_deg()[axis]
    };
    [
        all(&|frame, shape| solved[frame].raw.0[shape]),
        all(&|frame, shape| solved[frame].smoothed.0[shape]),
        (0..3).map(|axis| spread(&angles, axis).powi(2)).sum::<f64>().sqrt(),
    ]
}

fn shut(truth: &[[f64; COEFFS]], lid: usize) -> Vec<Range<usize>> {
    runs((0..truth.len()).filter(|frame| truth[*frame][lid] > SHUT))
}

fn values(shown: &[Shown], shape: usize, frames: Range<usize>) -> impl Iterator<Item = f64> {
    let frames = frames.start.min(shown.len())..frames.end.min(shown.len());
    shown[frames].iter().map(move |shown| f64::from(shown.pose.coefficients[shape]))
}

fn blinks(film: &Film, shown: &[Shown]) -> [usize; 3] {
    let truth = &film.truth.coefficients[film.parts.of("blinks")];
    let mut counts = [0; 3];
    for (lid, blink) in LIDS.iter().flat_map(|lid| shut(truth, *lid).into_iter().map(move |blink| (*lid, blink))) {
        let highest = values(shown, lid, blink.start..blink.end + BLINK_FRAMES).fold(0.0, f64::max);
        let lowest = values(shown, lid, blink.end..blink.end + OPEN_FRAMES).fold(1.0, f64::min);
        counts = [counts[0] + 1, counts[1] + usize::from(highest > SHUT), counts[2] + usize::from(lowest < OPEN)];
    }
    counts
}

fn leaks(film: &Film, shown: &[Shown]) -> Vec<f64> {
    let truth = &film.truth.coefficients[film.parts.of("winks")];
    let other = |lid: usize| LIDS[usize::from(lid == LIDS[0])];
    let winks = LIDS.iter().flat_map(|lid| shut(truth, *lid).into_iter().map(move |wink| (*lid, wink)));
    winks.map(|(lid, wink)| values(shown, other(lid), wink).fold(0.0, f64::max)).collect()
}

fn turned_at_rest(film: &Film, shown: &[Shown]) -> [f64; COEFFS] {
    let poses = &film.truth.pose_deg[film.parts.of("turned")];
    let turned: Vec<&Shown> =
        shown.iter().zip(poses).filter(|(_, pose)| pose[0].abs() > TURNED_DEG).map(|(shown, _)| shown).collect();
    core::array::from_fn(|shape| mean(turned.iter().map(|shown| f64::from(shown.pose.coefficients[shape]))))
}

pub fn table_of(all: &[(Knowledge, Vec<Checks>)]) -> Table {
    let heads = [
        "known of the wearer",
        "jitter at rest, raw: bright, dim, dark",
        "sent",
        "share",
        "head (degrees)",
        "blinks above 0.9",
        "below 0.1 again",
        "wink: other eye, median",
        "most",
    ];
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
pub fn turned(all: &[(Knowledge, Vec<Checks>)]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shut_lids_are_found_as_ranges() {
        let lid = [0.0, 0.95, 1.0, 0.2, 0.0, 1.0];
        let truth: Vec<[f64; COEFFS]> = lid.iter().map(|value| [*value; COEFFS]).collect();
        assert_eq!(shut(&truth, 7), [1..3, 5..6]);
    }
}
