//! `facewire-fit select` on a small dataset made here: two blendshapes that mostly go together, each moving a landmark
//! of its own.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, clippy::cast_possible_truncation)]

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::BufReader,
    path::Path,
    process::{Command, Output},
    sync::LazyLock,
};

use facewire::{face::LANDMARKS, solve::BLENDSHAPES};
use npyz::{NpyFile, WriterBuilder, npz::NpzWriter, zip::write::FileOptions};
use tempfile::TempDir;

const SUBJECTS: usize = 16;
/// Pictures of each; the first is neutral.
const PICTURES: usize = 12;
/// Landmark that each blendshape moves down, and how far at 1, pixels.
const MOVES: [(&str, usize, f32); 2] = [("jawOpen", 17, 20.0), ("mouthShrugLower", 200, 10.0)];
/// Features that are coordinates or distances.
const FEATURES: usize = 3 * LANDMARKS + 35;

/// A made-up number from 0 to 1.
fn noise(index: usize) -> f32 {
    (index as f32 * 0.618_034 + (index / 97) as f32 * 0.377).fract()
}

/// The still face, pixels: the first frame of the built-in clip, which the file holds in 1/32 pixel.
static FACE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let file = File::open(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/demo-landmarks.npy")).unwrap();
    let values = NpyFile::new(BufReader::new(file)).unwrap().data::<i16>().unwrap();
    values.take(3 * LANDMARKS).map(|value| f32::from(value.unwrap()) / 32.0).collect()
});

/// Coefficients of [`MOVES`] in a picture: the second follows the first, but for a tenth of it.
fn coefficients(picture: usize) -> [f32; 2] {
    if picture.is_multiple_of(PICTURES) {
        return [0.0, 0.0];
    }
    let first = noise(picture * 13 + 5);
    [first, 0.9 * first + 0.1 * noise(picture * 29 + 1)]
}

fn landmarks(picture: usize) -> Vec<f32> {
    let moved = coefficients(picture);
    let point = |landmark: usize| {
        let mut point: [f32; 3] = core::array::from_fn(|axis| FACE[3 * landmark + axis]);
        for ((_, own, far), coefficient) in MOVES.iter().zip(moved) {
            point[1] += if *own == landmark { far * coefficient } else { 0.0 };
        }
        let jitter = |axis: usize| noise(picture * 1009 + landmark * 31 + axis * 7) - 0.5;
        core::array::from_fn::<f32, 3, _>(|axis| point[axis] + 0.3 * jitter(axis))
    };
    (0..LANDMARKS).flat_map(point).collect()
}

fn weights(picture: usize) -> Vec<f32> {
    let moved: BTreeMap<&str, f32> = MOVES.iter().map(|own| own.0).zip(coefficients(picture)).collect();
    BLENDSHAPES.iter().map(|name| moved.get(name).copied().unwrap_or(0.0)).collect()
}

