//! Turns the readable model, `models/blendshapes.toml`, into the bytes that the program is built with, so that it need
//! not parse 546 kB of text at every start.

use std::{env, fs, path::Path};

const MODEL: &str = "models/blendshapes.toml";

#[path = "src/face/appearance_landmarks.rs"]
mod appearance_landmarks;

/// The program's own reader of model files.
#[path = "src/solve"]
#[allow(dead_code, unused_imports, reason = "the program uses the rest")]
mod solve {
    mod feature_id;
    mod model;
    mod model_error;
    mod model_file;

    use crate::appearance_landmarks::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS};
    use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
    pub use model::Model;

    /// As in `src/face/landmarks.rs`. If they differ, the test that compares the bytes with the file fails.
    const LANDMARKS: usize = 478;
}

fn main() {
    println!("cargo::rerun-if-changed={MODEL}");
    if let Err(fault) = write_bytes() {
        println!("cargo::error={MODEL}: {fault}");
    }
}

fn write_bytes() -> Result<(), Box<dyn std::error::Error>> {
    let model = solve::Model::load(Path::new(MODEL))?;
    let bytes = model.to_bytes().ok_or("the program can contain a hidden layer only, not formulas")?;
    if solve::Model::from_bytes(&bytes).as_ref() != Some(&model) {
        return Err("the bytes of the model do not give the same model; please report it".into());
    }
    Ok(fs::write(Path::new(&env::var("OUT_DIR")?).join("blendshapes.bin"), bytes)?)
}
