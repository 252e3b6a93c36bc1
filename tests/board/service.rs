//! `facewire run` whose log goes to a file, for tests of links.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use super::board::eventually;
use super::program::{facewire, text};

/// A running service. It is killed when the test ends, however that ends.
pub struct Service {
    child: Child,
    folder: TempDir,
}

impl Service {
    /// Starts the service with these settings.
    pub fn with(settings: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = configuration(folder.path(), settings);
        let log = File::create(folder.path().join("log")).unwrap();
        let mut command = facewire(["run", "--config", text(&config)]);
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log).spawn().unwrap();
        Self { child, folder }
    }

    /// What the service has logged so far.
    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    /// How many times the log contains this text.
    pub fn logged(&self, what: &str) -> usize {
        self.log().matches(what).count()
    }

    /// Gives the service other settings while it runs, and waits until it has them.
    pub fn reload(&self, settings: &str) {
        configuration(self.folder.path(), settings);
        let before = self.logged("settings changed");
        self.signal(Signal::HUP);
        eventually("the new settings", || self.logged("settings changed") > before);
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Stops the service as systemd does. Returns its log.
    pub fn stop(mut self) -> String {
        self.signal(Signal::TERM);
        let status = self.child.wait().unwrap();
        assert_eq!(status.code(), Some(0), "{}", self.log());
        self.log()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Writes settings to a file in the folder, and returns its path.
pub fn configuration(folder: &Path, settings: &str) -> PathBuf {
    let path = folder.join("facewire.toml");
    fs::write(&path, settings).unwrap();
    path
}
