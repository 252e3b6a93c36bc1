//! Landmarks in `.npy` files, and how far two sets of them lie apart.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use facewire_face::{LANDMARKS, Landmarks};
use npyz::{AutoSerialize, NpyFile, WriteOptions, WriterBuilder as _};
use zip::ZipArchive;

/// Reads the landmarks that `facewire track` or MediaPipe wrote for each frame. They are NaN where there is no face.
pub fn read_npy(path: &Path) -> Vec<Landmarks> {
    let npy = NpyFile::new(BufReader::new(File::open(path).unwrap())).unwrap();
    frames(npy, |value: f32| value)
}

/// Reads landmarks in steps of 1/32 pixel.
pub fn read_steps(path: &Path) -> Vec<Landmarks> {
    let npy = NpyFile::new(BufReader::new(File::open(path).unwrap())).unwrap();
    frames(npy, |steps: i16| f32::from(steps) / 32.0)
}

/// Reads the array `landmarks` of a `.npz` file.
pub fn read_npz(path: &Path) -> Vec<Landmarks> {
    let mut archive = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let member = archive.by_name("landmarks.npy").unwrap();
    frames(NpyFile::new(BufReader::new(member)).unwrap(), |value: f32| value)
}

fn frames<R: Read, T: npyz::Deserialize>(npy: NpyFile<R>, pixels: impl Fn(T) -> f32) -> Vec<Landmarks> {
    assert_eq!(npy.shape()[1..], [LANDMARKS as u64, 3]);
    let values: Vec<f32> = npy.into_vec().unwrap().into_iter().map(pixels).collect();
    let frame = |frame: &[[f32; 3]]| Landmarks(frame.try_into().unwrap());
    values.as_chunks().0.chunks_exact(LANDMARKS).map(frame).collect()
}

/// Returns a `.npy` file of any numbers in any shape.
pub fn write_npy<T: AutoSerialize + Copy>(shape: &[u64], values: &[T]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

/// Distances between the landmarks of two programs, over the frames in which both see a face.
#[derive(Debug, Default)]
pub struct Distance {
    pub frames: usize,
    /// Mean over all points, in the picture.
    pub mean_px: f64,
    /// Distance of the worst point, in the picture.
    pub worst_px: f64,
    /// Distance of the worst point, along the line of sight.
    pub worst_depth_px: f64,
}

impl Distance {
    pub fn between(ours: &[Landmarks], theirs: &[Landmarks]) -> Self {
        assert_eq!(ours.len(), theirs.len());
        let mut distance = Self::default();
        for (ours, theirs) in ours.iter().zip(theirs).filter(|(a, b)| a.is_finite() && b.is_finite()) {
            distance.frames += 1;
            ours.0.iter().zip(&theirs.0).for_each(|(ours, theirs)| distance.add(*ours, *theirs));
        }
        distance.mean_px /= (distance.frames * LANDMARKS).max(1) as f64;
        distance
    }

    fn add(&mut self, ours: [f32; 3], theirs: [f32; 3]) {
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(ours[axis] - theirs[axis]));
        let distance_px = x.hypot(y);
        self.mean_px += distance_px;
        self.worst_px = self.worst_px.max(distance_px);
        self.worst_depth_px = self.worst_depth_px.max(z.abs());
    }
}
