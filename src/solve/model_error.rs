//! Why a model cannot be used.

use std::path::PathBuf;

use thiserror::Error;

use super::model_file::FORMAT;

/// A model file that cannot be used.
#[derive(Debug, Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error("the model {} cannot be read ({source}); check the path and its permissions", path.display())]
    Unreadable {
        /// Where it was looked for.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML, or not of this layout.
    #[error("the model file is damaged in line {line} ({reason}); restore it or fit it again")]
    Damaged {
        /// Where, from 1.
        line: usize,
        /// What the parser says.
        reason: String,
    },
    /// Made for another version of this program.
    #[error("the model file has format {found}, this program reads format {FORMAT}; fit it again with facewire-fit")]
    WrongFormat {
        /// The format of the file.
        found: u32,
    },
    /// A blendshape is missing.
    #[error("the model file has no {table}.{blendshape}; restore it or fit it again")]
    Missing {
        /// Table of the file.
        table: &'static str,
        /// Name of the blendshape.
        blendshape: &'static str,
    },
    /// A name that this program does not know.
    #[error("the model file names an unknown {name:?} in {table}; fit it again with facewire-fit")]
    Unknown {
        /// Table of the file.
        table: String,
        /// The name.
        name: String,
    },
    /// A weight that is not finite, or too large to be one.
    #[error("the weight {name:?} in {table} of the model file is not a finite number; restore the file")]
    NotFinite {
        /// Table of the file.
        table: String,
        /// Name of the weight.
        name: String,
    },
    /// More weights than fit.
    #[error("{table} of the model file has more weights than this program holds; fit it again with fewer")]
    TooMany {
        /// Table of the file.
        table: String,
    },
}
