//! Synthesises faces with known coefficients: a software renderer for a face rig, and a sampler of people, expressions,
//! lighting and cameras.
//!
//! ```text
//! Subject -> PictureSpec -> Head -> samples -> light -> JPEG -> Landmarks -> archive
//! sample     sample         render  raster     canvas   camera  finder       archive
//!            acting         expression, scene, shade, paint
//!            composing, anatomy, visemes
//! ```
//!
//! Contract: a subject's pictures depend on nothing but the seed and the subject's number. Limits: the renderer shows
//! no tear film, pores or single hairs, and eyes, teeth and lips are where the rig has them.

mod acting;
mod acting_options;
mod amplitude;
mod anatomy;
mod archive;
mod assets;
mod avi;
mod backdrop;
mod blur;
mod brows;
mod bust;
mod camera;
mod canvas;
mod composing;
mod conditions;
pub mod describe;
mod expression;
mod eyes;
mod factors;
pub mod film;
mod finder;
mod geometry;
mod glasses;
mod imager;
mod looks;
mod motion;
mod occluders;
mod options;
mod paint;
mod person;
mod progress;
mod prop_layer;
mod props;
mod raster;
mod recording;
mod render;
mod rig;
mod room;
pub mod run;
mod sample;
mod scene;
mod script;
mod set;
mod shade;
mod shadow;
mod shards;
mod skin;
mod texture;
mod visemes;
mod worker;
mod wrinkles;
