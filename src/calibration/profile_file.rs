//! A wearer's profile as a file that people can read and compare (TOML).
//!
//! ```toml
//! format = 1
//! made_by = "facewire 0.1.0"
//! made_at_unix_s = 1790000000
//! takes = ["neutral", "eyes-shut"]      # the takes that were accepted
//!
//! neutral = [                           # x, y, z of the 478 landmarks, in ten-thousandths of the distance of the eyes
//! [0, -5059, 6753],
//! ]
//!
//! [blendshapes]
//! eyeBlinkLeft = { rest = 0.0213, gain = 1.1042 }
//! ```

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;
use thiserror::Error;

use super::take::Take;
use crate::face::LANDMARKS;
use crate::solve::{BLENDSHAPES, COEFFS, GAINS, MAX_REST, Neutral, Profile};

/// Version of the layout.
const FORMAT: u32 = 1;
/// Size limit of a file.
pub const MAX_PROFILE_BYTES: usize = 16 << 10;
/// Steps of a coordinate for each eye distance.
const STEPS: f32 = 10_000.0;
/// Greatest coordinate in a file, steps. Faces stay below 3 eye distances.
const MAX_STEPS: i32 = 50_000;

/// Why a text is no profile.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ProfileError {
    /// The text is longer than any profile.
    #[error("it is larger than {} KiB, and so no profile", MAX_PROFILE_BYTES >> 10)]
    TooLarge,
    /// The file is of another version.
    #[error("it has format {found}, and this facewire reads format {FORMAT}")]
    WrongFormat {
        /// The format that it states.
        found: u32,
    },
    /// The text is cut short, or is no TOML of this layout.
    #[error("it is damaged: {0}")]
    Damaged(String),
    /// A number is one that no face has.
    #[error("it is damaged: {0} has a value that no face has")]
    Absurd(String),
}

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileFile {
    /// The wearer's profile, with a neutral face.
    pub profile: Profile,
    /// The takes that were accepted.
    pub takes: Vec<Take>,
    /// When the file was made, seconds since 1970.
    pub made_at_unix_s: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "fields that are there for people, and the format, which is read before")]
struct Table {
    format: u32,
    made_by: String,
    made_at_unix_s: u64,
    takes: Vec<Take>,
    neutral: Vec<[i32; 3]>,
    blendshapes: BTreeMap<String, Terms>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Terms {
    rest: f32,
    gain: f32,
}

impl ProfileFile {
    /// Reads a text.
    ///
    /// # Errors
    /// [`ProfileError`].
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        #[derive(Deserialize)]
        struct Header {
            format: u32,
        }
        if text.len() > MAX_PROFILE_BYTES {
            return Err(ProfileError::TooLarge);
        }
        let header: Result<Header, _> = toml::from_str(text);
        if let Ok(Header { format }) = header
            && format != FORMAT
        {
            return Err(ProfileError::WrongFormat { found: format });
        }
        let table: Table = toml::from_str(text).map_err(|error| ProfileError::Damaged(one_line(error.message())))?;
        table.read()
    }

    /// Writes the text.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::with_capacity(MAX_PROFILE_BYTES);
        let takes: Vec<_> = self.takes.iter().map(|take| format!("{:?}", take.name())).collect();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "format = {FORMAT}\nmade_by = \"facewire {}\"", env!("CARGO_PKG_VERSION"));
        let _ = writeln!(text, "made_at_unix_s = {}\ntakes = [{}]\n", self.made_at_unix_s, takes.join(", "));
        text.push_str("# x, y, z of the landmarks, in ten-thousandths of the distance of the eyes\nneutral = [\n");
        for [x, y, z] in self.profile.neutral.iter().flat_map(Neutral::points) {
            let [x, y, z] = [x, y, z].map(steps);
            let _ = writeln!(text, "[{x},{y},{z}],");
        }
        text.push_str("]\n\n[blendshapes]\n");
        for (name, (rest, gain)) in BLENDSHAPES.iter().zip(self.profile.rest.iter().zip(&self.profile.gain)) {
            let _ = writeln!(text, "{name} = {{ rest = {rest:.4}, gain = {gain:.4} }}");
        }
        text
    }
}

