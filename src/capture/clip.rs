//! The built-in clip: 240 frames of a rendered face, 640 x 480 pixels, 30 frames per second, in a file of its own.

use std::env;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::{AviSource, CaptureError, FrameRate};

/// The name of the built-in clip, in place of a file or a camera.
pub const DEMO: &str = "demo";
const VARIABLE: &str = "FACEWIRE_DEMO";
const INSTALLED: &str = "/usr/share/facewire/demo.avi";

pub type Clip = AviSource<BufReader<File>>;

/// Returns the path of the clip: beside the program, in the checkout in which it was built, or where a package puts it.
fn path() -> PathBuf {
    if let Some(named) = env::var_os(VARIABLE) {
        return named.into();
    }
    let program = env::current_exe().unwrap_or_default();
    let folders: Vec<&Path> = program.ancestors().skip(1).collect();
    let beside = folders.first().map(|folder| folder.join("demo.avi"));
    let in_checkout = folders.iter().map(|folder| folder.join("src/capture/demo.avi"));
    // A build for tests may stand in a folder far from its checkout.
    let of_tests = cfg!(debug_assertions).then(|| concat!(env!("CARGO_MANIFEST_DIR"), "/src/capture/demo.avi").into());
    let found = beside.into_iter().chain(in_checkout).chain(of_tests).find(|path| path.is_file());
    found.unwrap_or_else(|| INSTALLED.into())
}

impl Clip {
    pub fn once() -> Result<Self, CaptureError> {
        let path = path();
        let refused = |error| CaptureError::unopened(&path.display().to_string(), &error);
        Self::open(BufReader::new(File::open(&path).map_err(refused)?), DEMO, FrameRate::FPS_30)
    }

    /// Opens the clip, to be repeated for ever. Frame numbers and times continue to grow.
    pub fn looped() -> Result<Self, CaptureError> {
        Self::once().map(Self::repeated)
    }
}

#[cfg(test)]
mod tests {
    use facewire_face::Pixels;

    use super::super::{Frame, Source as _};
    use super::*;

    #[test]
    fn the_looped_clip_repeats_its_240_pictures_while_numbers_and_times_grow() {
        let luma = |frame: &Frame<'_>| match frame.picture().unwrap().pixels() {
            Pixels::Planar { planes: [luma, ..], .. } => luma.to_vec(),
            _ => panic!("the clip is Motion-JPEG"),
        };
        let [mut once, mut looped] = [Clip::once().unwrap(), Clip::looped().unwrap()];
        let first = luma(&looped.next().unwrap().unwrap());
        assert!((0..240).all(|_| once.skip().unwrap()) && (1..240).all(|_| looped.skip().unwrap()));
        assert!(!once.skip().unwrap() && once.next().unwrap().is_none());
        let again = looped.next().unwrap().unwrap();
        assert_eq!((again.number, again.captured_us), (240, 8_000_000));
        assert_eq!(luma(&again), first);
    }
}
