//! Timecodes of Live Link Face: `13:13:04:31.652` is 31.652 frames after 13:13:04.

use anyhow::{Context, Result, ensure};

/// Frame rates of timecodes. The rate may be higher than that of the recording, such as 60 for a recording at 30 Hz.
const RATES: [f64; 5] = [24.0, 25.0, 30.0, 50.0, 60.0];
/// The application's default, for recordings that are too short to contain every frame number.
const DEFAULT_RATE: f64 = 60.0;
/// Length of a recording in seconds that contains every frame number.
const SHOWS_RATE_S: f64 = 2.0;
const DAY_S: f64 = 86_400.0;

/// A timecode: whole seconds since midnight, and frames.
type Timecode = (f64, f64);

/// Converts timecodes to seconds since the midnight before the first of them. The recording may pass midnight. The rate
/// is assumed to be the lowest usual rate at which the highest frame number occurs.
pub fn seconds<'a>(codes: impl Iterator<Item = &'a str>) -> Result<Vec<f64>> {
    let one = |(row, code): (usize, &str)| {
        parse(code).with_context(|| format!("line {}: `{code}` is not a timecode hh:mm:ss:ff.fff", row + 2))
    };
    let codes = codes.enumerate().map(one).collect::<Result<Vec<_>>>()?;
    let rate = rate(&codes)?;
    let mut days = 0.0;
    let mut before = 0.0;
    let unwrap = |(seconds, frames): &Timecode| {
        let time = seconds + frames / rate;
        days += if before - time > DAY_S / 2.0 { DAY_S } else { 0.0 };
        before = time;
        time + days
    };
    Ok(codes.iter().map(unwrap).collect())
}

fn parse(code: &str) -> Option<Timecode> {
    let parts: Vec<f64> = code.trim().split(':').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [hours, minutes, seconds, frames] = parts[..] else { return None };
    let valid = parts.iter().all(|part| *part >= 0.0) && hours < 24.0 && minutes < 60.0 && seconds < 60.0;
    valid.then_some((hours * 3600.0 + minutes * 60.0 + seconds, frames))
}

fn rate(codes: &[Timecode]) -> Result<f64> {
    let highest = codes.iter().map(|(_, frames)| frames.floor()).fold(0.0, f64::max);
    let lowest = RATES.into_iter().find(|rate| highest < *rate);
    let lowest = lowest.with_context(|| format!("a timecode has frame {highest}, but rates end at 60 a second"))?;
    ensure!(!codes.is_empty(), "there is no timecode");
    let shown = codes.iter().any(|(seconds, _)| (seconds - codes[0].0).abs() > SHOWS_RATE_S);
    Ok(if shown { lowest } else { DEFAULT_RATE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_follows_from_the_highest_frame_number() {
        let last = |highest| seconds(["00:00:00:00.0", highest, "00:00:03:15.0"].into_iter()).unwrap()[2];
        assert!((last("00:00:01:29.0") - 3.5).abs() < 1e-9);
        assert!((last("00:00:01:58.0") - 3.25).abs() < 1e-9);
    }

    #[test]
    fn a_short_recording_is_assumed_to_count_60_frames_a_second() {
        assert_eq!(seconds(["00:00:01:00.0", "00:00:01:15.0"].into_iter()).unwrap(), [1.0, 1.25]);
    }

    #[test]
    fn a_recording_may_pass_midnight() {
        let times = seconds(["23:59:59:30.0", "00:00:00:30.0"].into_iter()).unwrap();
        assert!((times[1] - times[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_invalid_timecode_is_refused_with_its_line() {
        for wrong in ["12:00", "1.5", "a:b:c:d", "25:00:00:00", "00:00:00:-1"] {
            let refusal = seconds(["00:00:00:00.0", wrong].into_iter()).unwrap_err();
            assert!(format!("{refusal:#}").contains("line 3"), "{wrong}");
        }
        assert!(seconds(["00:00:00:61.0"].into_iter()).is_err());
    }
}
