//! Decides which cameras to try for a setting, and in which order.
//!
//! A camera that cannot be used now, such as one that another program uses, must not keep facewire from the next one. So
//! the cameras that the setting fits are tried until one starts: first those that did not fail before, of these the cameras
//! with colours, of these the USB cameras, of these the one with the lowest number. Those that failed follow, the last one
//! that failed at the end. Multi-planar cameras come after all others. The camera module of a Raspberry Pi, whose service
//! passes its pictures by a pipe, is tried before all cameras, or after them if it has failed earlier, because it takes seconds
//! to notice that its service does not work.

use std::path::{Path, PathBuf};

use super::super::CaptureError;
use super::super::live::{failed, remember};
use super::mode::{Wish, choose};
use super::probe::{Camera, Found};
use crate::clock::monotonic_us;

/// The setting that every camera fits.
pub const AUTO: &str = "auto";
/// What nobody would guess of the camera that most owners of a Raspberry Pi have.
const MODULE_HINT: &str = if cfg!(any(target_arch = "aarch64", target_arch = "arm")) {
    " (a Raspberry Pi's camera module needs `systemctl enable --now facewire-camera`)"
} else {
    ""
};
/// Longest name of a camera by the kernel's interface, without the 0 at its end.
const CARD_BYTES: usize = 31;
/// Time after which no further camera is tried in one call: a silent one takes seconds, and the service's watchdog waits.
const TRY_FOR_US: u64 = 10_000_000;

/// Returns the cameras that `wanted` names, in the order in which they are tried. A camera without a usable mode is
/// tried only if no other has such a name, because many webcams have a second device of the same name.
fn rank<'a>(failed: &[PathBuf], cameras: &'a [Camera], wanted: &str, wish: &Wish) -> Vec<&'a Camera> {
    let is_usable = |camera: &&Camera| choose(&camera.modes, wish).is_some();
    // Many laptops have an infrared camera, which shows nothing without its lamp. Some claim to have colours.
    let is_grey = |camera: &Camera| !camera.modes.is_empty() && camera.modes.iter().all(|mode| mode.format.is_grey());
    let has_colours = |camera: &Camera| !is_grey(camera) && !says_infrared(&camera.card);
    let mut ranked: Vec<_> = cameras.iter().filter(|camera| wanted == AUTO || camera.is_named(wanted)).collect();
    if wanted == AUTO || ranked.iter().any(is_usable) {
        ranked.retain(is_usable);
    }
    let turn = |camera: &Camera| failed.iter().position(|node| *node == camera.node).map_or(0, |at| at + 1);
    // Those of a connector on the board may need to be set up first, and then fail each time.
    ranked.sort_by_key(|camera| (camera.is_multi_planar, turn(camera), !has_colours(camera), !camera.is_usb));
    ranked
}

/// What was tried before one source started.
struct Tries<S> {
    start: S,
    /// What the log says about the others.
    note: String,
    errors: Vec<CaptureError>,
}

impl<T, S: FnMut(&Path, &str) -> Result<T, CaptureError>> Tries<S> {
    fn start(&mut self, path: &Path) -> Option<T> {
        match (self.start)(path, &self.note) {
            Ok(source) => Some(source),
            Err(error) => {
                remember(path, true);
                self.note += &format!("; passed over {}, because {error}", path.display());
                self.errors.push(error);
                None
            }
        }
    }
}

