//! `T_a` (eq. 3): the transform from pixels to the face's own basis.
//!
//! The three points of the paper (eyes and nose) are noisy. The basis is therefore fitted to [`RIGID`] by a least-squares
//! similarity (Kabsch, Umeyama), which is `R3 R2 R1` in one step. Axes: x to the person's left, y up, z out of the face;
//! the origin lies between the eyes; the unit is their distance. Limits: weak perspective is assumed, so a face away from
//! the middle of the picture appears turned by the angle at which the camera sees it.

use nalgebra::{Matrix3, Vector3};

use super::{Neutral, SolveError};
use crate::track::{LANDMARKS, Landmarks};

/// Smallest distance of the eyes at which landmarks still carry an expression, pixels.
const MIN_EYE_DISTANCE_PX: f64 = 4.0;
/// Largest root-mean-square misfit of the rigid points, eye distances. Faces stay below 0.15.
pub(super) const MAX_MISFIT: f64 = 0.4;
/// Largest coordinate of a face, eye distances. Faces stay below 3.
pub(super) const MAX_COORDINATE: f32 = 10.0;
/// Limit on the iterations of the 3 x 3 singular value decomposition. In double precision, 10 suffice.
const MAX_ITERATIONS: usize = 100;

/// Landmark index and coordinates of points that expressions hardly move: the mean of the aligned neutral faces of the
/// training data, made symmetric, and rotated so that a face that looks into the camera has no pitch.
pub(crate) const RIGID: [(usize, [f64; 3]); 32] = [
    (33, [-0.7218, 0.0143, -0.0445]),
    (133, [-0.2782, -0.0143, 0.0445]),
    (362, [0.2782, -0.0143, 0.0445]),
    (263, [0.7218, 0.0143, -0.0445]),
    (168, [0.0000, 0.1011, 0.3007]),
    (6, [0.0000, -0.0302, 0.3709]),
    (197, [0.0000, -0.1439, 0.4539]),
    (195, [0.0000, -0.2502, 0.5432]),
    (5, [0.0000, -0.3649, 0.6345]),
    (4, [0.0000, -0.5059, 0.6753]),
    (98, [-0.2628, -0.7030, 0.2766]),
    (327, [0.2628, -0.7030, 0.2766]),
    (129, [-0.3241, -0.5937, 0.2175]),
    (358, [0.3241, -0.5937, 0.2175]),
    (114, [-0.2176, -0.2035, 0.2339]),
    (343, [0.2176, -0.2035, 0.2339]),
    (217, [-0.2118, -0.2995, 0.2994]),
    (437, [0.2118, -0.2995, 0.2994]),
    (198, [-0.2176, -0.3935, 0.3673]),
    (420, [0.2176, -0.3935, 0.3673]),
    (47, [-0.2855, -0.2760, 0.1994]),
    (277, [0.2855, -0.2760, 0.1994]),
    (174, [-0.1530, -0.2247, 0.3664]),
    (399, [0.1530, -0.2247, 0.3664]),
    (234, [-1.0886, -0.3188, -0.9112]),
    (454, [1.0886, -0.3188, -0.9112]),
    (127, [-1.1049, -0.0795, -0.8447]),
    (356, [1.1049, -0.0795, -0.8447]),
    (10, [0.0000, 0.9091, 0.2095]),
    (151, [0.0000, 0.6518, 0.2752]),
    (9, [0.0000, 0.3855, 0.3232]),
    (8, [0.0000, 0.2379, 0.3044]),
];

/// A face in its own basis, and the transform that brought it there.
#[derive(Debug, Clone, PartialEq)]
pub struct Normalised {
    /// The landmarks: x to the person's left, y up, z out of the face, in eye distances from between the eyes.
    pub points: [[f32; 3]; LANDMARKS],
    /// Rotation from the face's axes to the picture's (x right, y up, z towards the camera).
    pub(super) rotation: Matrix3<f32>,
    /// Pixels per eye distance.
    pub(super) scale_px: f32,
    /// Position of the point between the eyes in the picture, pixels, x right and y down.
    pub(super) origin_px: [f32; 2],
}

impl Normalised {
    /// How far the face is turned to its left and up: the sines of about these angles.
    pub(super) fn turns(&self) -> [f32; 2] {
        [self.rotation.m13, self.rotation.m23]
    }
}

