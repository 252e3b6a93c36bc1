//! Takes a picture: renders backdrop and person and simulates the camera. Measures the time of each step.

use std::ops::AddAssign;

use anyhow::Result;
use glam::Vec2;
use rustix::time::{ClockId, clock_gettime};

use super::{
    assets::Assets,
    camera::Camera,
    render::Renderer,
    sample::{PictureSpec, Subject},
};

/// CPU times in seconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Times {
    /// Rendering.
    pub render: f64,
    /// Camera effects and compression.
    pub camera: f64,
    /// Decoding, detector and mesh.
    pub tracking: f64,
}

impl AddAssign for Times {
    fn add_assign(&mut self, other: Self) {
        self.render += other.render;
        self.camera += other.camera;
        self.tracking += other.tracking;
    }
}

/// Renderer and camera for pictures of one size.
pub struct Imager {
    width: usize,
    renderer: Renderer,
    camera: Camera,
    pixels: Vec<[f32; 3]>,
    /// CPU times so far.
    pub times: Times,
}

impl Imager {
    /// Allocates all buffers. Pictures have at least `least_density` samples per side of a pixel.
    pub fn new(size: [usize; 2], least_density: f32) -> Result<Self> {
        let pixels = vec![[0.0; 3]; size[0] * size[1]];
        let (renderer, camera) = (Renderer::new(size, least_density), Camera::new(size)?);
        Ok(Self { width: size[0], renderer, camera, pixels, times: Times::default() })
    }

    /// Renders a picture and returns it as a JPEG image.
    pub fn take_picture(&mut self, assets: &Assets, subject: &mut Subject, spec: &PictureSpec) -> Result<Vec<u8>> {
        let start = thread_time_s();
        subject.backdrop().fill(self.width, &mut self.pixels);
        self.renderer.draw(assets, &subject.person, &spec.scene, &mut self.pixels);
        let drawn = thread_time_s();
        let jpeg = self.camera.capture(&mut self.pixels, &spec.effects, subject.rng())?;
        self.times += Times { render: drawn - start, camera: thread_time_s() - drawn, tracking: 0.0 };
        Ok(jpeg)
    }

    /// Returns the pixel positions of the outer eye corners in the last picture: the person's right, then left.
    pub fn eye_corners(&self, assets: &Assets) -> [Vec2; 2] {
        self.renderer.eye_corners(assets)
    }
}

/// Returns the CPU time of this thread in seconds.
pub fn thread_time_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    #[expect(clippy::cast_precision_loss, reason = "seconds of one run")]
    let seconds = time.tv_sec as f64 + time.tv_nsec as f64 / 1e9;
    seconds
}
