//! The project's own files: the documents refer to what exists, and the scripts and what `systemd/` installs do what they say.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};

use common::program::{Run, text};
use common::project;
use facewire::config::parse_and_check;
use facewire::link::check_settings;

fn files(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

/// The paths of all Markdown files in a folder, except in build outputs and hidden folders.
fn markdown(folder: &Path) -> Vec<PathBuf> {
    let is_visible = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy();
        !name.starts_with('.') && name != "target"
    };
    let visible = files(folder).into_iter().filter(is_visible);
    let (folders, others): (Vec<_>, Vec<_>) = visible.partition(|path| path.is_dir() && !path.is_symlink());
    let of_this_folder = others.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "md"));
    of_this_folder.chain(folders.iter().flat_map(|folder| markdown(folder))).collect()
}

fn documents() -> Vec<(PathBuf, String)> {
    markdown(&project("")).into_iter().map(|path| (path.clone(), fs::read_to_string(path).unwrap())).collect()
}

/// The lines of a document that are not in fences.
fn prose(document: &str) -> impl Iterator<Item = &str> {
    let mut is_fenced = false;
    document.lines().filter(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        is_fenced ^= is_fence;
        !is_fence && !is_fenced
    })
}

/// The links that lead to the headings of a document, as GitHub makes them: lower case, with hyphens for spaces and without
/// other characters. A heading that comes again has a number.
fn anchors(document: &str) -> Vec<String> {
    let mut anchors: Vec<String> = Vec::new();
    let heading = |line: &str| Some(line.trim_start_matches('#').strip_prefix(' ')?.trim().to_lowercase());
    for heading in prose(document).filter(|line| line.starts_with('#')).filter_map(heading) {
        let kept = heading.chars().filter(|character| character.is_alphanumeric() || " -_".contains(*character));
        let anchor = kept.collect::<String>().replace(' ', "-");
        let numbered = (1..).map(|number| format!("{anchor}-{number}"));
        let free = std::iter::once(anchor.clone()).chain(numbered).find(|name| !anchors.contains(name));
        anchors.extend(free);
    }
    anchors
}

#[test]
fn every_link_between_documents_leads_to_a_file_and_to_a_heading_in_it() {
    for (path, document) in documents() {
        let prose = prose(&document).collect::<Vec<_>>().join("\n");
        let links = prose.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for link in links.filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: there is no {link}", path.display());
            let has_heading = || anchors(&fs::read_to_string(&target).unwrap()).iter().any(|anchor| anchor == heading);
            assert!(heading.is_empty() || has_heading(), "{}: {link} has no such heading", path.display());
        }
    }
}

#[test]
fn anchors_follow_the_rule_of_github() {
    let document =
        "# DMX by sACN (E1.31)\n## A `b_c`, d\n```\n# a comment\n```\n## Äpfel - 2\n## Again\n## Again\n#no heading\n";
    assert_eq!(anchors(document), ["dmx-by-sacn-e131", "a-b_c-d", "äpfel---2", "again", "again-1"]);
}

/// Messages refer to documents in parentheses: `(docs/NAME.md)` or `(docs/NAME.md, "Heading")`.
#[test]
fn every_document_that_a_message_names_exists_and_has_the_heading_that_it_names() {
    let messages = ["src", "board", "servo", "tools", "console"].map(|folder| sources(&project(folder))).concat();
    let mut count = 0;
    for reference in messages.split("(docs/").skip(1).filter_map(|rest| rest.split(')').next()) {
        let (name, heading) = reference.split_once(", ").unwrap_or((reference, ""));
        let document = fs::read_to_string(project("docs").join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let heading = format!("# {}", heading.replace(['\\', '"'], ""));
        assert!(heading == "# " || document.lines().any(|line| line.ends_with(&heading)), "{reference}");
        count += 1;
    }
    assert!(count > 2, "{count} messages");
}

/// The blocks of settings in a document: in a fence marked `toml`, or indented and beginning with a table.
fn settings(document: &str) -> impl Iterator<Item = String> {
    let fenced = document.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap().to_owned());
    let indented = document.split("\n\n").filter(|paragraph| paragraph.starts_with("    ["));
    fenced.chain(indented.map(|paragraph| paragraph.lines().map(|line| line.trim().to_owned() + "\n").collect()))
}

#[test]
fn every_block_of_settings_in_a_document_loads() {
    let check = |settings: &_, faults: &mut _| check_settings(settings, &[], faults);
    let mut with_settings = Vec::new();
    for (path, document) in documents() {
        for block in settings(&document) {
            // Documents show systemd's units, too.
            let is_unit = ["[Service]", "[Unit]", "[Journal]"].iter().any(|table| block.starts_with(table));
            if !is_unit && let Err(faults) = parse_and_check(text(&path), &block, check) {
                panic!("{faults}\nin\n{block}");
            }
            with_settings.push(path.clone());
        }
    }
    for page in ["service", "reference", "receivers", "servo-boards", "stage", "vr", "code", "wiring", "animatronic"] {
        assert!(with_settings.contains(&project(&format!("docs/{page}.md"))), "{page}.md shows no settings");
    }
}