/// Averages normalised faces.
#[derive(Debug, Clone)]
pub struct FaceMean {
    points: Box<[[f64; 3]; LANDMARKS]>,
    rotation: Matrix3<f32>,
    scale_px: f32,
    origin_px: [f32; 2],
    frames: u32,
}

impl Default for FaceMean {
    fn default() -> Self {
        let points = Box::new([[0.0; 3]; LANDMARKS]);
        Self { points, rotation: Matrix3::zeros(), scale_px: 0.0, origin_px: [0.0; 2], frames: 0 }
    }
}

impl FaceMean {
    /// Adds a face. Does not allocate.
    pub fn add(&mut self, face: &Normalised) {
        let sums = self.points.as_flattened_mut().iter_mut();
        sums.zip(face.points.as_flattened()).for_each(|(sum, value)| *sum += f64::from(*value));
        self.rotation += face.rotation;
        self.scale_px += face.scale_px;
        self.origin_px.iter_mut().zip(face.origin_px).for_each(|(sum, value)| *sum += value);
        self.frames = self.frames.saturating_add(1);
    }

    /// Number of faces.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Returns the mean, or `None` if no face was added.
    pub fn finish(&self) -> Option<Normalised> {
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32 values")]
        let mean = |sum: f64| (sum / f64::from(self.frames)) as f32;
        let count = self.frames as f32;
        (self.frames > 0).then(|| Normalised {
            points: self.points.map(|point| point.map(mean)),
            rotation: self.rotation / count,
            scale_px: self.scale_px / count,
            origin_px: self.origin_px.map(|sum| sum / count),
        })
    }

    /// Returns the mean of frames of a face at rest as a neutral face.
    pub fn neutral(&self) -> Result<Neutral, SolveError> {
        Neutral::from_points(&self.finish().ok_or(SolveError::NoFrames)?.points)
    }
}

/// Transforms a face into its own basis (eq. 3).
pub fn normalise(landmarks: &Landmarks) -> Result<Normalised, SolveError> {
    if !landmarks.is_finite() {
        return Err(SolveError::NotFinite);
    }
    let (rotation, scale, origin) = fit_rigid(landmarks)?;
    let inverse = (rotation.transpose() / scale).cast::<f32>();
    let origin = origin.cast::<f32>();
    let mut points = landmarks.0;
    for point in &mut points {
        *point = (inverse * (upright(*point) - origin)).into();
    }
    // The loop does not stop early, so that the compiler uses vector instructions. A NaN is not below the limit.
    if !points.as_flattened().iter().fold(true, |near, value| near & (value.abs() < MAX_COORDINATE)) {
        return Err(SolveError::NotAFace);
    }
    #[expect(clippy::cast_possible_truncation, reason = "pixels per eye distance, checked to be finite")]
    let scale_px = scale as f32;
    Ok(Normalised { points, rotation: rotation.cast(), scale_px, origin_px: [origin.x, -origin.y] })
}

/// Converts a landmark, with y down and z away from the camera, to y up and z towards the camera.
fn upright([x, y, z]: [f32; 3]) -> Vector3<f32> {
    Vector3::new(x, -y, -z)
}

/// The rotation, scale and origin of the similarity that takes [`RIGID`] to the landmarks.
fn fit_rigid(landmarks: &Landmarks) -> Result<(Matrix3<f64>, f64, Vector3<f64>), SolveError> {
    let pairs = || {
        RIGID.iter().filter_map(|(index, canonical)| {
            let seen = upright(*landmarks.0.get(*index)?).cast::<f64>();
            Some((seen, Vector3::from(*canonical)))
        })
    };
    let count = RIGID.len() as f64;
    let sums = pairs().fold([Vector3::zeros(); 2], |[a, b], (seen, canonical)| [a + seen, b + canonical]);
    let [seen_mean, canonical_mean] = sums.map(|sum| sum / count);
    let mut covariance = Matrix3::zeros();
    let mut seen_var = 0.0;
    let mut canonical_var = 0.0;
    for (seen, canonical) in pairs() {
        let s = seen - seen_mean;
        let c = canonical - canonical_mean;
        covariance += s * c.transpose();
        seen_var += s.norm_squared();
        canonical_var += c.norm_squared();
    }
    let (rotation, trace) = nearest_rotation(covariance).ok_or(SolveError::TooSmall)?;
    let scale = trace / canonical_var;
    if scale.is_nan() || scale < MIN_EYE_DISTANCE_PX {
        return Err(SolveError::TooSmall);
    }
    let misfit = (seen_var / (scale * scale) - canonical_var).max(0.0) / count;
    if misfit.sqrt() > MAX_MISFIT {
        return Err(SolveError::NotAFace);
    }
    Ok((rotation, scale, seen_mean - scale * (rotation * canonical_mean)))
}

