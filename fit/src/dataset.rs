//! Landmarks with their true coefficients, as an archive of arrays (`train.npz`) with `names.json` beside it.

use std::{collections::BTreeSet, fs::File, io::BufReader, path::Path};

use anyhow::{Context, Result, ensure};
use facewire::{
    face::{LANDMARKS, Landmarks},
    solve::{BLENDSHAPES, COEFFS},
};
use npyz::npz::NpzArchive;

/// Every so many-th subject is held out: the fit never sees a picture of it.
pub const HOLD_OUT_EVERY: usize = 8;
/// Numbers a face has.
pub const LANDMARK_VALUES: usize = 3 * LANDMARKS;
/// Column of `meta` that is 1 for a neutral face.
const META_NEUTRAL: usize = 4;

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

/// Reads an archive.
pub fn load(path: &Path) -> Result<Vec<Sample>> {
    let file = File::open(path).with_context(|| format!("cannot open {}", path.display()))?;
    let mut archive = NpzArchive::new(BufReader::new(file)).context("not a NumPy archive")?;
    let columns = columns(&path.with_file_name("names.json"))?;
    let landmarks = floats(&mut archive, "landmarks", LANDMARK_VALUES)?;
    let weights = floats(&mut archive, "weights", COEFFS)?;
    let pose = floats(&mut archive, "pose", 3)?;
    let meta = floats(&mut archive, "meta", META_NEUTRAL + 1)?;
    let subjects = subject_ranks(&mut archive)?;
    let rows = weights.chunks_exact(COEFFS).zip(landmarks.chunks_exact(LANDMARK_VALUES));
    let labels = pose.chunks_exact(3).zip(meta.chunks_exact(META_NEUTRAL + 1)).zip(subjects);
    let samples = rows.zip(labels).map(|((weights, points), ((pose, meta), subject))| Sample {
        landmarks: as_the_mesh_gives(landmarks_of(points)),
        truth: columns.map(|column| weights.get(column).copied().map_or(0.0, f64::from)),
        pose_deg: pose_of(pose),
        subject,
        neutral: meta.get(META_NEUTRAL).is_some_and(|flag| *flag > 0.5),
        mirrored: false,
    });
    Ok(samples.collect())
}

/// Which column of the file holds each of [`BLENDSHAPES`]. Recordings put some right sides before the left ones.
fn columns(names: &Path) -> Result<[usize; COEFFS]> {
    let text = std::fs::read_to_string(names).with_context(|| format!("cannot read {}", names.display()))?;
    let names: Vec<String> = serde_json::from_str(&text).context("names.json is not a list of names")?;
    ensure!(BLENDSHAPES.iter().all(|known| names.iter().any(|name| name == known)), "names.json lacks a blendshape");
    Ok(BLENDSHAPES.map(|known| names.iter().position(|name| name == known).unwrap_or(0)))
}

/// Reads a float array that has `per_row` values a row.
pub fn floats(archive: &mut NpzArchive<BufReader<File>>, name: &str, per_row: usize) -> Result<Vec<f32>> {
    let array = archive.by_name(name)?.with_context(|| format!("the archive has no {name}"))?;
    let columns: u64 = array.shape().iter().skip(1).product();
    ensure!(columns == per_row as u64, "{name} has {columns} values a row, not {per_row}");
    array.into_vec::<f32>().with_context(|| format!("{name} is not float32"))
}

fn subject_ranks(archive: &mut NpzArchive<BufReader<File>>) -> Result<Vec<usize>> {
    let array = archive.by_name("subject")?.context("the archive has no subject")?;
    let numbers = array.into_vec::<i32>().context("subject is not int32")?;
    let distinct: Vec<i32> = numbers.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
    Ok(numbers.iter().map(|number| distinct.partition_point(|other| other < number)).collect())
}

/// A row of the array as points.
pub fn landmarks_of(row: &[f32]) -> Landmarks {
    let mut landmarks = Landmarks([[0.0; 3]; LANDMARKS]);
    landmarks.0.iter_mut().flatten().zip(row).for_each(|(slot, value)| *slot = *value);
    landmarks
}

/// With irises in depth, whatever tracker found the points.
fn as_the_mesh_gives(mut landmarks: Landmarks) -> Landmarks {
    landmarks.level_irises();
    landmarks
}

/// The file's pitch nods down, facewire's nods up.
fn pose_of(row: &[f32]) -> [f64; 3] {
    let angle = |index: usize| row.get(index).copied().map_or(0.0, f64::from);
    [angle(0), -angle(1), angle(2)]
}