#[test]
fn drawings_are_what_their_script_makes_and_no_text_lies_on_another_or_on_a_line() {
    let run = Run::of(Command::new(project("scripts/draw")).arg("--check"));
    assert_eq!(run.status, Some(0), "{run:?}");
}

#[test]
fn the_picture_in_readme_moves_is_small_and_has_a_text_that_says_what_is_seen() {
    let run = Run::of(Command::new(project("scripts/draw-moving")).arg("--check"));
    assert_eq!(run.status, Some(0), "{run:?}");
}

#[test]
fn only_the_crates_of_a_release_can_be_published() {
    let release = fs::read_to_string(project("scripts/release")).unwrap();
    let (_, list) = release.split_once("\ncrates=(").unwrap();
    let mut listed: Vec<&str> = list.split_once(')').unwrap().0.split_whitespace().collect();
    let folders = files(&project("")).into_iter().chain([project("")]);
    let manifests = folders.filter_map(|folder| fs::read_to_string(folder.join("Cargo.toml")).ok());
    let manifests: Vec<toml::Table> = manifests.map(|manifest| manifest.parse().unwrap()).collect();
    let packages = manifests.iter().map(|manifest| &manifest["package"]);
    let can_be_published =
        |package: &&toml::Value| package.get("publish").is_none_or(|publish| publish.as_bool() != Some(false));
    let mut published: Vec<_> =
        packages.filter(can_be_published).map(|package| package["name"].as_str().unwrap()).collect();
    listed.sort_unstable();
    published.sort_unstable();
    assert_eq!(published, listed);
}

fn sources(folder: &Path) -> String {
    let source = |path: &PathBuf| match path.extension().and_then(|ending| ending.to_str()) {
        None if path.is_dir() => sources(path),
        Some("rs") => fs::read_to_string(path).unwrap(),
        _ => String::new(),
    };
    files(folder).iter().map(source).collect()
}

#[test]
fn every_fault_and_every_case_of_the_tables_names_tests_that_exist() {
    let folders =
        ["src", "servo", "board", "packet", "tests", "face", "console", "tools", "library", "python", "bridge"];
    let tests = folders.map(|folder| sources(&project(folder))).concat();
    let tables = ["docs/faults.md", "tests/cases.md"].map(|table| fs::read_to_string(project(table)).unwrap());
    let is_row = |line: &&str| line.matches('|').count() == 5 && !line.starts_with("|---");
    let rows: Vec<&str> = tables.iter().flat_map(|table| table.lines().filter(is_row)).collect();
    assert!(rows.len() >= 120, "{rows:?}");
    for row in rows {
        let last = row.rsplit('|').nth(1).unwrap().trim();
        let names: Vec<&str> = last.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty() || ["test", "none"].contains(&last), "{row}");
        for name in names {
            let is_case = project("tests/guest/cases").join(name).exists();
            assert!(is_case || tests.contains(&format!("fn {name}()")), "{name}");
        }
    }
}

#[test]
fn the_unit_is_correct_and_exposes_no_more_than_it_did() {
    let checked = Run::of(&mut Command::new(project("systemd/check"))).succeeded();
    if checked.out.contains("skipped") {
        common::skip(&checked.out);
    }
}

/// A rule that matches any webcam or any adapter would move its name to whichever device was plugged in last.
#[test]
fn udev_rules_give_no_device_a_name_and_keep_modemmanager_away_from_boards() {
    let file = fs::read_to_string(project("systemd/99-facewire.rules")).unwrap();
    let rules: Vec<&str> = file.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
    for rule in &rules {
        assert!(!rule.contains("SYMLINK") && !rule.contains("NAME"), "{rule}");
        let is_of_board = rule.starts_with("SUBSYSTEM==\"tty\"") && rule.contains("ATTRS{idVendor}==");
        assert!(is_of_board && rule.ends_with("ENV{ID_MM_DEVICE_IGNORE}=\"1\""), "{rule}");
        // A modem may be behind one of these adapters.
        assert!(["0403", "1a86", "10c4", "067b"].iter().all(|adapter| !rule.contains(adapter)), "{rule}");
    }
}

