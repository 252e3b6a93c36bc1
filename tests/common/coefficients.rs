//! The CSV of `facewire track`.

use facewire_packet::{BLENDSHAPE_COUNT, BLENDSHAPES};

/// A row of the CSV. The values are the coefficients, then yaw, pitch and roll in degrees, then x, y and z in
/// millimetres, then the visibility of each part.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub frame: u64,
    pub time_s: f64,
    pub state: String,
    pub values: Vec<f64>,
}

impl Row {
    fn parse(line: &str) -> Self {
        let fields: Vec<&str> = line.split(',').collect();
        let [frame, time_s, state, values @ ..] = fields.as_slice() else { panic!("too short: {line}") };
        Self {
            frame: frame.parse().unwrap(),
            time_s: time_s.parse().unwrap(),
            state: (*state).to_owned(),
            values: values.iter().map(|value| value.parse().unwrap()).collect(),
        }
    }

    pub fn coefficients(&self) -> &[f64] {
        &self.values[..BLENDSHAPE_COUNT]
    }

    pub fn coefficient(&self, name: &str) -> f64 {
        self.values[BLENDSHAPES.iter().position(|known| *known == name).unwrap()]
    }
}

pub fn rows(csv: &str) -> Vec<Row> {
    csv.lines().skip(1).map(Row::parse).collect()
}

/// Returns the mean and the greatest difference of the coefficients of two films.
pub fn difference(ours: &[Row], theirs: &[Row]) -> [f64; 2] {
    assert_eq!(ours.len(), theirs.len());
    let pairs = ours.iter().zip(theirs).flat_map(|(a, b)| a.coefficients().iter().zip(b.coefficients()));
    let differences: Vec<f64> = pairs.map(|(a, b)| (a - b).abs()).collect();
    let sum: f64 = differences.iter().sum();
    [sum / differences.len() as f64, differences.iter().copied().fold(0.0, f64::max)]
}
