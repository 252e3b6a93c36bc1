use std::path::{Path, PathBuf};

use facewire_face::{
    Camera, EngineChoice, Filters, HeadPose, Method, Model, NeutralMode, Picture, Profile, Shaping, engine,
};

use crate::{Error, FaceTracker, default_shaping};

/// Most faces that a tracker follows.
const MAX_FACES: usize = 16;

/// How to follow faces. The default is what the service does with its default settings.
#[derive(Debug, Clone)]
#[must_use]
pub struct Options {
    pub(crate) max_faces: usize,
    pub(crate) stills: bool,
    pub(crate) lens: Lens,
    pub(crate) eye_distance_mm: f32,
    pub(crate) profile: Profile,
    pub(crate) shaping: Shaping,
    smoothing: bool,
    pub(crate) neutral: NeutralMode,
    networks: Option<PathBuf>,
    method: Method,
    model: Option<PathBuf>,
    threads: u32,
}

/// What is known of the camera's lens.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lens {
    /// Angle of view across the width of the camera's picture.
    fov_deg: f32,
    /// Focal length in pixels of the picture, which counts in place of the angle of view.
    focal_px: Option<f32>,
}

impl Lens {
    /// The camera that took a picture.
    pub fn camera(self, picture: &Picture) -> Camera {
        if let Some(focal_px) = self.focal_px {
            return Camera::of_focal_length(picture.size_px(), focal_px);
        }
        let camera = Camera::new(picture.size_px(), self.fov_deg);
        if picture.rotation().is_sideways() { camera.on_its_side() } else { camera }
    }

    fn check(self) -> Result<(), Error> {
        let is_length = self.focal_px.is_none_or(|focal_px| (10.0..=1e5).contains(&focal_px));
        need(is_length, "focal_length_px can be 10 to 100000")?;
        need((10.0..=170.0).contains(&self.fov_deg), "horizontal_fov_deg can be 10 to 170")
    }
}

fn need(is_good: bool, expected: &'static str) -> Result<(), Error> {
    if is_good { Ok(()) } else { Err(Error::Option(expected)) }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_faces: 1,
            stills: false,
            lens: Lens { fov_deg: 60.0, focal_px: None },
            eye_distance_mm: HeadPose::EYE_DISTANCE_MM,
            profile: Profile::default(),
            shaping: default_shaping(),
            smoothing: true,
            neutral: NeutralMode::Auto,
            networks: None,
            method: Method::Network,
            model: None,
            threads: 1,
        }
    }
}

impl Options {
    /// The options of single pictures that have nothing to do with each other: no filters, no history, and the neutral face is
    /// that of the profile, or the mean of many people.
    pub fn for_stills() -> Self {
        Self { stills: true, smoothing: false, neutral: NeutralMode::Off, ..Self::default() }
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

    /// Which of the built-in models solves the coefficients (default [`Method::Network`]).
    pub fn method(self, method: Method) -> Self {
        Self { method, ..self }
    }

    /// A blendshape model in place of the built-in one. The file brings its own method.
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
    /// [`parse_shaping`](crate::parse_shaping) reads them from a text.
    pub fn shaping(self, shaping: Shaping) -> Self {
        Self { shaping, ..self }
    }

    /// Whether coefficients and the head's pose are filtered (default true, but false for stills). Without smoothing,
    /// [`shaping`](Self::shaping) must set no filters of its own.
    pub fn smoothing(self, smoothing: bool) -> Self {
        Self { smoothing: smoothing && !self.stills, ..self }
    }

    /// Angle of view across the width of the camera's picture, degrees (default 60). The position of the head depends on it.
    pub fn horizontal_fov_deg(self, horizontal_fov_deg: f32) -> Self {
        Self { lens: Lens { fov_deg: horizontal_fov_deg, focal_px: None }, ..self }
    }

    /// Focal length in pixels of the pictures, in place of the angle of view. Pixels are square, and the optical axis goes through
    /// the middle of the picture.
    pub fn focal_length_px(self, focal_length_px: f32) -> Self {
        Self { lens: Lens { focal_px: Some(focal_length_px), ..self.lens }, ..self }
    }

    /// The distance between the pupils in millimetres (default 63), to which the position of the head is proportional.
    pub fn eye_distance_mm(self, eye_distance_mm: f32) -> Self {
        Self { eye_distance_mm, ..self }
    }

    /// Loads networks and model, and takes all memory.
    pub fn open(mut self) -> Result<FaceTracker, Error> {
        need((1..=MAX_FACES).contains(&self.max_faces), "max_faces can be 1 to 16")?;
        need((1..=16).contains(&self.threads), "threads can be 1 to 16")?;
        need((20.0..=200.0).contains(&self.eye_distance_mm), "eye_distance_mm can be 20 to 200")?;
        self.lens.check()?;
        if !self.smoothing {
            let has_none = [Filters::OFF, default_shaping().filters].contains(&self.shaping.filters);
            if !has_none {
                return Err(Error::UnusedFilters { stills: self.stills });
            }
            self.shaping.filters = Filters::OFF;
        }
        let model = match &self.model {
            None => Model::of(self.method),
            Some(_) if self.method != Method::Network => {
                return Err(Error::Option("give a method or a model: a file brings its own method"));
            }
            Some(path) => {
                let loaded = Model::load(path).map(Model::with_gaze);
                loaded.map_err(|error| Error::File(format!("{}: {error}", path.display())))?
            }
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
