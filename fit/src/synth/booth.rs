//! Taking a picture: backdrop, person, camera, with the time that each part took.

use std::ops::AddAssign;

use anyhow::Result;
use glam::{Vec2, Vec3};
use rustix::time::{ClockId, clock_gettime};

use super::{
    camera::Camera,
    kit::Kit,
    render::Renderer,
    sample::{Subject, Take},
};

/// CPU time of the parts, seconds.
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
pub struct Booth {
    width: usize,
    renderer: Renderer,
    camera: Camera,
    pixels: Vec<Vec3>,
    /// Spent so far.
    pub times: Times,
}

impl Booth {
    /// Takes all memory.
    pub fn new(size: [usize; 2]) -> Result<Self> {
        let pixels = vec![Vec3::ZERO; size[0] * size[1]];
        let (renderer, camera) = (Renderer::new(size), Camera::new(size)?);
        Ok(Self { width: size[0], renderer, camera, pixels, times: Times::default() })
    }

    /// Renders and develops one picture: a JPEG image.
    pub fn shoot(&mut self, kit: &Kit, subject: &mut Subject, take: &Take) -> Result<Vec<u8>> {
        let start = thread_time_s();
        subject.backdrop().fill(self.width, &mut self.pixels);
        self.renderer.draw(kit, &subject.person, &take.shot, &mut self.pixels);
        let drawn = thread_time_s();
        let jpeg = self.camera.develop(&mut self.pixels, &take.effects, subject.rng())?;
        self.times += Times { render: drawn - start, camera: thread_time_s() - drawn, tracking: 0.0 };
        Ok(jpeg)
    }

    /// Where the outer corners of the eyes are in the last picture, pixels: the person's right, then left.
    pub fn eye_corners(&self, kit: &Kit) -> [Vec2; 2] {
        self.renderer.eye_corners(kit)
    }
}

/// CPU time of this thread, seconds.
pub fn thread_time_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    #[expect(clippy::cast_precision_loss, reason = "seconds of one run")]
    let seconds = time.tv_sec as f64 + time.tv_nsec as f64 / 1e9;
    seconds
}
