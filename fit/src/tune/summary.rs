//! What the default settings make of a face as a whole: everything that is sent, compared with the raw coefficients.

use std::{fmt, ops::Range};

use facewire::solve::{BLENDSHAPES, COEFFS, Group, HeadPose};

use super::{
    measure::Sums,
    smoothing::{PARTS, Part},
    streams::Stream,
};
use crate::parts::runs;

/// A lid is shut and open beyond these values.
const SHUT: f32 = 0.9;
const OPEN: f32 = 0.1;
/// Frames after the truth within which a lid must have followed.
const LATE: usize = 4;
const BLINKS: [usize; 2] = [0, 7];
/// The parts of a clip at rest.
const LIGHTS: [&str; 3] = ["still-bright", "still-dim", "still-dark"];

/// The figures of all clips.
pub struct Summary {
    /// For each part of the face the standard deviation at rest under each light, raw and sent (of the head in degrees),
    /// and the delay by cross-correlation and until the same value appears.
    parts: Vec<PartFigures>,
    /// Raw and sent.
    blinks: [Blinks; 2],
    /// Mean and greatest value of the open eye while the other one winks, raw and sent.
    leaks: [[f32; 2]; 2],
    /// Mean deviation of the gaze from the frame before a blink, raw and sent.
    gaze: [f64; 2],
}

/// The name of a part of the face, its deviations at rest, and its delays.
type PartFigures = (&'static str, [[f64; 2]; LIGHTS.len()], [f64; 2]);

/// Blinks that shut both lids, and after which both opened again.
#[derive(Default)]
struct Blinks {
    count: usize,
    shut: usize,
    opened: usize,
}

pub fn angles_deg(head: &HeadPose) -> [f64; 3] {
    [head.yaw_deg, head.pitch_deg, head.roll_deg].map(f64::from)
}

pub fn of(streams: &[Stream]) -> Summary {
    let sums = |part: Part, still: &[&str], moving: &[&str]| -> Sums {
        streams.iter().map(|stream| stream.sums(part, &stream.sent, &stream.sent_heads, still, moving)).sum()
    };
    let parts = PARTS.map(|(part, name, _)| {
        let rest = LIGHTS.map(|light| sums(part, &[light], &[]).deviations());
        let moved = sums(part, &[], &["talk", "judged"]);
        (name, rest, [moved.lag_ms(), moved.same_value_ms()])
    });
    Summary {
        parts: parts.into(),
        blinks: [blinks(streams, |stream| &stream.raw), blinks(streams, |stream| &stream.sent)],
        leaks: [leaks(streams, |stream| &stream.raw), leaks(streams, |stream| &stream.sent)],
        gaze: [gaze(streams, |stream| &stream.raw), gaze(streams, |stream| &stream.sent)],
    }
}

/// Runs of frames in which the truth of a lid is beyond [`SHUT`].
fn shut(stream: &Stream, part: &str, lid: usize) -> Vec<Range<usize>> {
    let is_shut = |frame: usize| stream.truth.coefficients[frame][lid] > SHUT.into();
    runs(stream.parts.of(part).filter(|frame| is_shut(*frame)))
}

fn blinks(streams: &[Stream], curves: impl Fn(&Stream) -> &Vec<[f32; COEFFS]>) -> Blinks {
    let mut all = Blinks::default();
    for stream in streams {
        for run in shut(stream, "blinks", BLINKS[0]) {
            let after = run.end + LATE..(run.end + 10).min(stream.raw.len());
            let lids = |frames: Range<usize>| {
                BLINKS.map(|lid| curves(stream)[frames.clone()].iter().map(move |f| f[lid]).collect::<Vec<_>>())
            };
            all.count += 1;
            all.shut += usize::from(lids(run.start..run.end + LATE).iter().all(|lid| lid.iter().any(|x| *x > SHUT)));
            all.opened += usize::from(lids(after).iter().all(|lid| lid.iter().any(|x| *x < OPEN)));
        }
    }
    all
}

fn leaks(streams: &[Stream], curves: impl Fn(&Stream) -> &Vec<[f32; COEFFS]>) -> [f32; 2] {
    let mut leaks = Vec::new();
    for stream in streams {
        for [winking, open] in [[BLINKS[0], BLINKS[1]], [BLINKS[1], BLINKS[0]]] {
            let frames = shut(stream, "winks", winking).into_iter().flatten();
            leaks.extend(frames.map(|frame| curves(stream)[frame][open]));
        }
    }
    [leaks.iter().sum::<f32>() / leaks.len().max(1) as f32, leaks.iter().copied().fold(0.0, f32::max)]
}

fn gaze(streams: &[Stream], curves: impl Fn(&Stream) -> &Vec<[f32; COEFFS]>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    let gaze = || (0..COEFFS).filter(|index| Group::of(BLENDSHAPES[*index]) == Group::Gaze);
    for stream in streams {
        for run in shut(stream, "blinks", BLINKS[0]).into_iter().filter(|run| run.start > 5) {
            let before = &curves(stream)[run.start - 5];
            for frame in run {
                sum += gaze().map(|index| f64::from((curves(stream)[frame][index] - before[index]).abs())).sum::<f64>();
                count += 8.0;
            }
        }
    }
    sum / f64::max(count, 1.0)
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "| part | deviation at rest, bright | dim | dark | lag ms | same value ms |\n|---|---|---|---|---|---|"
        )?;
        for (part, lights, [lag, same]) in &self.parts {
            let rest = lights.map(|[raw, sent]| format!("{sent:.4} of {raw:.4} ({:.2})", sent / raw.max(1e-9)));
            writeln!(f, "| {part} | {} | {lag:.1} | {same:.1} |", rest.join(" | "))?;
        }
        for (what, Blinks { count, shut, opened }) in ["raw", "sent"].into_iter().zip(&self.blinks) {
            writeln!(
                f,
                "blinks, {what}: {count}; {shut} shut both lids above {SHUT}, {opened} opened both below {OPEN}"
            )?;
        }
        let [[raw, raw_most], [sent, sent_most]] = self.leaks;
        writeln!(f, "winks: the other lid is at {sent:.2} (at most {sent_most:.2}), raw {raw:.2} ({raw_most:.2})")?;
        writeln!(f, "blinks move the gaze by {:.3}, raw {:.3}", self.gaze[1], self.gaze[0])
    }
}
