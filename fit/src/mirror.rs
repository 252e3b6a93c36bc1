//! Mirrored copies of the training faces: twice the data, and neither side of the face is favoured.
//!
//! Without the copies, the model for an unknown neutral face is far worse on mirrored faces (r 0.51 instead of 0.65),
//! because it learns the asymmetry of the training faces.

use anyhow::{Result, ensure};
use facewire::{
    face::{LANDMARKS, Landmarks},
    solve::{MIRRORED, normalise},
};

use crate::dataset::Sample;

/// Returns the samples that the fit may see, and their mirrored copies.
pub fn with_mirrored(samples: &[Sample]) -> Result<Vec<Sample>> {
    let points = mirrored_points(samples)?;
    let seen = samples.iter().filter(|sample| !sample.held_out());
    let copies = seen.clone().map(|sample| mirror(sample, &points));
    Ok(seen.cloned().chain(copies).collect())
}

fn mirror(sample: &Sample, points: &[usize; LANDMARKS]) -> Sample {
    let flipped = |index: usize| {
        let [x, y, z] = sample.landmarks.0[index];
        [-x, y, z]
    };
    let [yaw, pitch, roll] = sample.pose_deg;
    Sample {
        landmarks: Landmarks(points.map(flipped)),
        truth: MIRRORED.map(|index| sample.truth[index]),
        pose_deg: [-yaw, pitch, -roll],
        mirrored: !sample.mirrored,
        ..*sample
    }
}

/// Returns the opposite landmark of each landmark, found in the mean of all pictures, in which the lips do not coincide
/// as in a closed mouth.
fn mirrored_points(samples: &[Sample]) -> Result<[usize; LANDMARKS]> {
    let mut mean = Box::new([[0.0_f32; 3]; LANDMARKS]);
    for sample in samples.iter().filter(|sample| !sample.held_out()) {
        let face = normalise(&sample.landmarks)?;
        mean.iter_mut().flatten().zip(face.points.iter().flatten()).for_each(|(sum, value)| *sum += value);
    }
    let pairs = pair_up(&mean);
    let crossed = |(a, b): (usize, &usize)| a != *b && mean[a][0] * mean[*b][0] > 0.0;
    ensure!(!pairs.iter().enumerate().any(crossed), "the mean face is not symmetric: check the order of the landmarks");
    Ok(pairs)
}

/// Pairs each point with the point nearest to its mirror image, the closest pairs first. A point in the middle is
/// paired with itself.
fn pair_up(points: &[[f32; 3]; LANDMARKS]) -> [usize; LANDMARKS] {
    let gap = |a: &[f32; 3], b: &[f32; 3]| (a[0] + b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2);
    let all = (0..LANDMARKS).flat_map(|a| (a..LANDMARKS).map(move |b| (a, b)));
    let mut gaps: Vec<_> = all.map(|(a, b)| (gap(&points[a], &points[b]), a, b)).collect();
    gaps.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut partner = [None; LANDMARKS];
    for (_, a, b) in gaps {
        if partner[a].is_none() && partner[b].is_none() {
            (partner[a], partner[b]) = (Some(b), Some(a));
        }
    }
    core::array::from_fn(|index| partner[index].unwrap_or(index))
}

#[cfg(test)]
mod tests {
    use facewire::solve::{BLENDSHAPES, COEFFS};

    use super::*;

    #[test]
    fn mirroring_twice_restores_every_blendshape() {
        assert!((0..COEFFS).all(|index| MIRRORED[MIRRORED[index]] == index));
        let mirrored = |name: &str| {
            let index = BLENDSHAPES.iter().position(|known| *known == name).expect("a blendshape");
            BLENDSHAPES[MIRRORED[index]]
        };
        assert_eq!(mirrored("jawLeft"), "jawRight");
        assert_eq!(mirrored("browInnerUp"), "browInnerUp");
    }
}
