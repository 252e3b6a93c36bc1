//! What the scripts say before they set anything up.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::program::Run;
use tempfile::TempDir;

fn script(name: &str) -> Command {
    Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts").join(name))
}

/// A folder with programs that print these words in place of the system's.
fn programs(words: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, word) in words {
        let path = folder.path().join(name);
        fs::write(&path, format!("#!/bin/sh\necho {word}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    folder
}

#[test]
fn a_machine_without_onnx_runtime_is_told_before_anything_is_installed() {
    for (machine, bits) in [("armv7l", "32"), ("aarch64", "32"), ("riscv64", "64")] {
        let stand_ins = programs(&[("uname", machine), ("getconf", bits)]);
        let path = format!("{}:{}", stand_ins.path().display(), std::env::var("PATH").unwrap());
        let cache = stand_ins.path().join("cache");
        let run = Run::of(script("setup").env("PATH", path).env("XDG_CACHE_HOME", &cache));
        assert_eq!(run.status, Some(1), "{}", run.err);
        let want = format!(
            "setup: the landmark networks need a 64-bit system on x86-64 or ARM, this is {machine} with {bits} bits: on a \
             Raspberry Pi install Raspberry Pi OS (64-bit)\n"
        );
        assert_eq!((run.out.as_str(), run.err), ("", want));
        assert!(!cache.exists());
    }
}

#[test]
fn help_of_the_scripts_sets_nothing_up() {
    let folder = tempfile::tempdir().unwrap();
    let cache: PathBuf = folder.path().join("cache");
    for name in ["compare", "setup"] {
        let run = Run::of(script(name).arg("--help").env("XDG_CACHE_HOME", &cache)).succeeded();
        assert!(run.out.contains("Usage: scripts/") && run.err.is_empty(), "{name}: {}{}", run.out, run.err);
        assert!(!cache.exists());
    }
}
