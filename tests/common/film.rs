//! Films that are made in memory, and films that ffmpeg decodes.

use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use facewire::capture::{Clip, FrameRate, Source};
use facewire_face::Pixels;

use self::y4m::Y4mSource;

// The service has no reader of y4m streams; facewire-tools has.
#[path = "../../tools/src/input/y4m.rs"]
mod y4m;

/// The y4m header of a film like the built-in clip: 640x480, 4:2:2, full range.
pub const HEADER: &str = "YUV4MPEG2 W640 H480 F30:1 C422 XCOLORRANGE=FULL\n";
const FRAME_BYTES: usize = 640 * 480 * 2;

pub fn demo_avi() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/capture/demo.avi")
}

/// Returns the first frames of the built-in clip as a y4m stream with the same samples.
pub fn demo_y4m(frames: usize) -> Vec<u8> {
    let mut clip = Clip::once().unwrap();
    let mut stream = HEADER.as_bytes().to_vec();
    for _ in 0..frames {
        let frame = clip.next().unwrap().unwrap();
        let picture = frame.picture().unwrap();
        let Pixels::Planar { planes, strides: [640, 320], chroma_shift: [1, 0] } = picture.pixels() else {
            panic!("the clip is 4:2:2 without padding");
        };
        stream.extend_from_slice(b"FRAME\n");
        let lengths = [FRAME_BYTES / 2, FRAME_BYTES / 4, FRAME_BYTES / 4];
        planes.iter().zip(lengths).for_each(|(plane, length)| stream.extend_from_slice(&plane[..length]));
    }
    stream
}

/// Returns a grey y4m stream without a face.
pub fn empty_y4m(frames: usize) -> Vec<u8> {
    let frame = [&b"FRAME\n"[..], &vec![128; FRAME_BYTES]].concat();
    [HEADER.as_bytes(), &frame.repeat(frames)].concat()
}

pub fn read_y4m<'a>(stream: impl BufRead + 'a) -> impl Source + 'a {
    Y4mSource::open(stream, "stream", FrameRate::FPS_30).unwrap()
}

/// Starts ffmpeg, which decodes a film to y4m at 30 frames a second, each frame once. Returns `None` without ffmpeg.
pub fn decode(film: &Path, options: &[&str]) -> Option<Child> {
    Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(film)
        .args(["-vf", "setpts=N/30/TB", "-r", "30", "-f", "yuv4mpegpipe", "-strict", "-1"])
        .args(options)
        .arg("-")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .ok()
}
