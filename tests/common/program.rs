//! Runs the program as a user runs it.

use std::ffi::OsStr;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread;

use tempfile::NamedTempFile;

use super::hooks::hook;

/// Returns a command that runs the program with these arguments, on a board that is not recognised and has no sensors,
/// so that the heat and the power saving of this machine do not affect the tests.
pub fn facewire<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_facewire"));
    command.args(arguments).env("FACEWIRE_SYSROOT", "/nonexistent");
    command.env("LD_PRELOAD", hook("answers"));
    // Services that tests run side by side must not meet at one control socket, nor find the profiles of this machine.
    for variable in ["RUNTIME_DIRECTORY", "STATE_DIRECTORY"] {
        command.env_remove(variable);
    }
    // Without the variable, the folder of the user would do.
    command.env("XDG_RUNTIME_DIR", "");
    command.env("XDG_STATE_HOME", concat!(env!("CARGO_TARGET_TMPDIR"), "/state"));
    command
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

pub fn settings(toml: &str) -> NamedTempFile {
    let mut file = NamedTempFile::with_suffix(".toml").unwrap();
    file.write_all(toml.as_bytes()).unwrap();
    file
}

#[derive(Debug)]
pub struct Run {
    pub status: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Run {
    /// Runs to the end, with nothing on standard input.
    pub fn of(command: &mut Command) -> Self {
        Self::ended(&command.stdin(Stdio::null()).output().unwrap())
    }

    /// Runs to the end with these bytes on standard input.
    pub fn fed(command: &mut Command, input: &[u8]) -> Self {
        let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let output = thread::scope(|scope| {
            // A program that refuses its input closes it early.
            scope.spawn(move || drop(stdin.write_all(input)));
            child.wait_with_output().unwrap()
        });
        Self::ended(&output)
    }

    /// Takes the result of a process that has ended. A panic of the process fails the test.
    pub fn ended(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        let run = Self { status: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) };
        assert!(!run.err.contains("panicked"), "{run:?}");
        run
    }

    /// Returns the run if it succeeded, and fails the test otherwise.
    pub fn succeeded(self) -> Self {
        assert_eq!(self.status, Some(0), "{}", self.err);
        self
    }

    /// Returns the sentences on standard error of a run that failed with `status`, without the count of frames, what a service
    /// logs before it fails, and what `facewire rest` says of boards that it is still trying.
    pub fn sentences(&self, status: i32) -> Vec<&str> {
        assert_eq!(self.status, Some(status), "{}", self.err);
        let named = |line| str::strip_prefix(line, "facewire: ").unwrap_or_else(|| panic!("not a sentence: {line}"));
        let is_logged = |line: &str| line.contains(" INFO ") || line.contains("no control socket");
        let sentences = self.err.lines().filter(|line| !is_logged(line)).map(named);
        sentences.filter(|line| !line.contains(" frames, ") && !line.starts_with("still trying: ")).collect()
    }

    /// Returns the only sentence of a run that failed with `status`.
    pub fn sentence(&self, status: i32) -> &str {
        let sentences = self.sentences(status);
        assert_eq!(sentences.len(), 1, "{}", self.err);
        sentences[0]
    }
}
