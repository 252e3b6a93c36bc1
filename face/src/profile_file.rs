//! A wearer's profile as a text that people can read and compare (TOML).

use std::{collections::BTreeMap, fmt::Write as _};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{BLENDSHAPES, COEFFS, GAINS, LANDMARKS, MAX_REST, Neutral, Profile, Wears};

const FORMAT: i64 = 1;
/// Most bytes of the text.
pub const MAX_PROFILE_BYTES: usize = 16 << 10;
const STEPS: f32 = 10_000.0;
/// Greatest coordinate in a text, steps. Faces stay below 3 eye distances.
const MAX_STEPS: f32 = 50_000.0;

/// What the text holds: a profile, and how a calibration by the takes `T` made it.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileFile<T> {
    /// What is known of the wearer.
    pub profile: Profile,
    /// The hash of the model that read the takes. Older files do not have it.
    pub model: Option<u32>,
    /// The takes, each once.
    pub takes: Vec<T>,
    /// When it was made, seconds since 1970.
    pub made_at_unix_s: u64,
}

/// A later version may add keys, and another program may leave out those that are there for people.
#[derive(Deserialize)]
struct Table<T> {
    #[serde(default)]
    made_at_unix_s: u64,
    model: Option<String>,
    /// One of the names of [`Wears::NAMES`]; absent for a bare face.
    wears: Option<String>,
    #[serde(default = "Vec::new")]
    takes: Vec<T>,
    neutral: Vec<[i32; 3]>,
    blendshapes: BTreeMap<String, Terms>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Terms {
    rest: f32,
    gain: f32,
}

impl<T: Serialize + DeserializeOwned + PartialEq> ProfileFile<T> {
    /// Reads a text, or says in one sentence why it is no profile.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.len() > MAX_PROFILE_BYTES {
            return Err(format!("it is larger than {} KiB, and so no profile", MAX_PROFILE_BYTES >> 10));
        }
        let damaged = |error: toml::de::Error| format!("it is damaged: {}", one_line(error.message()));
        let table: toml::Table = text.parse().map_err(damaged)?;
        match table.get("format").and_then(toml::Value::as_integer) {
            Some(FORMAT) => {}
            Some(format) => return Err(format!("it has format {format}, and this facewire reads format {FORMAT}")),
            None => return Err("it is damaged: it has no format".to_owned()),
        }
        let table: Table<T> = table.try_into().map_err(damaged)?;
        table.read().map_err(|error| format!("it is damaged: {error}"))
    }

    /// The text that [`ProfileFile::parse`] reads. Coordinates are rounded.
    pub fn text(&self) -> String {
        let mut text = String::with_capacity(MAX_PROFILE_BYTES);
        let takes: Vec<_> = self.takes.iter().filter_map(|take| toml::Value::try_from(take).ok()).collect();
        let takes: Vec<_> = takes.iter().map(toml::Value::to_string).collect();
        let _ = writeln!(text, "format = {FORMAT}\nmade_by = \"facewire {}\"", env!("CARGO_PKG_VERSION"));
        let _ = writeln!(text, "made_at_unix_s = {}", self.made_at_unix_s);
        if let Some(model) = self.model {
            let _ = writeln!(text, "model = \"{model:08x}\"");
        }
        if self.profile.wears != Wears::Nothing {
            let _ = writeln!(text, "wears = \"{}\"", self.profile.wears.name());
        }
        let _ = writeln!(text, "takes = [{}]\n", takes.join(", "));
        text.push_str("# x, y, z of the landmarks, in ten-thousandths of the distance of the eyes\nneutral = [\n");
        #[expect(clippy::cast_possible_truncation, reason = "the greatest coordinate is an i32")]
        let steps = |value: f32| (value * STEPS).round().clamp(-MAX_STEPS, MAX_STEPS) as i32;
        for [x, y, z] in self.profile.neutral.iter().flat_map(Neutral::points) {
            let _ = writeln!(text, "[{},{},{}],", steps(x), steps(y), steps(z));
        }
        text.push_str("]\n\n[blendshapes]\n");
        for (name, (rest, gain)) in BLENDSHAPES.iter().zip(self.profile.rest.iter().zip(&self.profile.gain)) {
            let _ = writeln!(text, "{name} = {{ rest = {rest:.4}, gain = {gain:.4} }}");
        }
        text
    }
}

