//! What the scripts print before they set anything up, and the verdict that `scripts/test` prints at its end.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};

use common::program::Run;
use tempfile::TempDir;

fn script(name: &str) -> Command {
    Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts").join(name))
}

/// Lets one test of this file run at a time. A process that one test starts would hold the scripts open that another test
/// is writing, and the system refuses to run a program that is open for writing.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Writes a shell script that anybody may run.
fn write_script(path: &Path, commands: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, format!("#!/bin/sh\n{commands}\n")).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// The search path for programs, with this folder before the others.
fn search_path(first: &Path) -> String {
    format!("{}:{}", first.display(), std::env::var("PATH").unwrap())
}

#[test]
fn setup_refuses_a_machine_without_onnx_runtime_before_it_installs_anything() {
    let _alone = alone();
    for (machine, bits) in [("armv7l", "32"), ("aarch64", "32"), ("riscv64", "64")] {
        let stand_ins = tempfile::tempdir().unwrap();
        write_script(&stand_ins.path().join("uname"), &format!("echo {machine}"));
        write_script(&stand_ins.path().join("getconf"), &format!("echo {bits}"));
        let cache = stand_ins.path().join("cache");
        let run = Run::of(
            script("setup").arg("onnxruntime").env("PATH", search_path(stand_ins.path())).env("XDG_CACHE_HOME", &cache),
        );
        assert_eq!(run.status, Some(1), "{}", run.err);
        let want = format!(
            "setup: there is no ONNX Runtime for {machine} with {bits} bits: leave networks.engine at \"auto\", which needs \
             none\n"
        );
        assert_eq!((run.out.as_str(), run.err), ("", want));
        assert!(!cache.exists());
    }
}

#[test]
fn help_sets_nothing_up() {
    let (_alone, folder) = (alone(), tempfile::tempdir().unwrap());
    let cache: PathBuf = folder.path().join("cache");
    for name in ["compare", "demo", "package", "setup"] {
        let run = Run::of(script(name).arg("--help").env("XDG_CACHE_HOME", &cache)).succeeded();
        assert!(run.out.contains("Usage: scripts/") && run.err.is_empty(), "{name}: {}{}", run.out, run.err);
        assert!(!cache.exists());
    }
}

/// A copy of `scripts/test` in a project whose programs and scripts are stand-ins that do nothing.
struct Rehearsal {
    folder: TempDir,
    _alone: MutexGuard<'static, ()>,
}

impl Rehearsal {
    fn new() -> Self {
        let rehearsal = Self { folder: tempfile::tempdir().unwrap(), _alone: alone() };
        for program in ["cargo", "rustfmt", "shellcheck", "qemu-aarch64"] {
            rehearsal.replace(&format!("programs/{program}"), "");
        }
        rehearsal.replace("programs/uname", "echo x86_64");
        for file in [
            "scripts/setup",
            "cross/setup",
            "cross/count",
            "cross/test",
            "scripts/package",
            "packaging/check",
            "packaging/try",
            "tests/guest/arm64",
            "tests/guest/setup",
            "tests/guest/cameras",
            "tests/guest/run",
        ] {
            rehearsal.replace(file, "");
        }
        fs::copy(script("test").get_program(), rehearsal.folder.path().join("scripts/test")).unwrap();
        rehearsal
    }

    fn replace(&self, file: &str, commands: &str) {
        write_script(&self.folder.path().join(file), commands);
    }

    fn run(&self, steps: &[&str]) -> Run {
        let mut test = Command::new(self.folder.path().join("scripts/test"));
        test.env("PATH", search_path(&self.folder.path().join("programs"))).env_remove("CARGO_TARGET_DIR");
        Run::of(test.args(steps))
    }
}

/// The last heading of a run of `scripts/test`, without the time.
fn verdict(output: &str) -> &str {
    let heading = output.rsplit("\n== ").next().unwrap();
    heading.split(" (").next().unwrap()
}

#[test]
fn all_passed_is_said_only_if_nothing_was_skipped() {
    let run = Rehearsal::new().run(&[]).succeeded();
    assert_eq!(verdict(&run.out), "all passed");
}

#[test]
fn skipped_tests_are_listed_at_the_end_with_their_reasons() {
    let rehearsal = Rehearsal::new();
    rehearsal
        .replace("programs/cargo", "[ $1 != test ] || echo 'golden smile: there is no ffmpeg' >>$FACEWIRE_SKIPPED");
    rehearsal.replace("tests/guest/setup", "echo 'device tests: they need Debian' >>$FACEWIRE_SKIPPED; exit 77");
    rehearsal.replace("cross/setup", "exit 77");
    rehearsal.replace("packaging/check", "exit 77");
    let run = rehearsal.run(&[]).succeeded();
    let list = "\nARM by emulation: cross/setup does not work on this system\ndevice tests: they need Debian\n\
                golden smile: there is no ffmpeg\npackages: they are made on x86-64 Debian, as root\n";
    assert_eq!(verdict(&run.out), "passed, but 4 skipped");
    assert!(run.out.ends_with(list), "{}", run.out);
    assert!(!run.out.contains("all passed"), "{}", run.out);
}

#[test]
fn steps_that_were_not_asked_for_are_listed_as_skipped() {
    let run = Rehearsal::new().run(&["lint"]).succeeded();
    let list = "\nstep cross: not asked for\nstep device: not asked for\nstep package: not asked for\n\
                step unit: not asked for\n";
    assert_eq!(verdict(&run.out), "passed, but 4 skipped");
    assert!(run.out.ends_with(list), "{}", run.out);
}

#[test]
fn a_step_that_fails_ends_the_run_without_a_verdict() {
    let rehearsal = Rehearsal::new();
    let programs = ["programs/cargo", "programs/shellcheck", "scripts/setup"];
    let scripts =
        ["cross/setup", "cross/count", "scripts/package", "packaging/check", "packaging/try", "tests/guest/setup"];
    for file in programs.iter().chain(&scripts).chain(&["tests/guest/run"]) {
        rehearsal.replace(file, "exit 3");
        let run = rehearsal.run(&[]);
        assert_eq!(run.status, Some(3), "{file}: {}", run.out);
        assert!(!run.out.contains("passed"), "{file}: {}", run.out);
        rehearsal.replace(file, "");
    }
}

/// Set for the run of the next test that skips itself.
const SKIPS: &str = "FACEWIRE_TEST_SKIPS";

#[test]
fn a_test_that_skips_itself_is_listed_by_its_name() {
    if std::env::var_os(SKIPS).is_some() {
        return common::skip("this machine lacks\nsomething\n");
    }
    let (_alone, list) = (alone(), tempfile::NamedTempFile::new().unwrap());
    let mut this = Command::new(std::env::current_exe().unwrap());
    this.args(["--exact", "a_test_that_skips_itself_is_listed_by_its_name", "--test-threads", "2"]);
    Run::of(this.env(SKIPS, "1").env("FACEWIRE_SKIPPED", list.path())).succeeded();
    let want = "scripts a_test_that_skips_itself_is_listed_by_its_name: this machine lacks something\n";
    assert_eq!(fs::read_to_string(list.path()).unwrap(), want);
}
