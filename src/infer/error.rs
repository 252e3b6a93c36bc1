//! Why a network cannot be loaded or run.

use std::io;
use std::path::{Path, PathBuf};

/// Why a network cannot be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum InferError {
    /// No folder on the search path exists.
    #[error(
        "the landmark networks are not installed: looked in {}; run scripts/setup, or set networks.folder",
        list(.0)
    )]
    NoFolder(Vec<PathBuf>),
    /// This user has no right to read a folder or a file.
    #[error("{} cannot be read ({error}); give this user the right to read it and all folders above it", path.display())]
    Unreadable {
        /// The folder or file.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// A file of the folder does not exist.
    #[error("{} is missing: run {}", .0.display(), remedy(.0))]
    Missing(PathBuf),
    /// The ONNX Runtime library does not load.
    #[error("ONNX Runtime cannot be loaded from {}: {reason}; run {}", path.display(), remedy(path))]
    Library {
        /// The library file.
        path: PathBuf,
        /// The loader's message, on one line.
        reason: String,
    },
    /// A network file is damaged, or its input and outputs differ from the signature.
    #[error("{} is damaged or of another version ({reason}): run {}", path.display(), remedy(path))]
    Damaged {
        /// The network file.
        path: PathBuf,
        /// The engine's message, on one line.
        reason: String,
    },
    /// This build does not contain the engine that the settings choose.
    #[error(
        "this facewire was built without ONNX Runtime: set networks.engine = \"native\", or build it with the feature `ort`"
    )]
    NotBuilt,
    /// The system refuses a thread.
    #[error(
        "the system refused a thread for the networks ({0}); raise the limit of threads (systemd: TasksMax), or lower \
         networks.threads"
    )]
    Threads(io::Error),
    /// The engine failed during an inference.
    #[error(
        "network {network} failed to run ({reason}); free some memory, and if that does not help, run scripts/setup onnxruntime"
    )]
    Run {
        /// Name of the network.
        network: &'static str,
        /// The engine's message, on one line.
        reason: String,
    },
}

/// Returns the command that installs a file of the folder.
fn remedy(path: &Path) -> &'static str {
    let is_native = path.extension().is_some_and(|extension| extension == super::native::EXTENSION);
    if is_native { "scripts/setup" } else { "scripts/setup onnxruntime" }
}

fn list(paths: &[PathBuf]) -> String {
    let shown: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    shown.join(", ")
}

/// Returns the message of an engine on one line and without control characters. A message that is too long is cut and
/// ends in an ellipsis.
#[cfg(any(feature = "ort", test))]
pub(super) fn one_line(message: impl std::fmt::Display) -> String {
    /// Two to three lines of a terminal.
    const MAX_BYTES: usize = 240;
    let message = message.to_string();
    let words = message.split(|character: char| character.is_whitespace() || character.is_control());
    let mut line = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
    if line.len() > MAX_BYTES {
        line.truncate(line.floor_char_boundary(MAX_BYTES - '…'.len_utf8()));
        line.push('…');
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_of_several_lines_becomes_one_line() {
        assert_eq!(one_line("\nno memory:\r\n\t 4 GB\x1b[31m\u{85}wanted \n"), "no memory: 4 GB [31m wanted");
    }

    #[test]
    fn a_long_message_is_cut_at_a_character_and_ends_in_an_ellipsis() {
        assert_eq!(one_line("ü".repeat(500)), format!("{}…", "ü".repeat(118)));
        let whole = "x".repeat(240);
        assert_eq!(one_line(&whole), whole);
    }
}
