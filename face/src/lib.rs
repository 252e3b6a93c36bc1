//! The method of facewire: a picture of a face goes in, blendshape coefficients and the pose of the head come out.
//!
//! ```text
//! Picture -> FaceBox -> Landmarks -> Normalised -> Features -> Coefficients -> correct -> filter -> Solution
//!           detect      mesh         affine T_a    S, T_d      R  ^           eq. 7, 8    F
//!                        |                                        |
//!                        +-> Appearance -> residual --------------+
//! ```
//!
//! [`Tracker`] follows a face from one [`Picture`] to the next and finds its [`Landmarks`]; [`Solver`] turns them into a
//! [`Solution`]. Neither allocates after it was made, reads a clock or writes a log. Only loading networks and models reads
//! files. The crate `facewire-library` puts both behind one type, with examples.

mod infer;
pub mod model;
mod picture;
mod profile_file;
#[doc(hidden)]
pub mod settings;
mod solve;
#[cfg(any(test, feature = "testing"))]
#[allow(missing_docs, clippy::indexing_slicing, clippy::panic, clippy::missing_panics_doc)]
pub mod testing;
mod track;

pub use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use infer::{Engine, EngineChoice, InferError, engine};
pub use model::{Model, ModelError};
pub use picture::{MAX_SIDE_PX, Picture, Pixels, Rotation};
pub use solve::{
    Adjustment, Adjustments, Camera, Filter, FilterKind, Filters, GAINS, Gaze, Group, HeadPose, MAX_REST, Method,
    Neutral, NeutralMode, Profile, Rules, Shaping, Solution, SolveError, Solver, Wears,
};
pub use track::{
    Appearance, EyeValues, Face, FaceBox, Follow, LANDMARKS, Landmarks, Looks, MESH, MouthValues, Tracker,
};

/// The single stages, for engines and for programs that measure, train or calibrate.
pub mod stages {
    pub use crate::infer::{Network, NetworkFolder, Signature, engines, native_network};
    pub use crate::profile_file::{MAX_PROFILE_BYTES, ProfileFile};
    pub use crate::solve::{
        Coefficients, FaceMean, Features, FiltersState, MIRRORED, Normalised, Reference, correct, keep_in_view,
        mirror_image, normalise,
    };
    pub use crate::track::{
        Block, Border, CropShape, Detector, EYE_SIDE, Eyes, InView, MOUTH_SIDE, Mesh, Mouth, Rows, Visible, Wearer,
        bounds, crop,
    };
}