/// Returns the proper rotation `R` that maximises `tr(R' M)`, and that trace, or `None` if it is ambiguous.
fn nearest_rotation(covariance: Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
    let size = covariance.amax();
    if size <= 0.0 || !size.is_finite() {
        return None;
    }
    let svd = (covariance / size).try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?;
    let mut u = svd.u?;
    let v_t = svd.v_t?;
    let mut values = svd.singular_values;
    if values.y.is_nan() || values.y <= 1e-6 * values.x {
        return None;
    }
    if (u * v_t).determinant() < 0.0 {
        u.column_mut(2).neg_mut();
        values.z = -values.z;
    }
    Some((u * v_t, values.sum() * size))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::face;

    #[test]
    fn rotated_scaled_and_shifted_face_is_brought_to_its_own_basis() {
        let seen = normalise(&face([25.0, -15.0, 10.0], 80.0, [400.0, 120.0])).expect("a face");
        for (index, canonical) in RIGID {
            for (a, b) in seen.points[index].iter().zip(canonical) {
                assert!((f64::from(*a) - b).abs() < 1e-4, "landmark {index}: {a} for {b}");
            }
        }
        assert!((seen.scale_px - 80.0).abs() < 0.01);
        assert!((seen.origin_px[0] - 400.0).abs() < 0.01 && (seen.origin_px[1] - 120.0).abs() < 0.01);
    }

    #[test]
    fn points_that_are_not_those_of_a_face_are_refused() {
        let refusal = |change: &dyn Fn(&mut Landmarks)| {
            let mut landmarks = face([0.0; 3], 80.0, [320.0, 240.0]);
            change(&mut landmarks);
            normalise(&landmarks).map(drop)
        };
        for (index, value) in [(0, f32::NAN), (200, f32::INFINITY), (477, f32::NEG_INFINITY)] {
            assert_eq!(refusal(&|face| face.0[index][1] = value), Err(SolveError::NotFinite));
        }
        assert_eq!(refusal(&|face| face.0[14] = [1e30, 0.0, 0.0]), Err(SolveError::NotAFace), "one stray point");
        let scatter =
            |face: &mut Landmarks| face.0.iter_mut().step_by(2).for_each(|point| point[1] = 480.0 - point[1] * 1.7);
        assert_eq!(refusal(&scatter), Err(SolveError::NotAFace));
        assert_eq!(refusal(&|face| face.0.fill([5.0; 3])), Err(SolveError::TooSmall), "all points coincide");
        let line = |face: &mut Landmarks| face.0.iter_mut().for_each(|point| *point = [point[0], 0.0, 0.0]);
        assert_eq!(refusal(&line), Err(SolveError::TooSmall));
        assert_eq!(normalise(&face([0.0; 3], 2.0, [0.0; 2])).map(drop), Err(SolveError::TooSmall));
    }

    #[test]
    fn mean_of_two_faces_lies_half_way() {
        let faces = [10.0, -2.0].map(|yaw| normalise(&face([yaw, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face"));
        let mut mean = FaceMean::default();
        assert!(mean.finish().is_none() && mean.neutral() == Err(SolveError::NoFrames));
        for face in &faces {
            mean.add(face);
        }
        let numbers =
            |face: &Normalised| [face.points.as_flattened(), face.rotation.as_slice(), &face.origin_px].concat();
        let [a, b, mean] = [&faces[0], &faces[1], &mean.finish().expect("two faces")].map(numbers);
        assert!(a.iter().zip(b).zip(mean).all(|((a, b), mean)| (f32::midpoint(*a, b) - mean).abs() < 1e-4));
    }
}
