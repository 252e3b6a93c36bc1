//! Aligns two recordings in time: the truth is interpolated at the times of the track.

use anyhow::{Result, ensure};

use crate::{
    curves::MOVING,
    recording::Recording,
    statistics::{mean, pearson, standard_deviation},
};

/// Tolerance at the ends of a recording, because files round their times.
const SLACK_S: f64 = 0.001;
/// Recordings count as different in length if they differ by more than this many frames.
const LENGTH_FRAMES: f64 = 1.5;
/// Range of the search for the best shift.
const SEARCH_S: f64 = 2.0;
/// Fewest common rows that can be judged.
const LEAST_ROWS: usize = 10;

/// A blendshape that both recordings have.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// ARKit name.
    pub blendshape: &'static str,
    /// The curve to judge.
    pub estimate: Vec<f64>,
    /// The true curve at the same times.
    pub truth: Vec<f64>,
}

/// Two recordings at the same times.
#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// Seconds since the truth's first row.
    pub times_s: Vec<f64>,
    /// The assumed lag of the track in frames.
    pub shift_frames: i32,
    /// Seconds per frame of the track, and of the truth.
    pub steps_s: [f64; 2],
    /// The blendshapes that both recordings have.
    pub pairs: Vec<Pair>,
    /// Blendshapes that only the track has, and those that only the truth has.
    pub unmatched: [Vec<&'static str>; 2],
}

/// Checks that two recordings have the same length. If they do not, they hardly show the same performance.
pub fn same_length(track: &Recording, truth: &Recording) -> Result<()> {
    let (a, b) = (track.length_s(), truth.length_s());
    ensure!(
        (a - b).abs() <= LENGTH_FRAMES * track.step_s().max(truth.step_s()),
        "the track lasts {a:.2} s, but the truth {b:.2} s: cut them to the same frames, state their rate with --fps, \
         or judge their overlap with --overlap"
    );
    Ok(())
}

impl Aligned {
    /// Aligns two recordings, assuming that the track lags by `shift_frames` of its own frames.
    pub fn new(track: &Recording, truth: &Recording, shift_frames: i32) -> Result<Self> {
        let unmatched = [(track, truth), (truth, track)].map(|(one, other)| {
            let alone = |name: &&&'static str| !other.curves.contains_key(**name);
            one.curves.keys().filter(alone).copied().collect()
        });
        let lag_s = f64::from(shift_frames) * track.step_s();
        let inside = |time: &f64| (-SLACK_S..=truth.length_s() + SLACK_S).contains(time);
        let times = track.times_s.iter().map(|time| time - lag_s).enumerate().filter(|(_, time)| inside(time));
        let (rows, times_s): (Vec<usize>, Vec<f64>) = times.unzip();
        ensure!(rows.len() >= LEAST_ROWS, "the files overlap in {} frames, but {LEAST_ROWS} are needed", rows.len());
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

    /// Returns the mean correlation of the blendshapes that move in the truth.
    fn mean_correlation(&self) -> f64 {
        let moving = self.pairs.iter().filter(|pair| pair.moves());
        mean(moving.map(|pair| pearson(&pair.estimate, &pair.truth)))
    }
}

impl Pair {
    /// Returns whether the truth moves enough for a correlation.
    pub fn moves(&self) -> bool {
        standard_deviation(&self.truth) > MOVING
    }
}

/// Aligns two recordings with the best-correlating shift within [`SEARCH_S`] that keeps at least half of their overlap.
pub fn best(track: &Recording, truth: &Recording) -> Result<Aligned> {
    let whole = Aligned::new(track, truth, 0)?;
    #[expect(clippy::cast_possible_truncation, reason = "some dozens")]
    let reach = (SEARCH_S / track.step_s()).ceil() as i32;
    let least_rows = whole.times_s.len() / 2;
    let shifted = (-reach..=reach).filter_map(|shift| Aligned::new(track, truth, shift).ok());
    let long_enough = shifted.filter(|aligned| aligned.times_s.len() >= least_rows);
    let correlation = Aligned::mean_correlation;
    Ok(long_enough.fold(whole, |best, next| if correlation(&next) > correlation(&best) { next } else { best }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A `jawOpen` that oscillates and lags by `lag_s`.
    fn wave(fps: f64, length_s: f64, lag_s: f64) -> Recording {
        let times = (0..1000).map(|row| f64::from(row) / fps).take_while(|time| *time < length_s + 0.5 / fps);
        let value = |time: f64| ((time - lag_s) * 4.0).sin().mul_add(0.5, 0.5);
        let lines: Vec<String> = times.map(|time| format!("{time},{}\n", value(time))).collect();
        Recording::read(format!("time_s,jawOpen\n{}", lines.concat()).as_bytes(), fps).unwrap()
    }

    #[test]
    fn a_truth_of_another_rate_is_interpolated() {
        let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &wave(100.0, 5.0, 0.0), 0).unwrap();
        assert_eq!(aligned.times_s.len(), 151);
        let worst = aligned.pairs[0].estimate.iter().zip(&aligned.pairs[0].truth).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 2e-4);
    }

    #[test]
    fn the_lag_is_found_to_the_frame() {
        let late = best(&wave(30.0, 8.0, 0.2), &wave(60.0, 8.0, 0.0)).unwrap();
        assert_eq!(late.shift_frames, 6);
        assert!(late.mean_correlation() > 0.999);
        let early = best(&wave(30.0, 8.0, -0.5), &wave(30.0, 8.0, 0.0)).unwrap();
        assert_eq!(early.shift_frames, -15);
    }

    #[test]
    fn different_lengths_are_refused_with_both_lengths() {
        let refusal = same_length(&wave(30.0, 5.0, 0.0), &wave(30.0, 6.0, 0.0)).unwrap_err().to_string();
        assert!(refusal.contains("5.00 s") && refusal.contains("6.00 s") && refusal.contains("--overlap"));
        assert!(same_length(&wave(30.0, 5.0, 0.0), &wave(60.0, 5.0, 0.0)).is_ok());
    }

    #[test]
    fn blendshapes_that_only_one_file_has_are_named() {
        let other = Recording::read("time_s,jawOpen,jawLeft\n0,0,0\n5,1,1\n".as_bytes(), 30.0).unwrap();
        let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &other, 0).unwrap();
        assert_eq!(aligned.unmatched, [vec![], vec!["jawLeft"]]);
        let strange = Recording::read("time_s,jawLeft\n0,0\n5,1\n".as_bytes(), 30.0).unwrap();
        assert!(Aligned::new(&wave(30.0, 5.0, 0.0), &strange, 0).is_err());
    }
}