impl Table {
    fn read(self) -> Result<ProfileFile, ProfileError> {
        let damaged = |what: String| ProfileError::Damaged(what);
        if !self.takes.is_sorted_by(|a, b| a < b) {
            return Err(damaged("the takes are not in order".to_owned()));
        }
        if self.neutral.len() != LANDMARKS {
            return Err(damaged(format!("it has {} landmarks instead of {LANDMARKS}", self.neutral.len())));
        }
        let far =
            self.neutral.iter().position(|point| point.iter().any(|value| value.unsigned_abs() > MAX_STEPS as u32));
        if let Some(index) = far {
            return Err(ProfileError::Absurd(format!("landmark {index}")));
        }
        let mut points = [[0.0; 3]; LANDMARKS];
        points.iter_mut().zip(&self.neutral).for_each(|(point, read)| *point = read.map(|value| value as f32 / STEPS));
        let neutral = Neutral::of_face(&points).map_err(|_| ProfileError::Absurd("the neutral face".to_owned()))?;
        let mut profile = Profile { neutral: Some(neutral), ..Profile::default() };
        if self.blendshapes.len() != COEFFS {
            return Err(damaged(format!("it has {} blendshapes instead of {COEFFS}", self.blendshapes.len())));
        }
        for (name, (rest, gain)) in BLENDSHAPES.iter().zip(profile.rest.iter_mut().zip(&mut profile.gain)) {
            let terms = self.blendshapes.get(*name).ok_or_else(|| damaged(format!("there is no {name}")))?;
            let is_sane = terms.rest.abs() <= MAX_REST && (GAINS[0]..=GAINS[1]).contains(&terms.gain);
            if !is_sane {
                return Err(ProfileError::Absurd(format!("blendshapes.{name}")));
            }
            (*rest, *gain) = (terms.rest, terms.gain);
        }
        Ok(ProfileFile { profile, takes: self.takes, made_at_unix_s: self.made_at_unix_s })
    }
}

/// A coordinate in steps. The greatest is far below the range of the type.
#[expect(clippy::cast_possible_truncation, reason = "clamped")]
fn steps(value: f32) -> i32 {
    (value * STEPS).round().clamp(-(MAX_STEPS as f32), MAX_STEPS as f32) as i32
}

/// The message without line ends and terminal escape sequences, which a damaged file may contain.
fn one_line(message: &str) -> String {
    message.chars().map(|symbol| if symbol.is_control() { ' ' } else { symbol }).take(200).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub(super) mod tests {
    use super::*;
    use crate::solve::{NeutralMean, normalise, test_face::face};

    /// A profile of a face of few points, which was made at this time.
    pub(crate) fn file(made_at_unix_s: u64) -> ProfileFile {
        let mut mean = NeutralMean::default();
        mean.add(&normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap());
        let mut profile = Profile { neutral: Some(mean.finish().unwrap()), ..Profile::default() };
        profile.rest.iter_mut().for_each(|rest| *rest = -0.2125);
        profile.gain.iter_mut().for_each(|gain| *gain = 1.25);
        let parsed = ProfileFile { profile, takes: vec![Take::Neutral, Take::EyesShut], made_at_unix_s };
        // Rounded once, it stays the same.
        ProfileFile::parse(&parsed.text()).unwrap()
    }

    fn error(text: &str) -> String {
        ProfileFile::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn profile_that_is_written_is_read_back_the_same() {
        let file = file(1_790_000_000);
        assert_eq!(ProfileFile::parse(&file.text()), Ok(file));
    }

    #[test]
    fn profile_of_the_greatest_face_fits_into_16_kib() {
        let mut file = file(u64::MAX >> 1);
        file.profile.neutral = Some(Neutral::from_points(&[[-2.9999; 3]; LANDMARKS]).unwrap());
        file.takes = Take::ALL.to_vec();
        file.profile.rest.iter_mut().for_each(|rest| *rest = -MAX_REST);
        assert!(file.text().len() <= MAX_PROFILE_BYTES, "{}", file.text().len());
    }

    #[test]
    fn file_that_is_cut_short_anywhere_is_refused() {
        let text = file(7).text();
        let cut = (0..text.len() - 1).step_by(97);
        assert!(cut.into_iter().all(|length| ProfileFile::parse(&text[..length]).is_err()));
        assert!(ProfileFile::parse(&text[..text.len() - 60]).is_err(), "the last line is missing");
    }

    #[test]
    fn foreign_and_absurd_files_are_refused_with_what_is_wrong() {
        let text = file(7).text();
        assert!(error(&text.replace("format = 1", "format = 2")).contains("format 2"));
        assert!(error("format = 9").contains("format 9"), "another layout is told by its number");
        assert!(error(&text.replace("gain = 1.2500", "gain = 99.0")).contains("blendshapes.eyeBlinkLeft"));
        assert!(error(&text.replace("rest = -0.2125", "rest = nan")).contains("blendshapes.eyeBlinkLeft"));
        assert!(error(&text.replacen("jawOpen", "jawOpem", 1)).contains("there is no jawOpen"));
        assert!(error(&text.replacen("neutral = [\n[", "neutral = [\n[9999", 1)).contains("face"));
        assert!(error(&text.replacen("neutral = [\n", "neutral = [\n[0,0,0],\n", 1)).contains("479 landmarks"));
        assert!(error(&text.replace("\"eyes-shut\"", "\"neutral\"")).contains("takes"));
        assert!(error(&text.replace("takes", "tekes")).contains("damaged"));
        assert!(error("\u{1b}[31m = 3").chars().all(|symbol| !symbol.is_control()));
        assert!(error(&" ".repeat(MAX_PROFILE_BYTES + 1)).contains("16 KiB"));
        let collapsed = Neutral::from_points(&[[0.5; 3]; LANDMARKS]).unwrap();
        let profile = Profile { neutral: Some(collapsed), ..Profile::default() };
        let flat = ProfileFile { profile, takes: Vec::new(), made_at_unix_s: 0 };
        assert!(error(&flat.text()).contains("the neutral face"));
    }
}
