use facewire_library::{BLENDSHAPES, NeutralFace, Visibility};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray as _, PyArray, PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::IntoPyObjectExt as _;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator, PyTuple};

/// A face in a picture, which does not change.
///
/// It is also a mapping from the names of BLENDSHAPES to the coefficients: face["jawOpen"], dict(face). Two faces are equal if
/// all their values are, the id and the landmarks among them. A face can be copied and pickled.
#[pyclass(frozen, mapping, module = "facewire")]
pub struct Face {
    pub found: facewire_library::Face,
    /// 478 points, x, y and z in pixels of the picture: an array of float32 with the shape (478, 3), which cannot be written.
    #[pyo3(get)]
    landmarks: Py<PyArray2<f32>>,
    /// One number from 0 to 1 for each of BLENDSHAPES: an array of float32 with the shape (52,), which cannot be written.
    #[pyo3(get)]
    coefficients: Py<PyArray1<f32>>,
}

impl Face {
    pub fn new(py: Python<'_>, found: facewire_library::Face) -> PyResult<Self> {
        let points = found.landmarks.0.as_flattened().to_vec();
        let points = Array2::from_shape_vec((found.landmarks.0.len(), 3), points);
        let points = points.map_err(|error| PyValueError::new_err(error.to_string()))?;
        let coefficients = found.coefficients.to_vec().into_pyarray(py);
        Ok(Self { landmarks: read_only(points.into_pyarray(py)), coefficients: read_only(coefficients), found })
    }
}

/// Makes an array one that cannot be written.
fn read_only<D: numpy::ndarray::Dimension>(array: Bound<'_, PyArray<f32, D>>) -> Py<PyArray<f32, D>> {
    array.readwrite().make_nonwriteable();
    array.unbind()
}

/// Makes the face again that was pickled.
#[pyfunction]
#[pyo3(signature = (
    id, landmarks, coefficients, rotation_xyzw, position_mm, gaze_yaw_pitch_vergence_deg, neutral, score,
    visibility = Visibility::WHOLE.values(),
))]
#[expect(clippy::too_many_arguments, reason = "a face has as many values")]
pub fn _face(
    py: Python<'_>,
    id: u64,
    landmarks: PyReadonlyArray2<'_, f32>,
    coefficients: PyReadonlyArray1<'_, f32>,
    rotation_xyzw: [f32; 4],
    position_mm: [f32; 3],
    gaze_yaw_pitch_vergence_deg: [f32; 3],
    neutral: &str,
    score: f32,
    visibility: [f32; 6],
) -> PyResult<Face> {
    let damaged = || PyValueError::new_err("the pickled face is damaged");
    let points: Vec<f32> = landmarks.as_array().iter().copied().collect();
    let values: Vec<f32> = coefficients.as_array().iter().copied().collect();
    let neutral = NEUTRAL_FACES.into_iter().find(|known| known.name() == neutral);
    let [yaw, pitch, vergence_deg] = gaze_yaw_pitch_vergence_deg;
    let mut found = facewire_library::Face::default();
    found.id = id;
    found.landmarks.0 = points.as_chunks().0.try_into().map_err(|_| damaged())?;
    found.coefficients = values.try_into().map_err(|_| damaged())?;
    found.head.rotation_xyzw = rotation_xyzw;
    found.head.position_mm = position_mm;
    found.gaze.yaw_pitch_deg = [yaw, pitch];
    found.gaze.vergence_deg = vergence_deg;
    found.neutral = neutral.ok_or_else(damaged)?;
    found.score = score;
    found.visibility = Visibility::from_values(visibility);
    Face::new(py, found)
}

const NEUTRAL_FACES: [NeutralFace; 3] = [NeutralFace::Mean, NeutralFace::Estimated, NeutralFace::Calibrated];

/// What is wrong with the name of a coefficient, with the nearest of the right ones.
fn unknown_name(py: Python<'_>, name: &str) -> PyResult<PyErr> {
    let plain = |name: &str| name.replace(['_', '-', ' '], "").to_lowercase();
    let known: Vec<_> = BLENDSHAPES.iter().map(|known| plain(known)).collect();
    let nearest: Vec<String> =
        py.import("difflib")?.call_method1("get_close_matches", (plain(name), &known, 1))?.extract()?;
    let nearest = BLENDSHAPES.iter().zip(&known).find(|(_, known)| nearest.contains(known));
    let hint = nearest.map_or_else(
        || "facewire.BLENDSHAPES has all names".to_owned(),
        |(nearest, _)| format!("did you mean {nearest}?"),
    );
    Ok(PyKeyError::new_err(format!("{name} is not a blendshape; {hint}")))
}

impl Face {
    fn coefficient(&self, name: &Bound<'_, PyAny>) -> Option<f32> {
        self.found.coefficient(&name.extract::<String>().ok()?)
    }
}

#[pymethods]
impl Face {
    /// Stays the same while a face is followed.
    #[getter]
    fn id(&self) -> u64 {
        self.found.id
    }

