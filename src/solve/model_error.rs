//! Why a model cannot be used.
//!
//! The build script compiles this file, too.

use std::{io, path::PathBuf};

use thiserror::Error;

/// The format of model files that this program reads.
pub(super) const FORMAT: u32 = 3;

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
    /// The file has no regression, or two.
    #[error(
        "the model file must have either offsets with inputs and blendshapes, or formulas; restore it or fit it again"
    )]
    NotOneRegression,
    /// A blendshape, or a feature that a formula uses, is missing.
    #[error("the model file has no {entry}; restore it or fit it again")]
    Missing {
        /// The entry of the file.
        entry: String,
    },
    /// A feature does not vary, so that it cannot be scaled.
    #[error("the deviation of {name:?} in {table} of the model file is not above 0; restore it or fit it again")]
    NoDeviation {
        /// The table of the file.
        table: String,
        /// The name of the feature.
        name: String,
    },
    /// Corrective terms would change the order of values.
    #[error(
        "{table} of the model file does not keep the order of values: slope must be above 0, lift at least 0, and response two rising numbers from 0 on; restore it or fit it again"
    )]
    OutOfOrder {
        /// The table of the file.
        table: String,
    },
    /// A formula that is not quadratic has products.
    #[error("{table} of the model file has products, but its kind is not quadratic; restore it or fit it again")]
    UnexpectedProducts {
        /// The table of the file.
        table: String,
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
    #[error("the number {name:?} in {table} of the model file is not finite; restore the file")]
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
