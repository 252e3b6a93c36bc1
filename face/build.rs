//! Turns the readable models, `models/blendshapes.toml` and `models/formulas.toml`, into the bytes that the program is built
//! with, so that it parses no text at the start.

use std::{env, error::Error, fs, path::Path};

use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};

const MODELS: [&str; 2] = ["blendshapes", "formulas"];
/// As in `src/track/landmarks.rs`. If they differ, the test that compares the bytes with the file fails.
const LANDMARKS: usize = 478;

/// The library's own reader of model files.
#[path = "src/model/mod.rs"]
#[allow(dead_code, unused_imports, reason = "the library uses the rest")]
mod model;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=models/eyes.fwnet");
    println!("cargo::rerun-if-changed=src/model");
    for name in MODELS {
        let path = format!("models/{name}.toml");
        println!("cargo::rerun-if-changed={path}");
        match model::Model::load(Path::new(&path)) {
            Ok(model) => fs::write(Path::new(&env::var("OUT_DIR")?).join(format!("{name}.bin")), model.to_bytes())?,
            Err(fault) => println!("cargo::error={path}: {fault}"),
        }
    }
    Ok(())
}
