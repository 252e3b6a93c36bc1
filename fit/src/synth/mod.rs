//! Synthesises faces with known coefficients: a software renderer for a face rig, and a sampler of people, expressions,
//! lighting and cameras.
//!
//! ```text
//! Subject -> PictureSpec -> Head -> samples -> light -> JPEG -> Landmarks -> archive
//! sample     sample         render  canvas     canvas   camera  worker       archive
//!            acting, prototypes, anatomy, script        expression, tongue, scene, shade, paint
//! ```
//!
//! Contract: a subject's pictures depend on nothing but the seed and the subject's number. Limits: the renderer shows
//! no tear film, pores or single hairs, and eyes, teeth and lips are where the rig has them.

pub mod acting;
pub mod anatomy;
pub mod archive;
pub mod assets;
pub mod camera;
pub mod canvas;
pub mod describe;
pub mod expression;
pub mod film;
pub mod occluders;
pub mod options;
pub mod paint;
pub mod person;
pub mod props;
pub mod prototypes;
pub mod render;
pub mod rig;
pub mod run;
pub mod sample;
pub mod scene;
pub mod script;
pub mod shade;
pub mod textures;
pub mod tongue;
pub mod variety;
pub mod visible;
pub mod worker;
