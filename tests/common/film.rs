//! Films made in memory, and films that ffmpeg decodes.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use facewire::capture::{Clip, Pixels, Source as _};

/// Bytes of `FRAME` and of a frame of 640x480 in 4:2:0.
pub const FRAME_BYTES: usize = 6 + 640 * 480 * 3 / 2;
const HEADER: &str = "YUV4MPEG2 W640 H480 F30:1 C420jpeg XCOLORRANGE=FULL\n";

/// The built-in clip as a file.
pub fn demo_avi() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/capture/demo.avi")
}

/// The first frames of the built-in clip as a y4m stream, sample for sample.
pub fn demo_y4m(frames: usize) -> Vec<u8> {
    let mut clip = Clip::once().unwrap();
    let mut stream = HEADER.as_bytes().to_vec();
    for _ in 0..frames {
        let picture = clip.next().unwrap().unwrap().picture;
        let Pixels::Planar { planes, strides: [luma, chroma], chroma_shift: [1, 1] } = picture.pixels else {
            panic!("the clip is 4:2:0");
        };
        let [width, height] = [picture.width, picture.height];
        let sizes = [(luma, width, height), (chroma, width / 2, height / 2), (chroma, width / 2, height / 2)];
        stream.write_all(b"FRAME\n").unwrap();
        for (plane, (stride, width, height)) in planes.into_iter().zip(sizes) {
            plane.chunks(stride).take(height).for_each(|row| stream.extend_from_slice(&row[..width]));
        }
    }
    stream
}

/// A y4m stream that shows grey and no face.
pub fn empty_y4m(frames: usize) -> Vec<u8> {
    let frame = [&b"FRAME\n"[..], &[128; FRAME_BYTES - 6]].concat();
    [HEADER.as_bytes(), &frame.repeat(frames)].concat()
}

/// A film decoded to y4m at 30 frames a second, each frame once; `None` without ffmpeg.
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
