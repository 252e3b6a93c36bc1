//! Landmarks with their true coefficients, as an archive of arrays (`train.npz`) with `names.json` beside it.

use std::{collections::BTreeSet, path::Path};

use anyhow::{Context, Result, ensure};
use facewire::{
    face::{LANDMARKS, Landmarks},
    solve::{BLENDSHAPES, COEFFS},
};

use crate::arrays::Arrays;

/// Every so many-th subject is held out: the fit never sees a picture of it.
pub const HOLD_OUT_EVERY: usize = 8;
/// A face in an array.
pub const LANDMARK_SHAPE: [usize; 2] = [LANDMARKS, 3];
/// Numbers a face has.
pub const LANDMARK_VALUES: usize = 3 * LANDMARKS;
/// Columns of `meta`, the last of which is 1 for a neutral face.
const META: usize = 5;

/// One picture of a face.
#[derive(Clone)]
pub struct Sample {
    /// Where its points are.
    pub landmarks: Landmarks,
    /// True coefficients in the order of [`BLENDSHAPES`].
    pub truth: [f64; COEFFS],
    /// True yaw, pitch (positive nods up) and roll, degrees.
    pub pose_deg: [f64; 3],
    /// Rank of the subject among the subjects of the file.
    pub subject: usize,
    /// Whether the face is at rest.
    pub neutral: bool,
    /// Whether this is a mirrored copy.
    pub mirrored: bool,
}

/// Subject and whether it is seen in the mirror.
pub type Person = (usize, bool);

impl Sample {
    /// Whose face it is.
    pub fn person(&self) -> Person {
        (self.subject, self.mirrored)
    }

    /// Whether the fit may not see this picture. Whole subjects are held out, never single pictures.
    pub fn held_out(&self) -> bool {
        self.subject % HOLD_OUT_EVERY == HOLD_OUT_EVERY - 1
    }
}

/// Reads an archive, all of whose arrays must have a row for every picture.
pub fn load(path: &Path) -> Result<Vec<Sample>> {
    let columns = columns(&path.with_file_name("names.json"))?;
    let mut arrays = Arrays::open(path)?;
    let landmarks = arrays.floats("landmarks", &LANDMARK_SHAPE)?;
    let weights = arrays.floats("weights", &[COEFFS])?;
    let pose = arrays.floats("pose", &[3])?;
    let meta = arrays.floats("meta", &[META])?;
    let subjects = ranks(&arrays.integers("subject", &[])?);
    let pictures = landmarks.len() / LANDMARK_VALUES;
    let rows = [weights.len() / COEFFS, pose.len() / 3, meta.len() / META, subjects.len()];
    for (name, rows) in ["weights", "pose", "meta", "subject"].into_iter().zip(rows) {
        ensure!(rows == pictures, "{}: {name} has {rows} rows, landmarks {pictures}", path.display());
    }
    let points = landmarks.chunks_exact(LANDMARK_VALUES).zip(weights.chunks_exact(COEFFS));
    let labels = pose.chunks_exact(3).zip(meta.chunks_exact(META)).zip(subjects);
    let samples = points.zip(labels).map(|((points, weights), ((pose, meta), subject))| Sample {
        landmarks: landmarks_of(points),
        truth: columns.map(|column| f64::from(weights[column])),
        pose_deg: pose_of(pose),
        subject,
        neutral: meta[META - 1] > 0.5,
        mirrored: false,
    });
    Ok(samples.collect())
}

/// Numbers of the pictures of held-out subjects. Refused if there are none, for nothing could be judged by them.
pub fn held_out(samples: &[Sample]) -> Result<Vec<usize>> {
    let rows: Vec<usize> = (0..samples.len()).filter(|row| samples[*row].held_out()).collect();
    let subjects = samples.iter().map(|sample| sample.subject + 1).max().unwrap_or(0);
    ensure!(
        !rows.is_empty(),
        "{subjects} subjects are too few: every eighth is held out to judge by, so {HOLD_OUT_EVERY} are needed \
         (`judge` and `report` take --all-subjects for data that the fit never saw)"
    );
    Ok(rows)
}

/// Which column of the file holds each of [`BLENDSHAPES`]. Recordings put some right sides before the left ones.
fn columns(path: &Path) -> Result<[usize; COEFFS]> {
    let file = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {file}"))?;
    let names: Vec<String> = serde_json::from_str(&text).with_context(|| format!("{file} is not a list of names"))?;
    ensure!(names.len() == COEFFS, "{file} has {} names for the {COEFFS} columns of weights", names.len());
    let mut columns = [0; COEFFS];
    for (column, known) in columns.iter_mut().zip(BLENDSHAPES) {
        let place = names.iter().position(|name| name == known);
        *column = place.with_context(|| format!("{file} lacks {known}, which is to name a column of weights"))?;
    }
    Ok(columns)
}

