use std::path::{Path, PathBuf};

use facewire_face::{EngineChoice, FilterKind, Filters, Group, Model, NeutralMode, Profile, Rules, Shaping, engine};

use crate::{Error, FaceTracker};

/// Most faces that a tracker follows.
const MAX_FACES: usize = 16;

/// How to follow faces. The default is what the service does with its default settings.
#[derive(Debug, Clone)]
#[must_use]
pub struct Options {
    pub(crate) max_faces: usize,
    pub(crate) stills: bool,
    pub(crate) horizontal_fov_deg: f32,
    pub(crate) profile: Profile,
    pub(crate) shaping: Shaping,
    pub(crate) neutral: NeutralMode,
    networks: Option<PathBuf>,
    model: Option<PathBuf>,
    threads: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_faces: 1,
            stills: false,
            horizontal_fov_deg: 60.0,
            profile: Profile::default(),
            shaping: default_shaping(),
            neutral: NeutralMode::Auto,
            networks: None,
            model: None,
            threads: 1,
        }
    }
}

/// The rules and filters of the service's default settings.
pub fn default_shaping() -> Shaping {
    let filter = |group: Group| {
        let time_s = match group {
            Group::Gaze => 0.1,
            Group::Jaw => 0.22,
            Group::Lids | Group::Brows | Group::Mouth | Group::Cheeks => 0.35,
        };
        group.filter(FilterKind::GatedAverage, time_s)
    };
    let mut shaping = Shaping::only(Filters::new(filter, FilterKind::GatedAverage, 0.35));
    shaping.rules = Rules::ALL;
    shaping
}

impl Options {
    /// The options of single pictures that have nothing to do with each other: no filters, no history, and the neutral face is
    /// that of the profile, or the mean of many people.
    pub fn for_stills() -> Self {
        let mut shaping = default_shaping();
        shaping.filters = Filters::OFF;
        Self { stills: true, shaping, neutral: NeutralMode::Off, ..Self::default() }
    }

    /// Follows up to 16 faces (default 1), each with a history of its own. Each takes the time and the memory of one; while a
    /// face is missing, every tenth picture is searched, which takes as long as to follow half a face.
    pub fn max_faces(self, max_faces: usize) -> Self {
        Self { max_faces, ..self }
    }

    /// The folder of the networks. Without it, they are those of the feature `built-in`; without that, those of the folder that
    /// `FACEWIRE_NETWORKS` names, of `facewire/networks` in the user's cache, or of the installed package.
    pub fn networks(self, folder: impl AsRef<Path>) -> Self {
        Self { networks: Some(folder.as_ref().to_owned()), ..self }
    }

    /// A blendshape model in place of the built-in one.
    pub fn model(self, file: impl AsRef<Path>) -> Self {
        Self { model: Some(file.as_ref().to_owned()), ..self }
    }

    /// Threads that compute the networks, the caller's among them (default 1).
    pub fn threads(self, threads: u32) -> Self {
        Self { threads, ..self }
    }

    /// What is known of the wearer ([`read_profile`](crate::read_profile), [`neutral_of`](crate::neutral_of)). With several
    /// faces, the wearer is the first face that is found, and [`FaceTracker::set_profile_of`] gives a profile to another one.
    pub fn profile(self, profile: Profile) -> Self {
        Self { profile, ..self }
    }

    /// Whether the neutral face of a wearer without a profile is estimated (default [`NeutralMode::Auto`]).
    pub fn neutral(self, neutral: NeutralMode) -> Self {
        Self { neutral, ..self }
    }

    /// Rules of anatomy, filters, and adjustments of the output such as a mirror image (default [`default_shaping`]).
    pub fn shaping(self, shaping: Shaping) -> Self {
        Self { shaping, ..self }
    }

    /// Angle of view across the width of the picture, degrees (default 60). The position of the head depends on it.
    pub fn horizontal_fov_deg(self, horizontal_fov_deg: f32) -> Self {
        Self { horizontal_fov_deg, ..self }
    }

    /// Loads networks and model, and takes all memory.
    pub fn open(self) -> Result<FaceTracker, Error> {
        let need = |is_good: bool, expected| if is_good { Ok(()) } else { Err(Error::Option(expected)) };
        need((1..=MAX_FACES).contains(&self.max_faces), "max_faces can be 1 to 16")?;
        need((1..=16).contains(&self.threads), "threads can be 1 to 16")?;
        need((10.0..=170.0).contains(&self.horizontal_fov_deg), "horizontal_fov_deg can be 10 to 170")?;
        let model = match &self.model {
            None => Model::embedded(),
            Some(path) => Model::load(path).map_err(|error| Error::File(format!("{}: {error}", path.display())))?,
        };
        let engine = match &self.networks {
            #[cfg(feature = "built-in")]
            None => Box::new(crate::networks::BuiltIn::new(self.threads)?),
            #[cfg(not(feature = "built-in"))]
            None => engine(EngineChoice::Native, "", self.threads)?,
            Some(folder) => engine(EngineChoice::Native, folder, self.threads)?,
        };
        FaceTracker::load(&self, engine.as_ref(), model)
    }
}
