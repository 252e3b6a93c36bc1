//! Faces with known coefficients: a software renderer for a face rig, and a sampler of people, expressions, light
//! and cameras.
//!
//! ```text
//! Subject -> Take -> Head -> samples -> light -> JPEG -> Landmarks -> archive
//! sample     sample  render  raster     canvas   camera  finder       dataset
//!            acting  expression, scene, shade, paint
//! ```
//!
//! Contract: a subject's pictures depend on the seed and its number alone. Limits: light and texture are those of a
//! head without tear film, pores or single hairs; eyes, teeth and lips lie where the rig has them.

mod acting;
mod amplitude;
mod archive;
mod avi;
mod backdrop;
mod booth;
mod brows;
mod bust;
mod camera;
mod canvas;
mod expression;
mod eyes;
pub mod film;
mod finder;
mod geometry;
mod kit;
mod options;
mod paint;
mod person;
mod progress;
mod raster;
mod recording;
mod render;
mod rig;
pub mod run;
mod sample;
mod scene;
mod set;
mod shade;
mod shadow;
mod shards;
mod skin;
mod texture;
mod worker;