impl<T: PartialEq> Table<T> {
    fn read(self) -> Result<ProfileFile<T>, String> {
        let need = |is_good: bool, error: String| is_good.then_some(()).ok_or(error);
        let absurd = |what: &str| format!("{what} has a value that no face has");
        let is_once = |take: &T| self.takes.iter().filter(|other| *other == take).count() == 1;
        need(self.takes.iter().all(is_once), "the takes name one twice".to_owned())?;
        let landmarks = self.neutral.len();
        let blendshapes = self.blendshapes.len();
        need(landmarks == LANDMARKS, format!("it has {landmarks} landmarks instead of {LANDMARKS}"))?;
        need(blendshapes == COEFFS, format!("it has {blendshapes} blendshapes instead of {COEFFS}"))?;
        let mut points = [[0.0; 3]; LANDMARKS];
        for (index, (point, steps)) in points.iter_mut().zip(&self.neutral).enumerate() {
            need(steps.iter().all(|steps| (*steps as f32).abs() <= MAX_STEPS), absurd(&format!("landmark {index}")))?;
            *point = steps.map(|steps| steps as f32 / STEPS);
        }
        let neutral = Neutral::of_face(&points).map_err(|_| absurd("the neutral face"))?;
        let mut profile = Profile::from(neutral);
        if let Some(name) = &self.wears {
            let known = Wears::NAMES.iter().find(|(known, _)| known == name);
            let names = || Wears::NAMES.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
            (_, profile.wears) = *known.ok_or_else(|| format!("wears is none of {}", names()))?;
        }
        for (name, (rest, gain)) in BLENDSHAPES.iter().zip(profile.rest.iter_mut().zip(&mut profile.gain)) {
            let terms = self.blendshapes.get(*name).ok_or_else(|| format!("there is no {name}"))?;
            let is_sane = terms.rest.abs() <= MAX_REST && (GAINS[0]..=GAINS[1]).contains(&terms.gain);
            need(is_sane, absurd(&format!("blendshapes.{name}")))?;
            *rest = terms.rest;
            *gain = terms.gain;
        }
        let hash = |text: String| u32::from_str_radix(&text, 16).map_err(|_| "model is no hash".to_owned());
        let model = self.model.map(hash).transpose()?;
        Ok(ProfileFile { profile, model, takes: self.takes, made_at_unix_s: self.made_at_unix_s })
    }
}

