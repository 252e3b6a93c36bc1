//! Outputs whose reader has gone, and full disks.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs::File;
use std::io::{Write as _, pipe};
use std::process::Stdio;

use common::film::demo_y4m;
use common::program::{Run, facewire, text};
use tempfile::NamedTempFile;

/// Returns the writing end of a pipe without a reader.
fn closed() -> Stdio {
    pipe().unwrap().1.into()
}

fn short_film() -> NamedTempFile {
    let mut film = NamedTempFile::with_suffix(".y4m").unwrap();
    film.write_all(&demo_y4m(3)).unwrap();
    film
}

/// `facewire ... | head -1` closes standard output early.
#[test]
fn standard_output_that_is_closed_early_is_no_failure() {
    let film = short_film();
    let film = text(film.path());
    for command in
        [&["track", film][..], &["bench", film, "--rounds", "1"], &["check"], &["defaults"], &["devices"], &["--help"]]
    {
        let run = Run::ended(&facewire(command).stdout(closed()).output().unwrap()).succeeded();
        assert!(run.err.is_empty() || run.err.contains("3 frames, "), "{command:?}: {}", run.err);
    }
}

#[test]
fn standard_error_that_is_closed_changes_no_exit_status() {
    let film = short_film();
    for (command, status) in [
        (&["track", text(film.path())][..], 0),
        (&["track", "/nowhere/film.avi"], 66),
        (&["check", "--board", "pi6"], 78),
        (&["frobnicate"], 2),
    ] {
        let ended = facewire(command).stderr(closed()).output().unwrap();
        assert_eq!(ended.status.code(), Some(status), "{command:?}");
    }
}

#[test]
fn standard_output_on_a_full_disk_is_told() {
    let film = short_film();
    let film = text(film.path());
    for command in [&["track", film][..], &["check"], &["defaults"], &["devices"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let run = Run::ended(&facewire(command).stdout(full).output().unwrap());
        let sentence = run.sentence(74);
        assert!(
            sentence.starts_with("cannot write standard output: No space left on device"),
            "{command:?}: {sentence}"
        );
        assert!(sentence.ends_with("; free some space, or write to another disk"), "{sentence}");
    }
    let run = Run::of(&mut facewire(["track", film, "--out", "/dev/full"]));
    assert!(run.sentence(74).starts_with("cannot write /dev/full: No space left on device"), "{}", run.err);
}
