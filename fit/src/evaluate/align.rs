//! Two recordings on one clock: the truth is read at the times of the track.

use anyhow::{Result, ensure};

use crate::{
    curves::MOVING,
    recording::Recording,
    statistics::{mean, pearson, standard_deviation},
};

/// A time so little outside a recording is its end: files round their times.
const SLACK_S: f64 = 0.001;
/// Recordings differ in length if they do by more than so many frames.
const LENGTH_FRAMES: f64 = 1.5;
/// How far the best shift is looked for.
const SEARCH_S: f64 = 2.0;
/// Fewer rows in common say nothing.
const LEAST_ROWS: usize = 10;

/// A blendshape that both have.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Its ARKit name.
    pub blendshape: &'static str,
    /// What is judged.
    pub estimate: Vec<f64>,
    /// What it is judged by, at the same times.
    pub truth: Vec<f64>,
}

/// Curves of both at the same times.
#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// Seconds after the truth's first row.
    pub times_s: Vec<f64>,
    /// Frames that the track was taken to be late by.
    pub shift_frames: i32,
    /// Seconds from frame to frame of the track, and of the truth.
    pub steps_s: [f64; 2],
    /// The blendshapes that both have.
    pub pairs: Vec<Pair>,
    /// Blendshapes that only the track has, and only the truth.
    pub unmatched: [Vec<&'static str>; 2],
}

/// Refuses recordings of different length, which hardly show the same.
pub fn same_length(track: &Recording, truth: &Recording) -> Result<()> {
    let (a, b) = (track.length_s(), truth.length_s());
    ensure!(
        (a - b).abs() <= LENGTH_FRAMES * track.step_s().max(truth.step_s()),
        "the track lasts {a:.2} s, the truth {b:.2} s: cut them to the same stretch, state their rate with --fps, or \
         judge what both cover with --overlap"
    );
    Ok(())
}

impl Aligned {
    /// Takes the track to be late by `shift_frames` of its own frames.
    pub fn new(track: &Recording, truth: &Recording, shift_frames: i32) -> Result<Self> {
        let unmatched = [(track, truth), (truth, track)].map(|(one, other)| {
            let alone = |name: &&&'static str| !other.curves.contains_key(**name);
            one.curves.keys().filter(alone).copied().collect()
        });
        let late_s = f64::from(shift_frames) * track.step_s();
        let inside = |time: &f64| (-SLACK_S..=truth.length_s() + SLACK_S).contains(time);
        let times = track.times_s.iter().map(|time| time - late_s).enumerate().filter(|(_, time)| inside(time));
        let (rows, times_s): (Vec<usize>, Vec<f64>) = times.unzip();
        ensure!(rows.len() >= LEAST_ROWS, "only {} frames lie in both; at least {LEAST_ROWS} are needed", rows.len());
        let pair = |(name, curve): (&&'static str, &Vec<f64>)| {
            let at = |time: &f64| truth.at(name, time.clamp(0.0, truth.length_s()));
            let truth: Vec<f64> = times_s.iter().filter_map(at).collect();
            let estimate = rows.iter().map(|row| curve[*row]).collect();
            (truth.len() == rows.len()).then_some(Pair { blendshape: name, estimate, truth })
        };
        let pairs: Vec<Pair> = track.curves.iter().filter_map(pair).collect();
        ensure!(!pairs.is_empty(), "the two files have no blendshape in common");
        let steps_s = [track.step_s(), truth.step_s()];
        Ok(Self { times_s, shift_frames, steps_s, pairs, unmatched })
    }

    /// Mean correlation of the blendshapes that move in the truth.
    fn likeness(&self) -> f64 {
        let moving = self.pairs.iter().filter(|pair| pair.moves());
        mean(moving.map(|pair| pearson(&pair.estimate, &pair.truth)))
    }
}

impl Pair {
    /// Whether the truth moves enough to correlate with.
    pub fn moves(&self) -> bool {
        standard_deviation(&self.truth) > MOVING
    }
}

/// With the shift within [`SEARCH_S`] that correlates best; of shifts that leave less than half of the shorter one, none.
pub fn best(track: &Recording, truth: &Recording) -> Result<Aligned> {
    let whole = Aligned::new(track, truth, 0)?;
    #[expect(clippy::cast_possible_truncation, reason = "some dozens")]
    let reach = (SEARCH_S / track.step_s()).ceil() as i32;
    let least_rows = whole.times_s.len() / 2;
    let shifted = (-reach..=reach).filter_map(|shift| Aligned::new(track, truth, shift).ok());
    let long_enough = shifted.filter(|aligned| aligned.times_s.len() >= least_rows);
    Ok(long_enough.fold(whole, |best, next| if next.likeness() > best.likeness() { next } else { best }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wink of `jawOpen` every second, seen `late_s` late at `fps`.
    fn wave(fps: f64, length_s: f64, late_s: f64) -> Recording {
        let times = (0..1000).map(|row| f64::from(row) / fps).take_while(|time| *time < length_s + 0.5 / fps);
        let value = |time: f64| ((time - late_s) * 4.0).sin().mul_add(0.5, 0.5);
        let lines: Vec<String> = times.map(|time| format!("{time},{}\n", value(time))).collect();
        Recording::read(format!("time_s,jawOpen\n{}", lines.concat()).as_bytes(), fps).unwrap()
    }

    #[test]
    fn other_rate_is_interpolated() {
        let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &wave(100.0, 5.0, 0.0), 0).unwrap();
        assert_eq!(aligned.times_s.len(), 151);
        let worst = aligned.pairs[0].estimate.iter().zip(&aligned.pairs[0].truth).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 2e-4);
    }

    #[test]
    fn delay_is_found_to_the_frame() {
        let late = best(&wave(30.0, 8.0, 0.2), &wave(60.0, 8.0, 0.0)).unwrap();
        assert_eq!(late.shift_frames, 6);
        assert!(late.likeness() > 0.999);
        let early = best(&wave(30.0, 8.0, -0.5), &wave(30.0, 8.0, 0.0)).unwrap();
        assert_eq!(early.shift_frames, -15);
    }

    #[test]
    fn different_lengths_are_refused_with_both() {
        let refusal = same_length(&wave(30.0, 5.0, 0.0), &wave(30.0, 6.0, 0.0)).unwrap_err().to_string();
        assert!(refusal.contains("5.00 s") && refusal.contains("6.00 s") && refusal.contains("--overlap"));
        assert!(same_length(&wave(30.0, 5.0, 0.0), &wave(60.0, 5.0, 0.0)).is_ok());
    }

    #[test]
    fn blendshapes_of_one_side_are_named() {
        let other = Recording::read("time_s,jawOpen,jawLeft\n0,0,0\n5,1,1\n".as_bytes(), 30.0).unwrap();
        let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &other, 0).unwrap();
        assert_eq!(aligned.unmatched, [vec![], vec!["jawLeft"]]);
        let strange = Recording::read("time_s,jawLeft\n0,0\n5,1\n".as_bytes(), 30.0).unwrap();
        assert!(Aligned::new(&wave(30.0, 5.0, 0.0), &strange, 0).is_err());
    }
}