    /// The coefficients as a dictionary with the names of BLENDSHAPES.
    #[getter]
    fn blendshapes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dictionary = PyDict::new(py);
        for (name, value) in BLENDSHAPES.iter().zip(self.found.coefficients) {
            dictionary.set_item(name, value)?;
        }
        Ok(dictionary)
    }

    /// Turn of the head to its left, up, and towards its right shoulder, degrees.
    #[getter]
    fn yaw_pitch_roll_deg(&self) -> (f32, f32, f32) {
        self.found.head.yaw_pitch_roll_deg().into()
    }

    /// Rotation of the head as a unit quaternion x, y, z, w. Its yaw is 0.9 of that which the landmarks show.
    #[getter]
    fn rotation_xyzw(&self) -> (f32, f32, f32, f32) {
        self.found.head.rotation_xyzw.into()
    }

    /// The rotation that the landmarks show, for what is drawn over the face: a turned face also moves sideways, because a head
    /// turns about its neck, and therefore seems to turn further than the head does.
    #[getter]
    fn apparent_rotation_xyzw(&self) -> (f32, f32, f32, f32) {
        self.found.head.apparent_rotation_xyzw().into()
    }

    /// Position of the point between the eyes from the camera: x to the right of the picture, y down, z away.
    #[getter]
    fn position_mm(&self) -> (f32, f32, f32) {
        self.found.head.position_mm.into()
    }

    /// Where both eyes look, in the axes of the head: to its left and up, degrees.
    #[getter]
    fn gaze_yaw_pitch_deg(&self) -> (f32, f32) {
        self.found.gaze.yaw_pitch_deg.into()
    }

    /// The neutral face from which the coefficients are measured: "mean", "estimated" or "calibrated".
    #[getter]
    fn neutral(&self) -> &'static str {
        self.found.neutral.name()
    }

    /// How much of each part of the face is in view, from 0 (covered) to 1: a dictionary with the keys "left_eye", "right_eye",
    /// "brows", "mouth", "cheeks" and "face". The coefficients of what is covered are a guess.
    #[getter]
    fn visibility<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dictionary = PyDict::new(py);
        for (part, value) in self.found.visibility.parts() {
            dictionary.set_item(part, value)?;
        }
        Ok(dictionary)
    }

    /// How surely the network sees a face: its log-odds, about 25 for one in view. Below 15 the face is doubtful.
    #[getter]
    fn score(&self) -> f32 {
        self.found.score
    }

    /// The smallest upright rectangle around the landmarks, in pixels of the picture: left, top, right and bottom.
    #[getter]
    fn box_px(&self) -> (f32, f32, f32, f32) {
        self.found.box_px().into()
    }

    fn __getitem__(&self, name: &Bound<'_, PyAny>) -> PyResult<f32> {
        match self.coefficient(name) {
            Some(value) => Ok(value),
            None => Err(unknown_name(name.py(), &name.str()?.to_string_lossy())?),
        }
    }

    /// Returns the coefficient of this name, or `default` if there is none.
    #[pyo3(signature = (name, default=None))]
    fn get<'py>(&self, name: &Bound<'py, PyAny>, default: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        match self.coefficient(name) {
            Some(value) => value.into_bound_py_any(name.py()),
            None => default.into_bound_py_any(name.py()),
        }
    }

    fn __contains__(&self, name: &Bound<'_, PyAny>) -> bool {
        self.coefficient(name).is_some()
    }

    fn __len__(&self) -> usize {
        self.found.coefficients.len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyTuple::new(py, BLENDSHAPES)?.try_iter()
    }

    /// The names of BLENDSHAPES.
    fn keys<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.blendshapes(py)?.call_method0("keys")
    }

    /// The coefficients.
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.blendshapes(py)?.call_method0("values")
    }

    /// The names of BLENDSHAPES with their coefficients.
    fn items<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.blendshapes(py)?.call_method0("items")
    }

    fn __eq__<'py>(&self, other: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        match other.cast::<Self>() {
            Ok(other) => (self.found == other.get().found).into_bound_py_any(other.py()),
            Err(_) => Ok(other.py().NotImplemented().into_bound(other.py())),
        }
    }

    fn __hash__(&self) -> u64 {
        self.found.id
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let found = &self.found;
        let [yaw, pitch] = found.gaze.yaw_pitch_deg;
        let values = (
            found.id,
            &self.landmarks,
            &self.coefficients,
            self.rotation_xyzw(),
            self.position_mm(),
            (yaw, pitch, found.gaze.vergence_deg),
            self.neutral(),
            found.score,
            found.visibility.values(),
        );
        Ok((py.import("facewire._facewire")?.getattr("_face")?, values.into_pyobject(py)?))
    }

    fn __repr__(&self) -> String {
        let [yaw, pitch, roll] = self.found.head.yaw_pitch_roll_deg();
        format!("<Face {}: yaw {yaw:.0}, pitch {pitch:.0}, roll {roll:.0} degrees>", self.found.id)
    }
}