/// Writes `faces.npz` and `names.json`.
fn write_dataset(folder: &Path) -> String {
    let path = folder.join("faces.npz");
    let mut npz = NpzWriter::create(&path).unwrap();
    let mut array = |name: &str, shape: &[u64], row: &dyn Fn(usize) -> Vec<f32>| {
        let shape: Vec<u64> = [(SUBJECTS * PICTURES) as u64].iter().chain(shape).copied().collect();
        let mut array =
            npz.array(name, FileOptions::default()).unwrap().default_dtype().shape(&shape).begin_nd().unwrap();
        array.extend((0..SUBJECTS * PICTURES).flat_map(row)).unwrap();
        array.finish().unwrap();
    };
    array("landmarks", &[LANDMARKS as u64, 3], &landmarks);
    array("weights", &[BLENDSHAPES.len() as u64], &weights);
    array("pose", &[3], &|picture| vec![noise(picture * 3), noise(picture * 5), noise(picture * 11)]);
    array("meta", &[5], &|picture| vec![0.0, 0.0, 0.0, 0.0, f32::from(u8::from(picture.is_multiple_of(PICTURES)))]);
    let shape = [(SUBJECTS * PICTURES) as u64];
    let mut subjects =
        npz.array("subject", FileOptions::default()).unwrap().default_dtype().shape(&shape).begin_nd().unwrap();
    subjects.extend((0..SUBJECTS * PICTURES).map(|picture| i32::try_from(picture / PICTURES).unwrap())).unwrap();
    subjects.finish().unwrap();
    npz.zip_writer().finish().unwrap();
    fs::write(folder.join("names.json"), serde_json::to_string(&BLENDSHAPES.as_slice()).unwrap()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn select(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facewire-fit")).current_dir(folder).arg("select").args(arguments).output().unwrap()
}

fn selected(folder: &Path, arguments: &[&str]) -> String {
    let output = select(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Rows of the table of ranks as maps from its heads.
fn rows(csv: &str) -> Vec<BTreeMap<&str, &str>> {
    let mut lines = csv.lines().map(|line| line.split(','));
    let heads: Vec<&str> = lines.next().unwrap().collect();
    lines.map(|cells| heads.iter().copied().zip(cells).collect()).collect()
}

#[test]
fn each_blendshapes_own_landmark_is_found_and_only_partial_f_tells_two_that_go_together_apart() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path());
    let options = [dataset.as_str(), "--svr-rows", "40", "--csv", "ranks.csv", "--out", "page.html"];
    let printed = selected(folder.path(), &options);
    let csv = fs::read_to_string(folder.path().join("ranks.csv")).unwrap();
    let rows = rows(&csv);
    assert_eq!(rows.len(), MOVES.len() * FEATURES, "blendshapes that do not move are left out");
    for (name, landmark, _) in MOVES {
        assert!(printed.lines().any(|line| line.contains(name)), "{printed}");
        let own = || rows.iter().filter(|row| row["blendshape"] == name);
        assert_eq!(own().filter(|row| row["kept"] == "1").count(), 30);
        let rank = |feature: &str, by: &str| own().find(|row| row["feature"] == feature).unwrap()[by].to_owned();
        let (right, wrong) = (format!("y{landmark}"), format!("y{}", MOVES.iter().find(|m| m.0 != name).unwrap().1));
        assert_eq!(rank(&right, "rank_f"), "1", "{name}");
        assert!(rank(&right, "rank_r").parse::<u32>().unwrap() <= 5, "{name}");
        let [by_r, by_f] = ["rank_r", "rank_f"].map(|by| rank(&wrong, by).parse::<u32>().unwrap());
        assert!(by_r <= 6 && by_f > 10, "{name}: {wrong} has rank {by_r} by r, {by_f} by F");
    }
    let page = fs::read_to_string(folder.path().join("page.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), MOVES.len() * 6);
    assert!(!page.contains("src=") && !page.contains("<script") && !page.contains("<link"), "nothing from elsewhere");

    selected(folder.path(), &["--csv", "again.csv", options[0], "--svr-rows", "40"]);
    assert!(fs::read_to_string(folder.path().join("again.csv")).unwrap() == csv, "the same data give the same table");
}

#[test]
fn named_blendshapes_and_percentile_are_taken_and_wrong_ones_refused() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path());
    let printed = selected(
        folder.path(),
        &[&dataset, "--blendshape", "jawOpen", "--percentile", "1", "--svr-rows", "20", "--csv", "ranks.csv"],
    );
    assert!(printed.contains("| jawOpen             |   15 |") && !printed.contains("mouthShrugLower"), "{printed}");
    let refusal = |arguments: &[&str]| {
        let output = select(folder.path(), &[&[dataset.as_str()], arguments].concat());
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(refusal(&["--blendshape", "jawOpened"]).contains("not a blendshape that landmarks show"));
    assert!(refusal(&["--blendshape", "jawLeft"]).contains("none of these blendshapes moves"));
    assert!(refusal(&["--percentile", "0"]).contains("from 0.1 to 50"));
}
