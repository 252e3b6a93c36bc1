use std::path::PathBuf;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use facewire_library::{Filters, NeutralMode, Options, Profile, default_shaping, neutral_of, read_profile};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::exception;
use crate::face::Face;
use crate::frame::Frame;
use crate::times::Times;

/// Follows faces from picture to picture.
///
/// max_faces: how many faces are followed, 1 to 16.
/// stills: whether the pictures have nothing to do with each other: no filters, no history.
/// smoothing: whether coefficients and head pose are filtered.
/// neutral: what is done about the neutral face of a wearer without a profile: "auto" estimates it, "off" takes the mean of
///     many people.
/// profile: a file by `facewire calibrate`. With several faces, it is that of the first face that is found.
/// mirror: whether left and right are swapped in the result.
/// horizontal_fov_deg: angle of view of the camera, on which the position of the head depends.
/// model, networks: a blendshape model and a folder of networks in place of the built-in ones.
/// threads: how many threads compute the networks.
///
/// A tracker belongs to one thread at a time. Threads with a tracker each run at the same time.
#[pyclass(frozen, module = "facewire")]
pub struct FaceTracker {
    state: Mutex<State>,
    begun: Instant,
    is_for_stills: bool,
    is_for_one: bool,
}

/// The folder of the networks in the installed package. In the extension module they would stay in memory after loading.
fn networks_of_package(py: Python<'_>) -> PyResult<PathBuf> {
    let file: PathBuf = py.import("facewire")?.getattr("__file__")?.extract()?;
    Ok(file.with_file_name("networks"))
}

struct State {
    tracker: facewire_library::FaceTracker,
    /// Samples of an array that do not lie one after another.
    memory: Vec<u8>,
    times: Times,
}