/// Calls `start` with the pipe of the module if there is one, and with the node of one camera after the other, until one
/// starts: every camera if `wanted` is `auto`, else those whose name or link contains it, in upper or lower case. `find` is
/// called once a camera is needed. The text that `start` gets tells the operator about the other cameras.
pub(in crate::capture) fn start_one<T>(
    module: Option<&Path>,
    find: impl FnOnce() -> Found,
    wanted: &str,
    wish: &Wish,
    start: impl FnMut(&Path, &str) -> Result<T, CaptureError>,
) -> Result<T, CaptureError> {
    let failed = failed();
    let (last, first): (Vec<_>, Vec<_>) =
        module.into_iter().partition(|module| failed.iter().any(|path| path == module));
    let mut tries = Tries { start, note: String::new(), errors: Vec::new() };
    if let Some(source) = first.into_iter().find_map(|module| tries.start(module)) {
        return Ok(source);
    }
    let Found { cameras, multi_planar, refused } = find();
    let begun_us = monotonic_us();
    let ranked = rank(&failed, &cameras, wanted, wish);
    if wanted != AUTO {
        tries.note += &ambiguity(&ranked);
    }
    let has_time = |tried: &usize| *tried == 0 || monotonic_us() - begun_us <= TRY_FOR_US;
    let in_time = ranked.iter().enumerate().take_while(|(tried, _)| has_time(tried)).map(|(_, camera)| &*camera.node);
    let has_failed = !last.is_empty();
    if let Some(source) = in_time.chain(last).find_map(|path| tries.start(path)) {
        return Ok(source);
    }
    let Tries { mut errors, .. } = tries;
    // Whoever has a module wants to know why it does not work, each time.
    if has_failed {
        errors.rotate_right(1);
    }
    // Only the end of the process frees a camera that cannot be stopped.
    errors.sort_by_key(|error| !matches!(error, CaptureError::NotStopped { .. }));
    let unread = multi_planar.into_iter().filter(|_| cameras.is_empty());
    let first = errors.into_iter().chain(refused).chain(unread).next();
    Err(first.unwrap_or_else(|| missing(&cameras, wanted, wish)))
}

/// Whether a camera calls itself an infrared one. Names of more than [`CARD_BYTES`] bytes are cut, so that the last word of
/// `Integrated Camera: Integrated IR` lacks a letter.
fn says_infrared(card: &str) -> bool {
    let is_cut = card.len() == CARD_BYTES && card.ends_with(" I");
    let mut words = card.split(|letter: char| !letter.is_alphanumeric());
    is_cut || words.any(|word| word.eq_ignore_ascii_case("ir") || word.eq_ignore_ascii_case("infrared"))
}

/// Tells how to distinguish the first camera from the others, if a name fits several.
fn ambiguity(ranked: &[&Camera]) -> String {
    let [first, _, ..] = ranked else { return String::new() };
    let nodes: Vec<_> = ranked.iter().map(|camera| camera.node.display().to_string()).collect();
    // The last link names the socket, and so distinguishes cameras of the same model.
    let remedy = first.links.last().map_or("a path".to_owned(), |link| format!("\"{}\"", link.display()));
    format!("; the name fits {}: set camera.device = {remedy} to keep to the first", nodes.join(", "))
}

fn missing(cameras: &[Camera], wanted: &str, wish: &Wish) -> CaptureError {
    let Some(first) = cameras.first() else {
        let remedy = "plug one in, or set camera.device = \"demo\" to play the built-in clip";
        return CaptureError::Absent(format!("there is no camera; {remedy}{MODULE_HINT}"));
    };
    if wanted == AUTO {
        return first.lacks(wish);
    }
    let names: Vec<_> = cameras.iter().map(|camera| format!("{} ({})", camera.card, camera.node.display())).collect();
    CaptureError::Absent(format!("no camera is called {wanted}; there is {}", names.join(", ")))
}

impl Camera {
    fn is_named(&self, part: &str) -> bool {
        let links = self.links.iter().filter_map(|link| link.file_name()).map(|name| name.to_string_lossy());
        let mut names = links.chain([self.card.as_str().into()]);
        names.any(|name| name.to_lowercase().contains(&part.to_lowercase()))
    }
}

#[cfg(test)]
mod tests {
    use rustix::io::Errno;

    use super::super::super::FrameRate;
    use super::super::layout::PixelFormat;
    use super::super::mode::{Mode, Steps};
    use super::*;

