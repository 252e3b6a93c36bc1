//! The extension module of the Python package facewire: NumPy arrays go in, and faces with arrays come out.
//!
//! A C-contiguous array is read in place; another one is copied first, into memory that the tracker keeps. The interpreter is
//! free for other threads while a picture is processed. Results own their memory, which NumPy frees.

mod face;
mod frame;
mod times;
mod tracker;

use facewire_library::{BLENDSHAPES, Error};
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

create_exception!(
    facewire,
    FacewireError,
    PyException,
    "What facewire cannot do: a file is missing or damaged, or a network failed."
);

/// The exception for an error: what the caller gave wrongly is a `ValueError`.
fn exception(error: &Error) -> PyErr {
    match error {
        Error::UnusedFilters { stills } => {
            let parameter = if *stills { "stills=True" } else { "smoothing=False" };
            let sentence = "the settings configure filters in [smoothing], but";
            PyValueError::new_err(format!("{sentence} {parameter} switches all filters off"))
        }
        Error::Picture(_) | Error::Option(_) | Error::Settings(_) | Error::Face(_) | Error::Neutral(_) => {
            PyValueError::new_err(error.to_string())
        }
        _ => FacewireError::new_err(error.to_string()),
    }
}

#[pymodule(gil_used = true)]
fn _facewire(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<face::Face>()?;
    module.add_class::<tracker::FaceTracker>()?;
    module.add_function(wrap_pyfunction!(face::_face, module)?)?;
    module.add("FacewireError", module.py().get_type::<FacewireError>())?;
    module.add("BLENDSHAPES", PyTuple::new(module.py(), BLENDSHAPES)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
