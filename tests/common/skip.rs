//! Lets a test skip itself if this machine lacks something that the test needs.

#![allow(clippy::unwrap_used)]

use std::fs::OpenOptions;
use std::io::{Write as _, stderr};

/// Names the file that collects skipped tests, one line each. `scripts/test` sets it and prints the file at its end.
const LIST: &str = "FACEWIRE_SKIPPED";
/// If this is "true", a test that skips itself fails, unless [`ALLOWED`] allows the skip.
const CI: &str = "CI";
/// `scripts/skip` reads the same file.
const ALLOWED: &str = include_str!("../skips-allowed");

/// Reports that the calling test did not run, and why: on standard error, and in the list of skipped tests.
///
/// The line is written past the test harness, which shows what a test prints only if the test fails.
pub fn skip(why: &str) {
    let why = why.trim_end().replace('\n', " ");
    let line = format!("{}: {why}\n", this_test());
    stderr().write_all(format!("skipped {line}").as_bytes()).unwrap();
    if let Some(list) = std::env::var_os(LIST) {
        OpenOptions::new().append(true).create(true).open(list).unwrap().write_all(line.as_bytes()).unwrap();
    }
    let is_ci = std::env::var_os(CI).is_some_and(|value| value == "true");
    assert!(
        !is_ci || [&line, &why].iter().any(|text| is_allowed(text)),
        "tests/skips-allowed does not allow this: {line}"
    );
}

fn is_allowed(text: &str) -> bool {
    let lines = ALLOWED.lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(|line| line.rsplit_once(": ")).any(|(beginning, _)| text.starts_with(beginning))
}

/// The program of this test and the test's name, which the harness gives to the thread that runs the test.
fn this_test() -> String {
    let program = std::env::current_exe().unwrap();
    let program = program.file_stem().unwrap().to_string_lossy().into_owned();
    // cargo adds a hash to the program's name.
    let program = program.rsplit_once('-').map_or(program.as_str(), |(name, _)| name);
    format!("{program} {}", std::thread::current().name().unwrap_or("?"))
}
