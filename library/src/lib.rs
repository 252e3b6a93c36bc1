//! Follows faces in pictures: a picture goes in, and landmarks, blendshape coefficients, head pose and gaze come out.
//!
//! ```
//! use std::time::Duration;
//!
//! use facewire_library::{FaceTracker, Format};
//!
//! # fn main() -> Result<(), facewire_library::Error> {
//! let mut tracker = FaceTracker::new()?;
//! # let frames = [vec![0; 640 * 480 * 3]];
//! for (number, frame) in (0..).zip(&frames) {
//!     let picture = Format::Bgr.picture(frame, [640, 480])?;
//!     if let Some(face) = tracker.process(&picture, Duration::from_millis(33 * number))? {
//!         let [yaw, pitch, roll] = face.head.yaw_pitch_roll_deg();
//!         println!("jawOpen {:.2}, turned by {yaw:.0} {pitch:.0} {roll:.0}", face.coefficient("jawOpen").unwrap_or(0.0));
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! The examples read a folder of pictures, a film and a webcam:
//!
//! ```text
//! cargo run --release -p facewire-library --example pictures FOLDER
//! cargo run --release -p facewire-library --example film src/capture/demo.avi > demo.csv
//! cargo run --release -p facewire-library --example webcam
//! ```
//!
//! - A [`Picture`] borrows the samples of its owner in any of the usual formats ([`Format`], [`Pixels`]); nothing is converted
//!   or copied. Times come from the caller, who thus decides how fast a film plays.
//! - [`FaceTracker`] takes all memory when it is made. Its `process` and `process_all` then allocate nothing, except for
//!   stills. It is [`Send`], there is no global state, and it starts no thread, unless [`Options::threads`] asks for helpers.
//! - The networks come from the folder that `scripts/setup networks` fills, from another one ([`Options::networks`]), or are part
//!   of the program, with the feature `built-in`.
//! - Coefficients are those that the service facewire would send, to the last bit, if the settings are the same.
//!
//! The crate follows semantic versioning. `scripts/test` compares its public interface with `library/public-api.txt`, so that
//! it does not change unnoticed. It fails if anything of the last release has been removed and the version is still compatible
//! with that release. Names from `facewire-face` that are not exported here are no part of the interface.

mod error;
mod format;
#[cfg(feature = "built-in")]
mod networks;
mod options;
mod profile;
mod shaping;
mod tracker;

pub use error::Error;
pub use facewire_face::{
    Adjustment, Adjustments, BLENDSHAPES, Camera, Filter, FilterKind, Filters, Gaze, Group, HeadPose, LANDMARKS,
    Landmarks, MAX_SIDE_PX, Method, Neutral, NeutralMode, Picture, Pixels, Profile, Rotation, Rules, Shaping,
    SolveError, Wears,
    stages::{Coefficients, FiltersState, Normalised},
};
pub use facewire_packet::{NeutralFace, Visibility};
pub use format::Format;
pub use options::Options;
pub use profile::{neutral_of, parse_profile, profile_text, read_profile};
pub use shaping::{default_shaping, parse_shaping};
pub use tracker::{Face, FaceTracker};
