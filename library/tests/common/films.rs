//! Films of people, where the folder of reference clips exists (`FACEWIRE_SHARED`, or `shared` beside this checkout).

use std::path::{Path, PathBuf};
use std::process::Command;

use super::skip::skip;

const FILMS: [(&str, [usize; 2]); 2] = [("single_face.mp4", [640, 360]), ("face_noface.mov", [960, 540])];

/// The size of each film, and its pictures one after the other, 4:2:2 in full range. Without the films or ffmpeg, notes that they
/// were left out.
pub fn films() -> Vec<([usize; 2], Vec<u8>)> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from).join("footage");
    let decode = |(name, size): (&str, [usize; 2])| {
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-i"]).arg(folder.join(name));
        let decoded = ffmpeg.args(["-pix_fmt", "yuvj422p", "-f", "rawvideo", "-"]).output();
        let film = decoded.map(|output| output.stdout).unwrap_or_default();
        if film.is_empty() {
            skip(&format!("no film {name} in {}, or no ffmpeg; set FACEWIRE_SHARED", folder.display()));
            return None;
        }
        assert!(film.len().is_multiple_of(2 * size[0] * size[1]), "{name} has another size");
        Some((size, film))
    };
    FILMS.into_iter().filter_map(decode).collect()
}
