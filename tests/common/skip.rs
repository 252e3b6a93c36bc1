//! Tests that leave themselves out, because this machine lacks something they need.

#![allow(clippy::unwrap_used)]

use std::fs::OpenOptions;
use std::io::{Write as _, stderr};

/// Names the file that collects skipped tests, one line each. `scripts/test` sets it and prints the file at its end.
const LIST: &str = "FACEWIRE_SKIPPED";

/// Notes that the calling test did not run, and why: on standard error, and in the list of skipped tests.
///
/// The line is written past the test harness, which shows what a test prints only if the test fails.
pub fn skip(why: &str) {
    let line = format!("{}: {}\n", this_test(), why.trim_end().replace('\n', " "));
    stderr().write_all(format!("skipped {line}").as_bytes()).unwrap();
    if let Some(list) = std::env::var_os(LIST) {
        OpenOptions::new().append(true).create(true).open(list).unwrap().write_all(line.as_bytes()).unwrap();
    }
}

/// The program of this test and the test's name, which the harness gives to the thread that runs the test.
fn this_test() -> String {
    let program = std::env::current_exe().unwrap();
    let program = program.file_stem().unwrap().to_string_lossy().into_owned();
    // cargo adds a hash to the program's name.
    let program = program.rsplit_once('-').map_or(program.as_str(), |(name, _)| name);
    format!("{program} {}", std::thread::current().name().unwrap_or("?"))
}
