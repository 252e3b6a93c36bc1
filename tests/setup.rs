//! What `scripts/setup` prints while it waits for another package manager, or for a step that takes minutes.
//!
//! Stand-ins replace the programs that it starts. Nothing is installed, and no test waits for a fixed time.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs::{self, Permissions};
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::PathBuf;
use std::process::{ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use common::program::{Run, text};
use common::{PATIENCE, project};
use tempfile::TempDir;

/// What apt prints on Debian 12 while another package manager updates the package lists.
const HELD: &str = "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 4711 (unattended-upgr)";
const WAITS: &str = "setup: another package manager is at work: waiting for it (Could not get lock /var/lib/apt/lists/lock. \
                     It is held by process 4711 (unattended-upgr))\n";
/// What `apt-get update` prints without a network. It succeeds nevertheless.
const UNREACHED: &str =
    "W: Failed to fetch http://deb.debian.org/debian/dists/bookworm/InRelease  Temporary failure resolving";

/// A machine on which only stand-ins and the programs of the base system are installed. Only one exists at a time: a process
/// that one test starts inherits the files that another test is writing, and the system runs no program that is open for
/// writing.
struct Machine {
    folder: TempDir,
    _one: MutexGuard<'static, ()>,
}

static ONE_MACHINE: Mutex<()> = Mutex::new(());

impl Machine {
    /// A machine that has everything that a build needs except cmake. Its `apt-get` installs cmake, unless the file `held`
    /// (another package manager is at work), `offline` (there is no network) or `broken` (packages contradict each other)
    /// exists. It appends its arguments to the file `asked`.
    fn new() -> Self {
        let one = ONE_MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
        let machine = Self { folder: tempfile::tempdir().unwrap(), _one: one };
        fs::create_dir(machine.path("bin")).unwrap();
        let search_path = std::env::var_os("PATH").unwrap();
        let usual = "bash env sh cat cut dirname grep head mkdir mktemp printf rm sed sort tail flock ln";
        for program in usual.split(' ') {
            let mut places = std::env::split_paths(&search_path).map(|folder| folder.join(program));
            symlink(places.find(|path| path.exists()).unwrap(), machine.path("bin").join(program)).unwrap();
        }
        for program in ["pkg-config", "nasm", "make", "python3"] {
            machine.stand_in(program, "");
        }
        // It gets a program on its standard input.
        machine.stand_in("cc", "cat >/dev/null");
        machine.stand_in("cargo", "echo cargo 99.0.0");
        machine.stand_in("sudo", "shift; exec \"$@\"");
        let apt = format!(
            "cd {folder}; echo \"$@\" >>asked\n\
             if [ -e held ]; then echo '{HELD}' >&2; exit 100; fi\n\
             if [ -e offline ]; then\n\
             case \"$*\" in *update*) echo '{UNREACHED}' >&2; exit 0 ;; esac\n\
             echo 'E: Unable to locate package cmake' >&2; exit 100; fi\n\
             if [ -e broken ]; then echo 'E: You have held broken packages.' >&2; exit 100; fi\n\
             case \"$*\" in *install*cmake*) ln -s nasm bin/cmake ;; esac",
            folder = text(machine.folder.path()),
        );
        machine.stand_in("apt-get", &apt);
        machine
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn stand_in(&self, program: &str, commands: &str) {
        let path = self.path("bin").join(program);
        fs::write(&path, format!("#!/bin/sh\n{commands}\n")).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
    }

    fn file(&self, name: &str) {
        fs::write(self.path(name), "").unwrap();
    }

    fn setup(&self, step: &str) -> Command {
        let mut command = Command::new(project("scripts/setup"));
        command.arg(step).env("PATH", self.path("bin")).env("XDG_CACHE_HOME", self.path("cache"));
        command.env("LIBCLANG_PATH", "/").env_remove("RUSTUP_TOOLCHAIN");
        // Progress messages stay off, however slow the machine is. Tests of them set this variable again.
        command.env("FACEWIRE_PROGRESS_S", "86400");
        command
    }

    fn asked(&self) -> String {
        fs::read_to_string(self.path("asked")).unwrap_or_default()
    }
}

/// Passes on the lines of a program's output as they come.
fn lines_of(out: ChildStdout) -> Receiver<String> {
    let (sender, lines) = mpsc::channel();
    thread::spawn(move || BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
    lines
}

#[test]
fn setup_waits_while_another_package_manager_is_at_work_and_says_so_once() {
    let machine = Machine::new();
    machine.file("held");
    // The other package manager ends while `scripts/setup` waits for the third time.
    let ends = "cd FOLDER; echo waited >>waits; [ \"$(grep -c . waits)\" -lt 3 ] || rm -f held";
    machine.stand_in("sleep", &ends.replace("FOLDER", text(machine.folder.path())));
    let run = Run::of(&mut machine.setup("system")).succeeded();
    assert_eq!((run.out, run.err.as_str()), (format!("setup: installing cmake\n{WAITS}"), ""));
    let install = "--quiet=2 install --no-install-recommends --yes cmake\n";
    assert_eq!(machine.asked(), format!("{}{install}", "--quiet=2 update\n".repeat(4)));
    let again = Run::of(&mut machine.setup("system")).succeeded();
    assert_eq!((again.out.as_str(), again.err.as_str()), ("", ""), "nothing is missing");
}

#[test]
fn a_long_wait_for_another_package_manager_is_told_again_with_its_time() {
    let machine = Machine::new();
    machine.file("held");
    let ends = "cd FOLDER; echo waited >>waits; [ \"$(grep -c . waits)\" -lt 3 ] || rm -f held";
    machine.stand_in("sleep", &ends.replace("FOLDER", text(machine.folder.path())));
    let run = Run::of(machine.setup("system").env("FACEWIRE_PROGRESS_S", "0.05")).succeeded();
    let again = "setup: waiting for the other package manager: for ";
    assert_eq!(run.out.lines().filter(|line| line.starts_with(again)).count(), 2, "{run:?}");
}

#[test]
fn a_package_manager_that_never_ends_is_told_from_a_machine_that_is_offline_and_from_other_trouble() {
    let machine = Machine::new();
    machine.stand_in("sleep", "");
    machine.file("broken");
    let run = Run::of(&mut machine.setup("system"));
    let sentence = "setup: could not install cmake: the lines above say why. By hand: apt-get";
    assert!(run.status == Some(1) && run.err.contains("E: You have held broken packages."), "{run:?}");
    assert!(run.err.contains(sentence), "{run:?}");
    machine.file("offline");
    let run = Run::of(&mut machine.setup("system"));
    let sentence =
        "setup: could not install cmake, because apt reaches no server: is this machine online? Behind a proxy, set";
    assert!(run.status == Some(1) && run.err.contains(sentence), "{run:?}");
    assert!(!run.out.contains("another package manager"), "{run:?}");
    machine.file("held");
    let run = Run::of(&mut machine.setup("system"));
    assert!(run.status == Some(1) && run.out.ends_with(WAITS), "{run:?}");
    assert!(run.err.contains("another package manager has been at work for ten minutes"), "{run:?}");
    assert!(!run.err.contains("online"), "{run:?}");
}

#[test]
fn a_step_that_takes_minutes_says_what_it_is_doing_and_its_output_is_shown_only_if_it_fails() {
    let machine = Machine::new();
    machine.stand_in("c++", "");
    let status_file = machine.path("status");
    // It runs until the file `status` gives its exit status, or until the test has ended.
    let builds = "[ $1 = install ] || exit 1; echo '   Compiling libfuzzer v1.2.3' >&2; cd FOLDER\n\
                  while [ -e bin ] && [ ! -e status ]; do /bin/sleep 0.05; done; read status <status; exit $status";
    machine.stand_in("cargo", &builds.replace("FOLDER", text(machine.folder.path())));
    let build = |status: &str| {
        let mut command = machine.setup("fuzz");
        command.env("FACEWIRE_PROGRESS_S", "0.05").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut setup = command.spawn().unwrap();
        let lines = lines_of(setup.stdout.take().unwrap());
        assert_eq!(lines.recv_timeout(PATIENCE).unwrap(), "setup: building cargo-fuzz (some minutes)");
        // Some lines may come before the program has printed anything.
        let begun = "setup: building cargo-fuzz (some minutes): for ";
        let mut line = String::new();
        while !line.ends_with(" s now, at: Compiling libfuzzer v1.2.3") {
            line = lines.recv_timeout(PATIENCE).unwrap();
            assert!(line.starts_with(begun), "{line}");
        }
        // The renamed file appears together with its contents, as the program may read it at any moment.
        fs::write(machine.path("status.new"), format!("{status}\n")).unwrap();
        fs::rename(machine.path("status.new"), &status_file).unwrap();
        let run = Run::ended(&setup.wait_with_output().unwrap());
        fs::remove_file(&status_file).unwrap();
        run
    };
    let run = build("0");
    assert_eq!((run.status, run.err.as_str()), (Some(0), ""));
    let run = build("7");
    let want = "   Compiling libfuzzer v1.2.3\nsetup: could not build cargo-fuzz: ";
    assert!(run.status == Some(1) && run.err.starts_with(want), "{run:?}");
}

#[test]
fn no_script_calls_apt_but_by_the_function_that_waits() {
    let folders = ["scripts", "cross", "tests/guest", "packaging", "python", "fuzz", "systemd"].map(project);
    let entries = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap());
    let scripts = entries.map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    for script in scripts.filter(|path| !path.ends_with("scripts/waiting.sh")) {
        let commands = fs::read(&script).unwrap();
        for line in String::from_utf8_lossy(&commands).lines() {
            // A comment or a text may name the program.
            let code = line.split(['#', '\'']).next().unwrap();
            let words: Vec<&str> = code.split_whitespace().collect();
            let Some(at) = words.iter().position(|word| *word == "apt-get") else { continue };
            let is_command = at == 0
                || ["sudo", "env", "if", "!", "then", "&&", "||", "\"${become[@]}\""].contains(&words[at - 1])
                || words[at - 1].contains('=');
            let changes = words[at..].iter().any(|word| ["update", "install"].contains(word));
            // Lists in a folder of their own have no lock that others hold.
            let is_apart = words.iter().any(|word| word.starts_with("--config-file="));
            assert!(!(is_command && changes) || is_apart, "{}: {line}", script.display());
        }
    }
}
