//! Why a model cannot be used.
//!
//! The build script compiles this file, too.

use std::{io, path::PathBuf};

use thiserror::Error;

/// The format of model files that this program reads.
pub(super) const FORMAT: u32 = 2;

/// A model that cannot be used.
#[derive(Debug, Error)]
pub enum ModelError {
    /// The file is missing or cannot be read. It may be later: its disk may not be mounted yet.
    #[error("the model {} cannot be read ({source}); check the path and its permissions", path.display())]
    Unreadable {
        /// The path of the file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The file is not TOML, or lacks entries, or has other entries.
    #[error("the model file is damaged in line {line} ({reason}); restore it or fit it again")]
    Damaged {
        /// Number of the line, from 1.
        line: usize,
        /// The error of the parser.
        reason: String,
    },
    /// The file was written for another version of this program.
    #[error("the model file has format {found}, this program reads format {FORMAT}; fit it again with facewire-fit")]
    WrongFormat {
        /// The format of the file.
        found: u32,
    },
    /// A blendshape is missing.
    #[error("the model file has no {table}.{blendshape}; restore it or fit it again")]
    Missing {
        /// The table of the file.
        table: &'static str,
        /// The name of the blendshape.
        blendshape: &'static str,
    },
    /// An entry is missing.
    #[error("the model file has no {entry}; restore it or fit it again")]
    Absent {
        /// Table and name of the entry.
        entry: String,
    },
    /// An entry is not a list of as many weights as there must be.
    #[error("{entry} of the model file is not the list of weights that it must be; restore the file")]
    NotWeights {
        /// Table and name of the entry.
        entry: String,
    },
    /// A name that this program does not know.
    #[error("the model file names an unknown {name:?} in {table}; fit it again with facewire-fit")]
    Unknown {
        /// The table of the file.
        table: String,
        /// The unknown name.
        name: String,
    },
    /// A number that is not finite, or too large for single precision.
    #[error("the weight {name:?} in {table} of the model file is not a finite number; restore the file")]
    NotFinite {
        /// The table of the file.
        table: String,
        /// The name of the number.
        name: String,
    },
    /// More numbers than the program has room for.
    #[error("{table} of the model file has more weights than this program holds; fit it again with fewer")]
    TooMany {
        /// The table of the file.
        table: String,
    },
}
