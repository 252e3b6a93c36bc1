//! Whether a face looks right: jitter at rest, blinks, winks, and a turned face at rest.

use std::ops::Range;

use facewire::{
    playback::Shown,
    solve::{BLENDSHAPES, COEFFS},
};

use super::film::{Film, Knowledge, Learned};
use crate::{
    judge::text::table,
    parts::runs,
    statistics::{mean, standard_deviation},
};

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

/// The findings on one person.
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
    /// Looks at all parts of a clip.
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
        [head.yaw_deg, head.pitch_deg, head.roll_deg][axis]
    };
    [
        all(&|frame, shape| solved[frame].raw.0[shape]),
        all(&|frame, shape| solved[frame].smoothed.0[shape]),
        (0..3).map(|axis| spread(&angles, axis).powi(2)).sum::<f64>().sqrt(),
    ]
}

/// Returns the frames in which a lid is truly shut, as ranges.
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

/// Returns the table of all checks.
pub fn table_of(all: &[(Knowledge, Vec<Checks>)]) -> String {
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
    let rows: Vec<Vec<String>> = all.iter().map(|(knowledge, people)| row(*knowledge, people)).collect();
    table(&heads, &rows)
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