    const WISH: Wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };

    fn camera(number: u32, card: &str, format: Option<PixelFormat>) -> Camera {
        let size = [640, 480].map(Steps::one);
        let node = format!("/dev/video{number}").into();
        let driver = "uvcvideo".to_owned();
        let links = vec![format!("/dev/v4l/by-id/usb-{}-video-index0", card.replace(' ', "_")).into()];
        let modes = format.into_iter().map(|format| Mode { format, size, rates: Vec::new() }).collect();
        let card = card.to_owned();
        Camera { node, card, driver, is_usb: number > 0, links, modes, ..Camera::default() }
    }

    fn four() -> Vec<Camera> {
        vec![
            camera(0, "Loopback", Some(PixelFormat::YUYV)),
            camera(1, "HD Webcam C615", None),
            camera(2, "HD Webcam C615", Some(PixelFormat::YUYV)),
            camera(4, "Infrared Camera", Some(PixelFormat::GREY)),
        ]
    }

    #[test]
    fn auto_tries_usb_cameras_first_and_those_that_failed_last_and_a_name_those_that_it_is_part_of() {
        let grey = Some(PixelFormat::GREY);
        let nv12 = Some(PixelFormat::NV12);
        let table: [(&[&str], _, _, &[&str], _); 9] = [
            (
                &[],
                "auto",
                None,
                &["2", "0", "4"],
                "a node without a usable mode is left out, and an infrared one is last",
            ),
            (&["2"], "auto", None, &["0", "4", "2"], "one failed"),
            (&["4", "2", "0"], "auto", None, &["4", "2", "0"], "all failed"),
            (&[], "auto", grey, &["4"], "of the format"),
            (&[], "auto", nv12, &[], "no camera has the format"),
            (&[], "c615", None, &["2"], "its second device has no usable mode"),
            (&[], "c615", nv12, &["1", "2"], "for the error"),
            (&[], "usb-Infrared_", None, &["4"], "a link"),
            (&[], "C920", None, &[], "no such name"),
        ];
        for (failed, wanted, format, expected, what) in table {
            let node = |number: &&str| PathBuf::from(format!("/dev/video{number}"));
            let failed = failed.iter().map(node).collect::<Vec<_>>();
            let cameras = four();
            let ranked = rank(&failed, &cameras, wanted, &Wish { format, ..WISH });
            let nodes = ranked.iter().map(|camera| camera.node.clone());
            assert!(nodes.eq(expected.iter().map(node)), "{what}: {ranked:?}");
        }
    }

    #[test]
    fn a_camera_that_calls_itself_infrared_comes_after_those_with_colours_whatever_format_it_claims() {
        for card in [
            "Integrated IR Camera",
            "USB2.0 FHD UVC WebCam: IR",
            "HP Wide Vision (infrared)",
            "ir_camera",
            "Integrated Camera: Integrated I",
        ] {
            let yuyv = Some(PixelFormat::YUYV);
            let cameras = [camera(2, card, yuyv), camera(4, "AIR Camera", yuyv), camera(6, "Camera IRIS I", yuyv)];
            let ranked = rank(&[], &cameras, "auto", &WISH);
            let cards = ranked.iter().map(|camera| camera.card.as_str());
            assert!(cards.eq(["AIR Camera", "Camera IRIS I", card]), "{card}");
        }
    }

    #[test]
    fn multi_planar_cameras_come_after_all_others_even_those_that_have_failed() {
        let yuyv = Some(PixelFormat::YUYV);
        let planes = Camera { is_multi_planar: true, ..camera(2, "Connector", yuyv) };
        let cameras = [planes, camera(4, "Webcam", yuyv)];
        let ranked = rank(&["/dev/video4".into()], &cameras, "auto", &WISH);
        assert!(ranked.iter().map(|camera| camera.card.as_str()).eq(["Webcam", "Connector"]));
    }

    #[test]
    fn a_camera_that_does_not_start_is_passed_over_told_and_tried_last_the_next_time() {
        // For cameras with numbers from `first` on: whether each opens (o), is busy (b) or cannot be stopped (s), the
        // beginning of the note or error to be told, and the numbers that are tried.
        let table: [(u32, &str, &str, &[u32]); 5] = [
            (81, "bo", "; passed over /dev/video81, because /dev/video81 is in use by another", &[81, 82]),
            (81, "oo", "", &[82]),
            (84, "bbb", "/dev/video84 is in use", &[84, 85, 86]),
            // Only the end of the process frees it, but as long as another camera starts, the service goes on.
            (87, "bsb", "/dev/video88 cannot be stopped", &[87, 88, 89]),
            (94, "bso", "; passed over /dev/video94", &[94, 95, 96]),
        ];
        for (first, outcomes, expected, expected_tries) in table {
            let outcomes: Vec<_> = (first..).zip(outcomes.chars()).collect();
            let camera = |(number, _): &(u32, char)| camera(*number, "Webcam", Some(PixelFormat::YUYV));
            let found = Found { cameras: outcomes.iter().map(camera).collect(), ..Found::default() };
            let mut tried = Vec::new();
            let told = start_one(
                None,
                || found,
                "auto",
                &WISH,
                |node, note| {
                    let is_it = |(number, _): &&(u32, char)| node.ends_with(format!("video{number}"));
                    let (number, outcome) = outcomes.iter().find(is_it).unwrap();
                    tried.push(*number);
                    match outcome {
                        'b' => Err(CaptureError::device(node, "starting it", Errno::BUSY.into())),
                        's' => {
                            Err(CaptureError::NotStopped { path: node.display().to_string(), source: Errno::IO.into() })
                        }
                        _ => Ok(note.to_owned()),
                    }
                },
            );
            let told = told.unwrap_or_else(|error| error.to_string());
            assert!(told.starts_with(expected) && told.is_empty() == expected.is_empty(), "{told}");
            assert_eq!(tried, expected_tries, "{told}");
        }
    }

    #[test]
    fn the_module_is_tried_before_all_cameras_and_after_a_failure_behind_them() {
        let module = Path::new("/run/select-test");
        let node = Path::new("/dev/video98");
        let mut tried = Vec::new();
        let mut start = |failing: &[&Path]| {
            tried.clear();
            let find = || Found { cameras: vec![camera(98, "Webcam", Some(PixelFormat::YUYV))], ..Found::default() };
            let started = start_one(Some(module), find, "auto", &WISH, |path, note| {
                tried.push(path.to_owned());
                let is_failing = failing.contains(&path);
                if is_failing { Err(CaptureError::Gone) } else { Ok(note.to_owned()) }
            });
            (started.ok(), tried.clone())
        };
        let (both, module_alone) = ([module.to_owned(), node.to_owned()], [module.to_owned()]);
        assert_eq!(start(&[]), (Some(String::new()), module_alone.to_vec()));
        let (note, tried) = start(&[module]);
        assert!(note.is_some_and(|note| note.starts_with("; passed over /run/select-test, because ")));
        assert_eq!(tried, both);
        assert_eq!(start(&[module]).1, [node.to_owned()]);
        assert_eq!(start(&[module, node]), (None, vec![node.to_owned(), module.to_owned()]));
    }

    #[test]
    fn an_ambiguous_name_and_a_missing_camera_are_reported_with_their_remedy() {
        let links = ["/dev/v4l/by-id/usb-C615", "/dev/v4l/by-path/usb-1"].map(PathBuf::from);
        let [first, second] = [2, 4].map(|number| camera(number, "C615", None));
        let missing = |cameras: &[Camera], wanted| missing(cameras, wanted, &WISH).to_string();
        let text = ambiguity(&[&Camera { links: links.into(), ..first }, &second]);
        let want = "fits /dev/video2, /dev/video4: set camera.device = \"/dev/v4l/by-path/usb-1\"";
        assert!(text.contains(want), "{text}");
        let text = missing(&four(), "C920");
        assert!(text.contains("C920") && text.contains("HD Webcam C615 (/dev/video2)"), "{text}");
        let text = missing(&four()[1..], "auto");
        assert!(text.starts_with("/dev/video1 offers no format that facewire reads"), "{text}");
        assert!(missing(&[], "auto").contains("there is no camera"));
    }
}
