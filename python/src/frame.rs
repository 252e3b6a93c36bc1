//! From a NumPy array or a picture of Pillow to a [`Picture`].

use facewire_library::{Format, MAX_SIDE_PX, Picture};
use numpy::ndarray::{ArrayViewD, Axis};
use numpy::{PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods as _};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// The tag of EXIF that says how the camera was held; 1 is upright.
const EXIF_ORIENTATION: u16 = 0x0112;
/// The orientations of EXIF that are not upright, each with Pillow's number of the transposition that turns it.
const TRANSPOSITIONS: [(u16, u8); 7] = [(2, 0), (3, 3), (4, 1), (5, 5), (6, 4), (7, 6), (8, 2)];

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
        let format = name.map(format_of).transpose()?;
        if given.cast::<PyUntypedArray>().is_err() && given.hasattr("mode")? && given.hasattr("convert")? {
            let (array, own_format) = array_of_pillow(given)?;
            // A picture in shades of grey has no other order.
            let format = if own_format == Format::Grey { own_format } else { format.unwrap_or(own_format) };
            return Self::of_array(&array, Some(format));
        }
        Self::of_array(given, format)
    }

    fn of_array(given: &Bound<'py, PyAny>, format: Option<Format>) -> PyResult<Self> {
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
                "an array of shape {:?} is no picture in the format {:?}; give rows x columns x 3 or 4 (bgr, rgb), rows x \
                 columns (grey), rows x columns x 2 (yuyv), or planes below each other: 3/2 rows x columns (i420, nv12), \
                 2 rows x columns (i422), 3 rows x columns (i444)",
                array.shape(),
                format.unwrap_or(Format::Bgr).name()
            ))
        };
        let (format, size) = describe(array.shape(), format).ok_or_else(wrong)?;
        check_size(size)?;
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

/// Returns the format of this name, in lower or upper case.
fn format_of(name: &str) -> PyResult<Format> {
    let named = Format::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(name));
    named.ok_or_else(|| {
        let names = Format::ALL.map(Format::name).join(", ");
        PyValueError::new_err(format!("format={name:?} is not known; give one of {names}"))
    })
}

/// Returns the samples of a picture of Pillow that stands upright, and their format.
fn array_of_pillow<'py>(given: &Bound<'py, PyAny>) -> PyResult<(Bound<'py, PyAny>, Format)> {
    let mode: String = given.getattr("mode")?.extract()?;
    if mode.starts_with('I') || mode == "F" {
        return Err(PyValueError::new_err(format!(
            "the samples of a picture of Pillow in the mode {mode} have more than 8 bits; scale them to 0 to 255, for instance \
             by Image.fromarray((numpy.asarray(picture) // 256).astype(numpy.uint8)) if they are 0 to 65535"
        )));
    }
    let picture = upright(given)?;
    let (picture, format) = match mode.as_str() {
        "L" => (picture, Format::Grey),
        "RGB" => (picture, Format::Rgb),
        "RGBA" => (picture, Format::Rgba),
        _ => (picture.call_method1("convert", ("RGB",))?, Format::Rgb),
    };
    Ok((given.py().import("numpy")?.call_method1("asarray", (picture,))?, format))
}

/// Turns a picture of Pillow as its EXIF data say that the camera was held.
fn upright<'py>(given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if !given.hasattr("getexif")? {
        return Ok(given.clone());
    }
    let exif = given.call_method0("getexif").and_then(|exif| exif.call_method1("get", (EXIF_ORIENTATION, 1)));
    // Damaged EXIF data say nothing about the picture.
    let orientation = exif.and_then(|orientation| orientation.extract::<u16>()).unwrap_or(1);
    match TRANSPOSITIONS.iter().find(|(known, _)| *known == orientation) {
        Some((_, transposition)) => given.call_method1("transpose", (*transposition,)),
        None => Ok(given.clone()),
    }
}

fn check_size(size: [usize; 2]) -> PyResult<()> {
    let [width, height] = size;
    let longest = width.max(height);
    if width.min(height) == 0 {
        return Err(PyValueError::new_err(format!("a picture of {width} x {height} pixels is empty")));
    }
    if longest > MAX_SIDE_PX {
        let factor = longest.div_ceil(MAX_SIDE_PX);
        return Err(PyValueError::new_err(format!(
            "a picture of {width} x {height} pixels is too large: sides can have up to {MAX_SIDE_PX} pixels; shrink it by a \
             factor of {factor}, with cv2.resize(picture, None, fx=1/{factor}, fy=1/{factor}) or, for a picture of Pillow, \
             picture.reduce({factor})"
        )));
    }
    Ok(())
}

/// Returns the format, and width and height, of an array of this shape.
fn describe(shape: &[usize], named: Option<Format>) -> Option<(Format, [usize; 2])> {
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
