//! The virtual environments of Python that hold other people's receivers.

use std::path::PathBuf;
use std::process::Command;

/// Returns the Python of this virtual environment, made by `scripts/setup`, or `None` if it cannot import this module.
pub fn python_with(environment: &str, module: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))?;
    let python = cache.join("facewire").join(environment).join("bin/python");
    let imported = Command::new(&python).args(["-c", &format!("import {module}")]).output();
    imported.is_ok_and(|output| output.status.success()).then_some(python)
}