/// The message without line ends and terminal escape sequences, which a damaged file may contain.
fn one_line(message: &str) -> String {
    message.chars().map(|symbol| if symbol.is_control() { ' ' } else { symbol }).take(200).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stages::normalise;
    use crate::testing::face;

    type ProfileFile = super::ProfileFile<String>;

    /// A profile of a face of few points, which was made at this time.
    fn file(made_at_unix_s: u64) -> ProfileFile {
        let face = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap();
        let neutral = Some(Neutral::from_points(&face.points).unwrap());
        let profile = Profile { neutral, rest: [-0.2125; COEFFS], gain: [1.25; COEFFS], wears: Wears::Nothing };
        let takes = ["neutral", "eyes-shut"].map(str::to_owned).to_vec();
        let parsed = ProfileFile { profile, model: Some(0xA1), takes, made_at_unix_s };
        // Rounded once, it stays the same.
        ProfileFile::parse(&parsed.text()).unwrap()
    }

    #[test]
    fn profile_is_read_back_the_same_also_without_a_model_as_older_ones_and_the_greatest_fits_into_16_kib() {
        let file = file(1_790_000_000);
        let text = file.text();
        assert_eq!(ProfileFile::parse(&text), Ok(file.clone()));
        let old = text.replace("model = \"000000a1\"\n", "");
        assert_eq!(ProfileFile::parse(&old), Ok(ProfileFile { model: None, ..file }));
        let mut greatest = self::file(u64::MAX >> 1);
        greatest.profile.neutral = Some(Neutral::from_points(&[[-2.9999; 3]; LANDMARKS]).unwrap());
        greatest.takes = (0..11).map(|number| format!("take-of-a-pose-{number}")).collect();
        greatest.profile.rest = [-MAX_REST; COEFFS];
        assert!(greatest.text().len() <= 16 << 10, "{}", greatest.text().len());
    }

    #[test]
    fn a_profile_says_what_was_on_the_face_unless_that_was_nothing_and_another_word_is_refused() {
        for (wears, line) in [(Wears::Headset, "wears = \"headset\"\n"), (Wears::Mask, "wears = \"mask\"\n")] {
            let mut file = file(7);
            file.profile.wears = wears;
            assert!(file.text().contains(line));
            assert_eq!(ProfileFile::parse(&file.text()).unwrap().profile.wears, wears);
        }
        let bare = file(7).text();
        assert!(!bare.contains("wears"));
        let hat = ProfileFile::parse(&bare.replace("takes = ", "wears = \"hat\"\ntakes = "));
        assert!(hat.unwrap_err().contains("wears"));
    }

    #[test]
    fn keys_of_later_versions_are_left_out_and_those_for_people_may_be_missing() {
        let file = file(7);
        let later = format!("light = \"window\"\n{}", file.text());
        assert_eq!(ProfileFile::parse(&later), Ok(file.clone()));
        let (head, rest) = later.split_once("takes = ").unwrap();
        assert!(head.contains("made_by") && head.contains("made_at_unix_s"));
        let (_, points) = rest.split_once('\n').unwrap();
        let bare = ProfileFile { model: None, takes: Vec::new(), made_at_unix_s: 0, ..file };
        assert_eq!(ProfileFile::parse(&format!("format = 1\n{points}")), Ok(bare));
    }

    #[test]
    fn damaged_foreign_and_absurd_files_are_refused_with_what_is_wrong() {
        let text = file(7).text();
        assert!((0..text.len() - 1).step_by(97).all(|length| ProfileFile::parse(&text[..length]).is_err()));
        let mut flat = file(7);
        flat.profile.neutral = Some(Neutral::from_points(&[[0.5; 3]; LANDMARKS]).unwrap());
        let cases = [
            (text.replace("format = 1", "format = 2"), "format 2"),
            (text.replace("format = 1\n", ""), "no format"),
            (text.replace("gain = 1.2500", "gain = 99.0"), "blendshapes.eyeBlinkLeft"),
            (text.replace("rest = -0.2125", "rest = nan"), "blendshapes.eyeBlinkLeft"),
            (text.replacen("jawOpen", "jawOpem", 1), "there is no jawOpen"),
            (text.replacen("neutral = [\n[", "neutral = [\n[9999", 1), "landmark 0"),
            (text.replacen("neutral = [\n", "neutral = [\n[0,0,0],\n", 1), "479 landmarks"),
            (text.replace("\"eyes-shut\"", "\"neutral\""), "takes"),
            (" ".repeat((16 << 10) + 1), "16 KiB"),
            (flat.text(), "the neutral face"),
            ("\u{1b}[31m = 3".to_owned(), "damaged"),
        ];
        for (text, want) in cases {
            let error = ProfileFile::parse(&text).unwrap_err();
            assert!(error.contains(want) && error.chars().all(|symbol| !symbol.is_control()), "{want}: {error}");
        }
    }
}