/// Places of numbers among the distinct ones.
fn ranks(numbers: &[i32]) -> Vec<usize> {
    let distinct: Vec<i32> = numbers.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
    numbers.iter().map(|number| distinct.partition_point(|other| other < number)).collect()
}

/// A row of the array as points, with irises in depth, whatever tracker found them.
pub fn landmarks_of(row: &[f32]) -> Landmarks {
    let mut landmarks = Landmarks::zero();
    landmarks.0.as_flattened_mut().copy_from_slice(row);
    landmarks.level_irises();
    landmarks
}

/// The file's pitch nods down, facewire's nods up.
fn pose_of(row: &[f32]) -> [f64; 3] {
    let angle = |index: usize| row.get(index).copied().map_or(0.0, f64::from);
    [angle(0), -angle(1), angle(2)]
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use npyz::Order;

    use super::*;
    use crate::arrays::tests::{Made, write};

    /// Loads an archive of so many rows in landmarks, weights, pose and meta, with so many subjects and these names.
    fn loaded(rows: [u64; 4], subjects: &[i32], names: &[&str]) -> Result<Vec<Sample>> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("faces.npz");
        let shapes = [vec![rows[0], 478, 3], vec![rows[1], 52], vec![rows[2], 3], vec![rows[3], 5]];
        let arrays = ["landmarks", "weights", "pose", "meta"].into_iter().zip(&shapes);
        let value = |place: usize| place as f32;
        let made: Vec<Made> =
            arrays.map(|(name, shape)| Made { name, shape, order: Order::C, value: &value }).collect();
        write(&path, &made, subjects);
        std::fs::write(folder.path().join("names.json"), serde_json::to_string(names)?)?;
        load(&path)
    }

    fn refusal(rows: [u64; 4], subjects: &[i32], names: &[&str]) -> String {
        loaded(rows, subjects, names).err().map_or_else(String::new, |error| format!("{error:#}"))
    }

    #[test]
    fn columns_are_taken_by_name_and_subjects_by_rank() {
        let mut names = BLENDSHAPES;
        names.swap(0, 51);
        let samples = loaded([3; 4], &[7, 5, 7], &names).expect("a dataset");
        assert_eq!(samples.iter().map(|sample| sample.subject).collect::<Vec<_>>(), [1, 0, 1]);
        assert_eq!([samples[1].truth[0], samples[1].truth[51]], [103.0, 52.0]);
    }

    #[test]
    fn arrays_of_unequal_length_are_refused_with_both() {
        for (place, name) in ["weights", "pose", "meta"].into_iter().enumerate() {
            let mut rows = [3; 4];
            rows[place + 1] = 2;
            let refusal = refusal(rows, &[1, 1, 2], &BLENDSHAPES);
            assert!(refusal.contains(&format!("faces.npz: {name} has 2 rows, landmarks 3")), "{refusal}");
        }
        assert!(refusal([3; 4], &[1, 2], &BLENDSHAPES).contains("faces.npz: subject has 2 rows, landmarks 3"));
    }

    #[test]
    fn names_that_do_not_fit_the_columns_are_refused() {
        let refusal = |names: &[&str]| refusal([1; 4], &[1], names);
        let twice = [&BLENDSHAPES[..51], &["jawOpen"]].concat();
        assert!(refusal(&BLENDSHAPES[..51]).contains("names.json has 51 names"));
        assert!(refusal(&[&BLENDSHAPES[..], &["noseUp"]].concat()).contains("names.json has 53 names"));
        assert!(refusal(&twice).contains("names.json lacks tongueOut"));
    }

    #[test]
    fn irises_lie_as_deep_as_the_rims_of_their_eyes() {
        let flat: Vec<f32> = (0..LANDMARK_VALUES).map(|place| if place < 468 * 3 { 6.0 } else { 0.0 }).collect();
        assert!(landmarks_of(&flat).0.iter().all(|point| (point[2] - 6.0).abs() < 1e-6));
    }

    #[test]
    fn fewer_than_eight_subjects_hold_nobody_out() {
        let samples = |count: u8| loaded([count.into(); 4], &(0..count.into()).collect::<Vec<_>>(), &BLENDSHAPES);
        assert_eq!(held_out(&samples(8).expect("a dataset")).expect("one"), [7]);
        let refusal = held_out(&samples(7).expect("a dataset")).expect_err("nobody").to_string();
        assert!(refusal.contains("7 subjects are too few") && refusal.contains("--all-subjects"), "{refusal}");
    }
}
