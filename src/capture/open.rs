//! Opens the source that a setting or an argument names.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

use super::rehearsal::Rehearsal;
use super::v4l2::{CameraSource, Wish};
use super::{AviSource, CaptureError, Clip, FrameRate, Paced, PointsSource, RecordingSource, Source, Y4mSource};
use crate::config::{BadScript, Script};

/// The name of the built-in clip, in place of a file or a camera.
pub const DEMO: &str = "demo";
/// Ending of the files that hold landmarks.
const POINTS: &str = "npy";
/// Number of bytes that are read at once.
const BUFFER_BYTES: usize = 64 * 1024;

/// Opens the camera that a setting names (see [`CameraSource::open`]). The name `demo` stands for the built-in clip, which
/// is repeated in real time, and a [`Script`] for a rehearsal. A camera that delivers nothing for `timeout` has stalled.
///
/// # Errors
/// Those of [`CameraSource::open`] and [`Rehearsal::open`], and [`CaptureError::Script`].
pub fn open_camera(device: &str, wish: &Wish, timeout: Duration) -> Result<Box<dyn Source + Send>, CaptureError> {
    match (device, Script::of(device)) {
        (DEMO, _) => Ok(Box::new(Paced::new(Clip::looped()?))),
        (_, Some(Ok(script))) => Ok(Box::new(Rehearsal::open(script, wish.width, timeout)?)),
        (_, Some(Err(BadScript))) => Err(CaptureError::Script { wanted: device.to_owned() }),
        (_, None) => Ok(Box::new(CameraSource::open(device, wish, timeout)?)),
    }
}

/// Properties that a file may not state.
#[derive(Debug, Clone, Copy)]
pub struct FileOptions {
    /// Rate of a file without a rate.
    pub rate: FrameRate,
    /// Width and height of the picture in which the landmarks of a `.npy` file were found.
    pub points_size_px: [u16; 2],
}

impl Default for FileOptions {
    fn default() -> Self {
        Self { rate: FrameRate::FPS_30, points_size_px: [640, 480] }
    }
}

/// Opens `-` (y4m on standard input), `demo` (the built-in clip, once through), a `.npy` file of landmarks, or a film or a
/// recording by its content.
///
/// # Errors
/// [`CaptureError::Open`], [`CaptureError::UnknownContainer`], and those of the readers.
pub fn open_file(input: &str, options: &FileOptions) -> Result<Box<dyn Source + Send>, CaptureError> {
    match input {
        DEMO => Ok(Box::new(Clip::once()?)),
        "-" => {
            let input = BufReader::with_capacity(BUFFER_BYTES, io::stdin());
            Ok(Box::new(Y4mSource::open(input, "standard input")?.with_rate(options.rate)))
        }
        path if has_points(path) => Ok(Box::new(PointsSource::open(path, options)?)),
        path => open_film(path, options.rate),
    }
}

fn has_points(path: &str) -> bool {
    Path::new(path).extension().is_some_and(|ending| ending.eq_ignore_ascii_case(POINTS))
}

fn open_film(path: &str, rate: FrameRate) -> Result<Box<dyn Source + Send>, CaptureError> {
    let cannot = |source| CaptureError::Open { path: path.to_owned(), source };
    let file = File::open(path).map_err(cannot)?;
    let mut reader = BufReader::with_capacity(BUFFER_BYTES, file);
    match reader.fill_buf().map_err(cannot)? {
        [b'R', b'I', b'F', b'F', ..] => Ok(Box::new(AviSource::open(reader, path)?.with_rate(rate))),
        [b'F', b'W', b'R', b'E', b'C', ..] => Ok(Box::new(RecordingSource::open(path)?)),
        [b'Y', b'U', b'V', b'4', ..] => Ok(Box::new(Y4mSource::open(reader, path)?.with_rate(rate))),
        _ => Err(CaptureError::UnknownContainer { path: path.to_owned() }),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn reason(path: &str) -> String {
        open_file(path, &FileOptions::default()).err().unwrap().to_string()
    }

    #[test]
    fn the_built_in_clip_is_opened_by_its_name_and_a_film_by_its_content() {
        let open = |input| open_file(input, &FileOptions::default()).unwrap();
        assert_eq!(open(DEMO).describe().origin, "demo");
        let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/src/capture/demo.avi");
        assert_eq!(open(clip).describe().origin, clip);
    }

    #[test]
    fn a_file_of_another_kind_is_refused_by_name() {
        assert!(reason("/nowhere/film.avi").contains("cannot open /nowhere/film.avi"));
        assert!(reason("/").contains("cannot open /"));
        assert!(reason(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).contains("neither an AVI nor a y4m"));
        assert!(reason("/dev/null").contains("neither an AVI nor a y4m"));
    }
}
