//! Opens the source that a setting or an argument names.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

use super::points::{PointsSource, RecordingSource};
use super::rehearsal::Rehearsal;
use super::v4l2::{CameraSource, Wish};
use super::{AviSource, CaptureError, Clip, DEMO, FrameRate, Paced, Source, Y4mSource};
use crate::config::{BadScript, Script};

/// Number of bytes that are read at once.
const BUFFER_BYTES: usize = 64 * 1024;

/// Opens the camera that a setting names (see [`CameraSource::open`]). The name `demo` stands for the built-in clip, which
/// is repeated in real time, and a [`Script`] for a rehearsal. A camera that delivers nothing for `timeout` has stalled.
pub fn open_camera(device: &str, wish: &Wish, timeout: Duration) -> Result<Box<dyn Source + Send>, CaptureError> {
    match (device, Script::of(device)) {
        (DEMO, _) => Ok(Box::new(Paced::new(Clip::looped()?))),
        (_, Some(Ok(script))) => Ok(Box::new(Rehearsal::open(script, wish.width, timeout)?)),
        (_, Some(Err(BadScript))) => {
            Err(CaptureError::Absent(format!("{device} is no rehearsal; give {}", Script::EXPECTED)))
        }
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
pub fn open_file(input: &str, options: &FileOptions) -> Result<Box<dyn Source + Send>, CaptureError> {
    match input {
        DEMO => Ok(Box::new(Clip::once()?)),
        "-" => {
            let input = BufReader::with_capacity(BUFFER_BYTES, io::stdin());
            Ok(Box::new(Y4mSource::open(input, "standard input")?.with_rate(options.rate)))
        }
        path if Path::new(path).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) => {
            Ok(Box::new(PointsSource::open(path, options)?))
        }
        path => open_film(path, options.rate),
    }
}

fn open_film(path: &str, rate: FrameRate) -> Result<Box<dyn Source + Send>, CaptureError> {
    let cannot = |error| CaptureError::unopened(path, &error);
    let file = File::open(path).map_err(cannot)?;
    let mut reader = BufReader::with_capacity(BUFFER_BYTES, file);
    match reader.fill_buf().map_err(cannot)? {
        [b'R', b'I', b'F', b'F', ..] => Ok(Box::new(AviSource::open(reader, path)?.with_rate(rate))),
        [b'F', b'W', b'R', b'E', b'C', ..] => Ok(Box::new(RecordingSource::open(path)?)),
        [b'Y', b'U', b'V', b'4', ..] => Ok(Box::new(Y4mSource::open(reader, path)?.with_rate(rate))),
        _ => {
            let remedy = format!("convert it with `ffmpeg -i {path} -c:v mjpeg -q:v 3 out.avi`");
            Err(CaptureError::BadFile(format!("{path} is neither an AVI nor a y4m file; {remedy}")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_clip_is_opened_by_its_name_a_film_by_its_content_and_another_file_is_refused_by_name() {
        let open = |input| open_file(input, &FileOptions::default());
        assert_eq!(open(DEMO).unwrap().describe().origin, "demo");
        let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/src/capture/demo.avi");
        assert_eq!(open(clip).unwrap().describe().origin, clip);
        let reason = |path| open(path).err().unwrap().to_string();
        assert!(reason("/nowhere/film.avi").contains("cannot open /nowhere/film.avi"));
        assert!(reason("/").contains("cannot open /"));
        assert!(reason(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).contains("neither an AVI nor a y4m"));
    }

    #[test]
    fn a_path_to_another_kind_of_device_is_refused_before_it_is_opened() {
        let wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };
        let reason = |path| open_camera(path, &wish, Duration::ZERO).err().unwrap().to_string();
        for path in ["/dev/null", "/dev/tty", "/etc/passwd"] {
            assert!(reason(path).starts_with(&format!("{path} is not a camera")));
        }
        assert!(reason("/dev/video4000").contains("no camera is called /dev/video4000"));
    }
}
