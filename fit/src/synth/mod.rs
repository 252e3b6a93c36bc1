//! Synthesises faces with known coefficients: a software renderer for a face rig, and a sampler of people, expressions,
//! lighting and cameras.
//!
//! ```text
//! Subject -> PictureSpec -> Head -> samples -> light -> JPEG -> Landmarks -> archive
//! sample     sample         render  canvas     canvas   camera  worker       archive
//!            acting, anatomy, script        expression, tongue, scene, shade, paint
//! ```
//!
//! Contract: a subject's pictures depend on nothing but the seed and the subject's number. Limits: the renderer shows
//! no tear film, pores or single hairs, and eyes, teeth and lips are where the rig has them.

mod acting;
pub mod anatomy;
mod archive;
mod assets;
mod camera;
mod canvas;
pub mod describe;
pub mod expression;
pub mod film;
mod options;
mod paint;
mod person;
mod props;
mod render;
mod rig;
pub mod run;
mod sample;
mod scene;
mod script;
mod shade;
mod textures;
mod tongue;
mod variety;
mod worker;
