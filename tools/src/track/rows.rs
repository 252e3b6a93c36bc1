//! The output files of `track`: the CSV of coefficients and the `.npy` of landmarks.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use facewire_packet::{BLENDSHAPES, State};
use npyz::WriterBuilder;

use facewire::cli::Failure;
use facewire::cli::STANDARD_OUTPUT;
use facewire_face::{LANDMARKS, Landmarks};

const HEAD_COLUMNS: [&str; 6] =
    ["head_yaw_deg", "head_pitch_deg", "head_roll_deg", "head_x_mm", "head_y_mm", "head_z_mm"];

/// One row of the CSV.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    pub number: u64,
    pub time_us: u64,
    pub state: State,
    pub coefficients: [f32; BLENDSHAPES.len()],
    /// Yaw, pitch, roll.
    pub angles_deg: [f32; 3],
    pub position_mm: [f32; 3],
}

/// The CSV file, or standard output.
pub struct Csv {
    path: PathBuf,
    output: BufWriter<Box<dyn Write>>,
}

impl Csv {
    pub fn create(path: Option<&Path>) -> Result<Self, Failure> {
        let output: Box<dyn Write> = match path {
            Some(path) => Box::new(File::create(path).map_err(|error| Failure::unwritable(path, &error))?),
            None => Box::new(io::stdout()),
        };
        let path = path.unwrap_or(Path::new(STANDARD_OUTPUT)).to_owned();
        let mut csv = Self { path, output: BufWriter::new(output) };
        let columns = ["frame", "time_s", "state"].into_iter().chain(BLENDSHAPES).chain(HEAD_COLUMNS);
        let head = writeln!(csv.output, "{}", columns.collect::<Vec<_>>().join(","));
        csv.check(head)?;
        Ok(csv)
    }

    pub fn write(&mut self, row: &Row) -> Result<(), Failure> {
        let written = self.write_row(row);
        self.check(written)
    }

    fn write_row(&mut self, row: &Row) -> io::Result<()> {
        write!(self.output, "{},{:.6},{}", row.number, row.time_us as f64 / 1e6, row.state.name())?;
        for value in row.coefficients.iter().chain(&row.angles_deg).chain(&row.position_mm) {
            // Adding 0 turns -0 into 0.
            write!(self.output, ",{:.6}", value + 0.0)?;
        }
        writeln!(self.output)
    }

    pub fn finish(mut self) -> Result<(), Failure> {
        let flushed = self.output.flush();
        self.check(flushed)
    }

    fn check(&self, outcome: io::Result<()>) -> Result<(), Failure> {
        outcome.map_err(|error| Failure::unwritable(&self.path, &error))
    }
}

/// Landmarks of all frames. They are kept until the end, because the header of the file states their number.
pub struct LandmarkFile {
    path: PathBuf,
    values: Vec<f32>,
}

impl LandmarkFile {
    /// Checks that the path can be written before a long film is read. An existing file keeps its content until the end,
    /// because it may be the input.
    pub fn new(path: &Path) -> Result<Self, Failure> {
        let opened = File::options().append(true).create(true).open(path);
        opened.map_err(|error| Failure::unwritable(path, &error))?;
        Ok(Self { path: path.to_owned(), values: Vec::new() })
    }

    /// Adds a frame. All numbers of a frame without a face are not-a-number.
    pub fn push(&mut self, landmarks: Option<&Landmarks>) {
        match landmarks {
            Some(landmarks) => self.values.extend_from_slice(landmarks.0.as_flattened()),
            None => self.values.extend([f32::NAN; 3 * LANDMARKS]),
        }
    }

    pub fn write(&self) -> Result<(), Failure> {
        let failed = |error: io::Error| Failure::unwritable(&self.path, &error);
        let file = BufWriter::new(File::create(&self.path).map_err(failed)?);
        let frames = self.values.len() / (3 * LANDMARKS);
        let shape = [frames as u64, LANDMARKS as u64, 3];
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().map_err(failed)?;
        writer.extend(self.values.iter().copied()).map_err(failed)?;
        writer.finish().map_err(failed)
    }
}
