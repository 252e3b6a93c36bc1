use facewire_library::{BLENDSHAPES, NeutralFace};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray as _, PyArray1, PyArray2};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A face in a picture. Its arrays belong to it and can be kept and changed.
#[pyclass(frozen, module = "facewire")]
pub struct Face {
    pub found: facewire_library::Face,
    /// 478 points, x, y and z in pixels of the picture: an array of float32 with the shape (478, 3).
    #[pyo3(get)]
    landmarks: Py<PyArray2<f32>>,
    /// One number from 0 to 1 for each of BLENDSHAPES: an array of float32 with the shape (52,).
    #[pyo3(get)]
    coefficients: Py<PyArray1<f32>>,
}

impl Face {
    pub fn new(py: Python<'_>, found: facewire_library::Face) -> PyResult<Self> {
        let points = found.landmarks.0.as_flattened().to_vec();
        let points = Array2::from_shape_vec((found.landmarks.0.len(), 3), points);
        let points = points.map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))?;
        let coefficients = found.coefficients.to_vec().into_pyarray(py).unbind();
        Ok(Self { landmarks: points.into_pyarray(py).unbind(), coefficients, found })
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

    /// Rotation of the head as a unit quaternion x, y, z, w.
    #[getter]
    fn rotation_xyzw(&self) -> (f32, f32, f32, f32) {
        self.found.head.rotation_xyzw.into()
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
        match self.found.neutral {
            NeutralFace::Mean => "mean",
            NeutralFace::Estimated => "estimated",
            NeutralFace::Calibrated => "calibrated",
        }
    }

    /// How surely the network sees a face: its log-odds, about 25 for one in view. Below 15 the face is doubtful.
    #[getter]
    fn score(&self) -> f32 {
        self.found.score
    }

    fn __getitem__(&self, name: &str) -> PyResult<f32> {
        self.found.coefficient(name).ok_or_else(|| PyKeyError::new_err(name.to_owned()))
    }

    fn __repr__(&self) -> String {
        let [yaw, pitch, roll] = self.found.head.yaw_pitch_roll_deg();
        format!("<Face {}: yaw {yaw:.0}, pitch {pitch:.0}, roll {roll:.0} degrees>", self.found.id)
    }
}