#[test]
fn installing_puts_everything_in_place_and_keeps_a_configuration_that_is_there() {
    let [dest, networks] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    fs::write(networks.path().join("mesh.fwnet"), "").unwrap();
    let at = |path: &str| dest.path().join(path);
    let install = |options: &[&str]| {
        let mut command = Command::new(project("systemd/install"));
        command.args(["--dest", text(dest.path()), "--networks", text(networks.path())]);
        Run::of(command.args(["--binary", env!("CARGO_BIN_EXE_facewire")]).args(options)).succeeded()
    };
    install(&[]);
    for (file, mode) in [
        ("usr/bin/facewire", 0o755),
        ("usr/lib/facewire/networks/mesh.fwnet", 0o644),
        ("usr/lib/systemd/system/facewire.service", 0o644),
        ("usr/lib/udev/rules.d/99-facewire.rules", 0o644),
        ("usr/share/doc/facewire/service.md", 0o644),
        ("usr/share/doc/facewire/reference.md", 0o644),
    ] {
        assert_eq!(fs::metadata(at(file)).unwrap().permissions().mode() & 0o777, mode, "{file}");
    }
    let configuration = at("etc/facewire/facewire.toml");
    assert_eq!(fs::read(&configuration).unwrap(), fs::read(project("systemd/facewire.toml")).unwrap());
    fs::write(&configuration, "# mine\n").unwrap();
    install(&[]);
    install(&["--uninstall"]);
    assert_eq!(fs::read_to_string(&configuration).unwrap(), "# mine\n");
    assert!(!at("usr/bin/facewire").exists() && !at("usr/lib/facewire").exists());
}

/// Lets one test of scripts run at a time. A process that one test starts would hold the scripts open that another test is
/// writing, and the system refuses to run a program that is open for writing.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn write_script(path: &Path, commands: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, format!("#!/bin/sh\n{commands}\n")).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
}

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
        let mut setup = Command::new(project("scripts/setup"));
        setup.arg("onnxruntime").env("PATH", search_path(stand_ins.path())).env("XDG_CACHE_HOME", &cache);
        let Run { status, out, err } = Run::of(&mut setup);
        let want = format!("setup: there is no ONNX Runtime for {machine} with {bits} bits: leave networks.engine at");
        assert!((status, out.as_str()) == (Some(1), "") && err.starts_with(&want), "{err}");
        assert!(!cache.exists());
    }
}

#[test]
fn help_sets_nothing_up() {
    let (_alone, folder) = (alone(), tempfile::tempdir().unwrap());
    let cache = folder.path().join("cache");
    for name in ["compare", "demo", "package", "setup"] {
        let mut script = Command::new(project("scripts").join(name));
        let run = Run::of(script.arg("--help").env("XDG_CACHE_HOME", &cache)).succeeded();
        assert!(run.out.contains("Usage: scripts/") && run.err.is_empty(), "{name}: {}{}", run.out, run.err);
        assert!(!cache.exists());
    }
}

/// Makes the next test skip itself for this reason.
const SKIPS: &str = "FACEWIRE_TEST_SKIPS";
/// The beginning of a reason that `tests/skips-allowed` allows.
const ALLOWED: &str = "no folder of reference clips";

#[test]
fn a_test_that_skips_itself_is_listed_by_its_name_and_fails_under_ci_unless_that_is_allowed() {
    let name = "a_test_that_skips_itself_is_listed_by_its_name_and_fails_under_ci_unless_that_is_allowed";
    if let Ok(why) = std::env::var(SKIPS) {
        return common::skip(&why);
    }
    let _alone = alone();
    for (why, ci, status) in [
        ("this machine lacks\nsomething\n", "", 0),
        ("this machine lacks\nsomething\n", "true", 101),
        (ALLOWED, "true", 0),
    ] {
        let list = tempfile::NamedTempFile::new().unwrap();
        let mut this = Command::new(std::env::current_exe().unwrap());
        this.args(["--exact", name, "--test-threads", "2"]).env(SKIPS, why).env("CI", ci);
        let ended = this.env("FACEWIRE_SKIPPED", list.path()).output().unwrap();
        assert_eq!(ended.status.code(), Some(status), "{why}, CI={ci}: {ended:?}");
        let want = format!("project {name}: {}\n", why.trim_end().replace('\n', " "));
        assert_eq!(fs::read_to_string(list.path()).unwrap(), want);
    }
}

#[test]
fn every_line_of_what_may_be_skipped_has_a_beginning_and_a_reason() {
    let allowed = fs::read_to_string(project("tests/skips-allowed")).unwrap();
    for line in allowed.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        let (beginning, reason) = line.rsplit_once(": ").unwrap_or_else(|| panic!("no reason: {line}"));
        assert!(beginning.len() > 3 && reason.len() > 3, "{line}");
    }
}

#[test]
fn what_a_script_skips_is_listed_and_fails_under_ci_unless_that_is_allowed() {
    let _alone = alone();
    for (line, ci, status) in [
        ("a step: there is no compiler", "", 0),
        ("a step: there is no compiler", "true", 1),
        (ALLOWED, "true", 0),
        (&format!("a step: {ALLOWED}; get it"), "true", 0),
    ] {
        let list = tempfile::NamedTempFile::new().unwrap();
        let mut skip = Command::new(project("scripts/skip"));
        let run = Run::of(skip.arg(line).env("CI", ci).env("FACEWIRE_SKIPPED", list.path()));
        assert_eq!(run.status, Some(status), "{line}, CI={ci}: {run:?}");
        assert_eq!(fs::read_to_string(list.path()).unwrap(), format!("{line}\n"));
        assert!(run.err.contains(line), "{run:?}");
    }
}
