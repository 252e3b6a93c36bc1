//! A clip of a wearer, and what can be learned of the wearer from its parts.

use std::{ops::Range, path::Path};

use anyhow::{Result, ensure};
use facewire::{
    calibration::{Guide, Observation, Take},
    capture::Content,
    config::Settings,
    pipeline::Pipeline,
    playback::{Face, Playback, Shown, neutral_of},
    preflight::shaping,
    solve::{BLENDSHAPES, Camera, Group, Model, NeutralMode, Profile, Solver},
};

use crate::{
    curves::Truth,
    judge::{
        clips::{load_each, track},
        people::{Person, SolvedFaces},
    },
    parts::Parts,
};

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

/// What is known of the wearer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knowledge {
    /// Nothing.
    Nothing,
    /// What was found while the wearer talked.
    Watched,
    /// What was found while a wearer who is never at rest talked.
    Restless,
    /// The neutral face.
    Neutral,
    /// The result of a guided calibration.
    Calibrated,
    /// The same, of a wearer who smiles when asked for a neutral face.
    Smiled,
}

impl Knowledge {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Nothing, Self::Watched, Self::Restless, Self::Neutral, Self::Calibrated, Self::Smiled];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        ["nothing", "watched", "never at rest", "neutral face", "calibrated", "smiled"][self as usize]
    }
}

/// A solver that knows something of its wearer.
pub struct Learned {
    model: Model,
    profile: Profile,
    /// For each frame of the talk, the frame that the solver sees and learns from. Empty if it does not learn.
    watched_frames: Vec<usize>,
}

/// The clip of a wearer.
pub struct Film {
    name: String,
    faces: Vec<Face>,
    /// The true coefficients and angles of every frame.
    pub truth: Truth,
    /// Where each part of the clip is.
    pub parts: Parts,
}

/// Tracks all clips of a folder, in parallel.
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

    /// Learns what is to be known of the wearer.
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

    /// Returns the estimates of the judged part.
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
    /// Whether anything is known in advance.
    pub fn is_known(&self) -> bool {
        self.watches() || self.profile != Profile::default()
    }

    /// Whether the solver learns while it watches.
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

/// Returns what a guide sees of a face at this time.
fn observation(model: &Model, face: &Face, time_us: u64) -> Observation {
    let frame = face.frame();
    let camera = Camera::new(frame.size_px(), Settings::default().camera.horizontal_fov_deg);
    let seen = if let Content::Face { face, .. } = frame.content { face } else { None };
    Observation::new(model, seen, &camera, time_us, false)
}
