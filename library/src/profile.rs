//! What is known of a wearer: the file of `facewire calibrate`, or faces at rest.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;
use std::time::SystemTime;

use facewire_face::stages::{FaceMean, MAX_PROFILE_BYTES, ProfileFile, normalise};
use facewire_face::{Neutral, Profile, Wears};

use crate::{Error, Face};

/// Reads a profile that `facewire calibrate` made (`NAME.toml`).
pub fn read_profile(path: impl AsRef<Path>) -> Result<Profile, Error> {
    let path = path.as_ref();
    let wrong = |reason: String| Error::File(format!("{}: {reason}", path.display()));
    let mut text = String::new();
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    file.take(MAX_PROFILE_BYTES as u64 + 1).read_to_string(&mut text).map_err(|error| wrong(error.to_string()))?;
    parse(&text).map_err(wrong)
}

/// Reads the text of a profile, by [`profile_text`] or by `facewire calibrate`.
pub fn parse_profile(text: &str) -> Result<Profile, Error> {
    parse(text).map_err(|reason| Error::File(format!("the profile: {reason}")))
}

fn parse(text: &str) -> Result<Profile, String> {
    let profile = ProfileFile::<String>::parse(text)?.profile;
    if !profile.fits(Wears::Nothing) {
        let why =
            "it was made with a headset or a mask on, and can be used only by the service, with the same wearer.wears";
        return Err(why.to_owned());
    }
    Ok(profile)
}

/// Returns the text of a profile as `facewire calibrate` writes it, for [`parse_profile`], or for a file that [`read_profile`]
/// and the service read. `None` if the profile has no neutral face, or was made with a headset or a mask.
pub fn profile_text(profile: &Profile) -> Option<String> {
    profile.neutral.as_ref().filter(|_| profile.fits(Wears::Nothing))?;
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let takes = Vec::<String>::new();
    Some(ProfileFile { profile: profile.clone(), model: None, takes, made_at_unix_s: now.as_secs() }.text())
}

/// Returns the mean of faces at rest, which look at the camera: the neutral face of a [`Profile`]. Half a second of a film is
/// enough.
pub fn neutral_of<'a>(faces: impl IntoIterator<Item = &'a Face>) -> Result<Neutral, Error> {
    let mut mean = FaceMean::default();
    for face in faces {
        mean.add(&normalise(&face.landmarks)?);
    }
    Ok(mean.neutral()?)
}