#[pymethods]
impl FaceTracker {
    #[new]
    #[pyo3(signature = (*, max_faces=1, stills=false, smoothing=true, neutral=None, profile=None, mirror=false,
        horizontal_fov_deg=60.0, model=None, networks=None, threads=1))]
    #[expect(clippy::too_many_arguments, reason = "they have names in Python")]
    fn new(
        py: Python<'_>,
        max_faces: usize,
        stills: bool,
        smoothing: bool,
        neutral: Option<&str>,
        profile: Option<PathBuf>,
        mirror: bool,
        horizontal_fov_deg: f32,
        model: Option<PathBuf>,
        networks: Option<PathBuf>,
        threads: u32,
    ) -> PyResult<Self> {
        let options = if stills { Options::for_stills() } else { Options::default() };
        let mut shaping = default_shaping();
        shaping.adjustments.mirror = mirror;
        if stills || !smoothing {
            shaping.filters = Filters::OFF;
        }
        let mut options =
            options.max_faces(max_faces).threads(threads).horizontal_fov_deg(horizontal_fov_deg).shaping(shaping);
        options = match neutral {
            None => options,
            Some("auto") => options.neutral(NeutralMode::Auto),
            Some("off") => options.neutral(NeutralMode::Off),
            Some(_) => return Err(PyValueError::new_err("neutral can be \"auto\" or \"off\"")),
        };
        if let Some(path) = profile {
            options = options.profile(read_profile(path).map_err(|error| exception(&error))?);
        }
        if let Some(path) = model {
            options = options.model(path);
        }
        options = options.networks(networks.map_or_else(|| networks_of_package(py), Ok)?);
        let tracker = py.detach(|| options.open()).map_err(|error| exception(&error))?;
        Ok(Self {
            state: Mutex::new(State { tracker, memory: Vec::new(), times: Times::default() }),
            begun: Instant::now(),
            is_for_stills: stills,
            is_for_one: max_faces == 1,
        })
    }

    /// Returns the face in a picture, or None if there is none.
    ///
    /// frame: an array of uint8 (rows x columns x 3 in the order of OpenCV), or a picture of Pillow, which is turned as its
    ///     EXIF orientation says. Landmarks are in pixels of the turned picture.
    /// time_s: when it was taken, seconds since any moment that stays the same. Without it, now, which is right for a camera
    ///     whose pictures are processed as they come, and wrong for a video: smoothing depends on the time between pictures.
    ///     Give it for all pictures or for none. Times must not go back; call `reset` before another video. Of stills, it is
    ///     not read.
    /// format: what the array holds: bgr, rgb, bgra, rgba, grey, yuyv, nv12, i420, i422 or i444, in
    ///     lower or upper case.
    ///
    /// Do not change the array in another thread meanwhile.
    #[pyo3(signature = (frame, time_s=None, *, format=None))]
    fn process(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        time_s: Option<f64>,
        format: Option<&str>,
    ) -> PyResult<Option<Face>> {
        Ok(self.process_all(py, frame, time_s, format)?.into_iter().next())
    }

    /// Returns all faces in a picture, like `process`. The one that has been followed longest comes first.
    #[pyo3(signature = (frame, time_s=None, *, format=None))]
    fn process_all(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        time_s: Option<f64>,
        format: Option<&str>,
    ) -> PyResult<Vec<Face>> {
        let now = self.begun.elapsed();
        let frame = Frame::new(frame, format)?;
        let State { tracker, memory, times } = &mut *self.lock()?;
        let samples = frame.samples(memory);
        let picture = frame.picture(samples).map_err(|error| exception(&error))?;
        let time = if self.is_for_stills { Duration::ZERO } else { times.next(time_s, now)? };
        let found = py.detach(|| Ok(tracker.process_all(&picture, time)?.cloned().collect::<Vec<_>>()));
        let mut found = found.map_err(|error| exception(&error))?;
        found.sort_by_key(|face| face.id);
        found.into_iter().map(|face| Face::new(py, face)).collect()
    }

    /// Makes the mean of these faces the neutral face of the wearer, who looks at the camera, at rest. This replaces the
    /// profile. With max_faces above 1, the faces are those of one id, which is in the last picture, and nobody else's neutral
    /// face changes.
    fn set_neutral(&self, faces: Vec<PyRef<'_, Face>>) -> PyResult<()> {
        let neutral = neutral_of(faces.iter().map(|face| &face.found)).map_err(|error| exception(&error))?;
        let profile = Profile::from(neutral);
        let tracker = &mut self.lock()?.tracker;
        if self.is_for_one {
            tracker.set_profile(&profile);
            return Ok(());
        }
        let id = faces.first().map_or(0, |face| face.found.id);
        if faces.iter().any(|face| face.found.id != id) {
            return Err(PyValueError::new_err("these faces have different ids; give those of one id"));
        }
        if !tracker.set_profile_of(id, &profile) {
            let message = format!(
                "face {id} is not in the last picture; give faces that have the id of one that is. With stills=True and \
                 several faces, no neutral face is kept"
            );
            return Err(PyValueError::new_err(message));
        }
        Ok(())
    }

    /// Forgets all faces, what was learned of them, and the time of the last picture.
    fn reset(&self) -> PyResult<()> {
        let mut state = self.lock()?;
        state.tracker.reset();
        state.times = Times::default();
        Ok(())
    }

    /// Until the next `reset`, times are in seconds beyond doubt, however far apart they are.
    fn _trust_times(&self) -> PyResult<()> {
        self.lock()?.times.trust();
        Ok(())
    }

    /// At the end of a `with`, the tracker forgets everything, as by `reset`.
    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_error))]
    fn __exit__(&self, _error: &Bound<'_, PyTuple>) -> PyResult<()> {
        self.reset()
    }
}

impl FaceTracker {
    /// A lock that waits would keep the interpreter from the thread that has it.
    fn lock(&self) -> PyResult<std::sync::MutexGuard<'_, State>> {
        let in_use =
            |_| PyRuntimeError::new_err("another thread uses this tracker; give each thread a tracker of its own");
        self.state.try_lock().map_err(in_use)
    }
}
