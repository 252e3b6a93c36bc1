use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use std::{mem, process};

use facewire_library::{
    Method, NeutralMode, Options, Profile, Shaping, default_shaping, parse_profile, parse_shaping, profile_text,
    read_profile,
};
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
/// settings: the tables smoothing, plausibility and adjust of the service's settings as a text in TOML: filters, rules, and
///     gains, offsets and limits, for instance "smoothing.jaw_ms = 100\nadjust.jawOpen.gain = 1.5". `facewire defaults`
///     explains them. With stills=True or smoothing=False there is no filter to be set.
/// method: "network", or "paper" for the formulas of the paper, one for each coefficient, which are less accurate.
/// horizontal_fov_deg: angle of view of the camera, on which the position of the head depends.
/// focal_length_px: the focal length in pixels of the pictures, in place of the angle of view.
/// eye_distance_mm: the distance between the pupils, to which the position of the head is proportional.
/// model, networks: a blendshape model and a folder of networks in place of the built-in ones.
/// threads: how many threads compute the networks.
///
/// A tracker belongs to one thread at a time. Threads with a tracker each run at the same time. It also belongs to the process
/// that made it: in a child that this process forks, every call raises RuntimeError.
#[pyclass(frozen, module = "facewire")]
pub struct FaceTracker {
    state: Arc<Mutex<State>>,
    /// The process that made it.
    process: u32,
    begun: Instant,
    is_for_stills: bool,
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
        settings=None, method="network", horizontal_fov_deg=60.0, focal_length_px=None, eye_distance_mm=63.0, model=None, networks=None, threads=1))]
    #[expect(clippy::too_many_arguments, reason = "they have names in Python")]
    fn new(
        py: Python<'_>,
        max_faces: usize,
        stills: bool,
        smoothing: bool,
        neutral: Option<&str>,
        profile: Option<PathBuf>,
        mirror: bool,
        settings: Option<&str>,
        method: &str,
        horizontal_fov_deg: f32,
        focal_length_px: Option<f32>,
        eye_distance_mm: f32,
        model: Option<PathBuf>,
        networks: Option<PathBuf>,
        threads: u32,
    ) -> PyResult<Self> {
        let options = if stills { Options::for_stills() } else { Options::default() };
        let mut options = options
            .max_faces(max_faces)
            .threads(threads)
            .method(method_of(method)?)
            .horizontal_fov_deg(horizontal_fov_deg)
            .eye_distance_mm(eye_distance_mm)
            .smoothing(smoothing)
            .shaping(shaping(settings, mirror)?);
        if let Some(focal_length_px) = focal_length_px {
            options = options.focal_length_px(focal_length_px);
        }
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
            state: Arc::new(Mutex::new(State { tracker, memory: Vec::new(), times: Times::default() })),
            process: process::id(),
            begun: Instant::now(),
            is_for_stills: stills,
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
    /// profile, and remains after `reset`, until `set_profile(None)`. With max_faces above 1, the faces are those of one id,
    /// which is in the last picture, nobody else's neutral face changes, and `reset` forgets it.
    fn set_neutral(&self, faces: Vec<PyRef<'_, Face>>) -> PyResult<()> {
        let set = self.lock()?.tracker.set_neutral(faces.iter().map(|face| &face.found));
        set.map_err(|error| exception(&error))
    }

    /// Returns what is known of the first face, or of the face with this id in the last picture: the profile that was given, or the
    /// neutral face that was estimated, once the wearer is known well enough, which takes some seconds at rest. None until then.
    /// The text is that of a file by `facewire calibrate`, which the option profile and the service read. An id that is not in
    /// the last picture is a ValueError.
    #[pyo3(signature = (id=None))]
    fn profile(&self, id: Option<u64>) -> PyResult<Option<String>> {
        let tracker = &self.lock()?.tracker;
        if let Some(id) = id.filter(|id| tracker.faces().all(|face| face.id != *id)) {
            return Err(missing(id));
        }
        let known = id.map_or_else(|| tracker.profile(), |id| tracker.profile_of(id));
        Ok(known.as_ref().and_then(profile_text))
    }

    /// Replaces the profile of the first face, or of the face with this id in the last picture, by a text of `profile` or of a file
    /// by `facewire calibrate`. None takes the profile away. Coefficients do not jump. A profile of the first face remains
    /// after `reset`.
    #[pyo3(signature = (profile, id=None))]
    fn set_profile(&self, profile: Option<&str>, id: Option<u64>) -> PyResult<()> {
        let tracker = &mut self.lock()?.tracker;
        let profile = profile.map_or_else(|| Ok(Profile::default()), parse_profile);
        let profile = profile.map_err(|error| exception(&error))?;
        let Some(id) = id else {
            tracker.set_profile(&profile);
            return Ok(());
        };
        tracker.set_profile_of(id, &profile).then_some(()).ok_or_else(|| missing(id))
    }

    /// Forgets all faces, what was learned of them, the time of the last picture, and all profiles but that of the first face,
    /// which `set_profile(None)` takes away.
    fn reset(&self) -> PyResult<()> {
        let mut state = self.lock()?;
        state.tracker.reset();
        state.times = Times::default();
        Ok(())
    }

    /// Until the next `reset`, takes times to be in seconds, however far apart they are.
    fn _trust_times(&self) -> PyResult<()> {
        self.lock()?.times.trust();
        Ok(())
    }

    /// At the end of a `with`, the tracker forgets what `reset` forgets.
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
    fn lock(&self) -> PyResult<MutexGuard<'_, State>> {
        if self.is_of_parent() {
            let forked = "the process that made this tracker has forked; make a tracker in the child";
            return Err(PyRuntimeError::new_err(forked));
        }
        let in_use =
            |_| PyRuntimeError::new_err("another thread uses this tracker; give each thread a tracker of its own");
        self.state.try_lock().map_err(in_use)
    }

    fn is_of_parent(&self) -> bool {
        self.process != process::id()
    }
}

impl Drop for FaceTracker {
    /// Leaves a parent's tracker as it is: a thread of the parent may have been at work on it.
    fn drop(&mut self) {
        if self.is_of_parent() {
            mem::forget(Arc::clone(&self.state));
        }
    }
}

fn missing(id: u64) -> PyErr {
    PyValueError::new_err(format!("face {id} is not in the last picture"))
}

fn method_of(name: &str) -> PyResult<Method> {
    let found = Method::NAMES.iter().find(|(known, _)| *known == name);
    let unknown = || PyValueError::new_err(format!("method={name:?} is not known; give \"network\" or \"paper\""));
    found.map(|(_, method)| *method).ok_or_else(unknown)
}

/// What these options make of coefficients.
fn shaping(settings: Option<&str>, mirror: bool) -> PyResult<Shaping> {
    let shaping = settings.map_or_else(|| Ok(default_shaping()), parse_shaping);
    let mut shaping = shaping.map_err(|error| exception(&error))?;
    shaping.adjustments.mirror |= mirror;
    Ok(shaping)
}
