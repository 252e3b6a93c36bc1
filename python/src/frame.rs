//! From a NumPy array or a picture of Pillow to a [`Picture`].

use facewire_library::{Format, MAX_SIDE_PX, Picture};
use numpy::ndarray::{ArrayViewD, Axis};
use numpy::{PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods as _};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// An array of samples, and what they are.
pub struct Frame<'py> {
    array: PyReadonlyArrayDyn<'py, u8>,
    format: Format,
    size: [usize; 2],
}

impl<'py> Frame<'py> {
    /// Reads an array, or whatever Pillow opened. Without the name of a format, an array has the order of OpenCV, and a picture
    /// that of Pillow.
    pub fn new(given: &Bound<'py, PyAny>, name: Option<&str>) -> PyResult<Self> {
        if given.cast::<PyUntypedArray>().is_err() && given.hasattr("mode")? && given.hasattr("convert")? {
            let mode: String = given.getattr("mode")?.extract()?;
            let is_known = ["RGB", "RGBA", "L"].contains(&mode.as_str());
            let picture = if is_known { given.clone() } else { given.call_method1("convert", ("RGB",))? };
            let array = given.py().import("numpy")?.call_method1("asarray", (picture,))?;
            return Self::of_array(&array, Some(name.unwrap_or("rgb")));
        }
        Self::of_array(given, name)
    }

    fn of_array(given: &Bound<'py, PyAny>, name: Option<&str>) -> PyResult<Self> {
        let Ok(array) = given.cast::<PyArrayDyn<u8>>() else {
            let told = match given.cast::<PyUntypedArray>() {
                Ok(array) => format!("an array of {}", array.dtype()),
                Err(_) => given.get_type().name()?.to_string(),
            };
            return Err(PyTypeError::new_err(format!(
                "give a NumPy array of uint8 or a picture of Pillow, not {told}"
            )));
        };
        let wrong = || {
            PyValueError::new_err(format!(
                "an array of shape {:?} is no picture in the format {:?}; give rows x columns x 3 or 4 (bgr, rgb), rows x columns \
                 (grey), rows x columns x 2 (yuyv), or planes below each other: 3/2 rows x columns (i420, nv12), 2 rows x \
                 columns (i422), 3 rows x columns (i444)",
                array.shape(),
                name.unwrap_or("bgr")
            ))
        };
        let (format, size) = describe(array.shape(), name).ok_or_else(wrong)?;
        if size.iter().any(|side| !(1..=MAX_SIDE_PX).contains(side)) {
            let [width, height] = size;
            return Err(PyValueError::new_err(format!(
                "a picture of {width} x {height} pixels: sides can be 1 to {MAX_SIDE_PX} pixels long; make it smaller"
            )));
        }
        let array = array.try_readonly().map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Self { array, format, size })
    }

    /// The samples in place if they lie one after another, else a copy of them in `memory`.
    pub fn samples<'a>(&'a self, memory: &'a mut Vec<u8>) -> &'a [u8] {
        // NumPy also calls an array contiguous whose columns lie one after another.
        if let (true, Ok(samples)) = (self.array.is_c_contiguous(), self.array.as_slice()) {
            return samples;
        }
        memory.clear();
        copy(&self.array.as_array(), memory);
        memory
    }

    pub fn picture<'a>(&self, samples: &'a [u8]) -> Result<Picture<'a>, facewire_library::Error> {
        self.format.picture(samples, self.size)
    }
}

/// Returns the format, and width and height, of an array of this shape.
fn describe(shape: &[usize], name: Option<&str>) -> Option<(Format, [usize; 2])> {
    let named = match name {
        None => None,
        Some(name) => Some(Format::ALL.into_iter().find(|format| format.name() == name)?),
    };
    match (shape, named) {
        (&[height, width], None | Some(Format::Grey)) | (&[height, width, 1], Some(Format::Grey)) => {
            Some((Format::Grey, [width, height]))
        }
        (&[rows, width], Some(format @ (Format::I420 | Format::Nv12))) => {
            (rows % 3 == 0 && width % 2 == 0 && rows / 3 * 2 % 2 == 0).then_some((format, [width, rows / 3 * 2]))
        }
        (&[rows, width], Some(Format::I422)) => {
            (rows % 2 == 0 && width % 2 == 0).then_some((Format::I422, [width, rows / 2]))
        }
        (&[rows, width], Some(Format::I444)) => (rows % 3 == 0).then_some((Format::I444, [width, rows / 3])),
        (&[height, width, 2], Some(Format::Yuyv)) => (width % 2 == 0).then_some((Format::Yuyv, [width, height])),
        (&[height, width, channels @ (3 | 4)], _) => {
            let is_rgb = match named {
                Some(Format::Rgb | Format::Rgba) => true,
                None | Some(Format::Bgr | Format::Bgra) => false,
                Some(_) => return None,
            };
            let format = match (channels, is_rgb) {
                (3, true) => Format::Rgb,
                (3, false) => Format::Bgr,
                (_, true) => Format::Rgba,
                (_, false) => Format::Bgra,
            };
            Some((format, [width, height]))
        }
        (&[height, width, 1], None) => Some((Format::Grey, [width, height])),
        _ => None,
    }
}

/// Copies an array in the order of its indices, row by row where a row lies in one piece.
fn copy(array: &ArrayViewD<'_, u8>, memory: &mut Vec<u8>) {
    memory.reserve(array.len());
    for row in array.axis_iter(Axis(0)) {
        match row.as_slice() {
            Some(row) => memory.extend_from_slice(row),
            None => memory.extend(row.iter()),
        }
    }
}
