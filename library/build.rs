//! With the feature `built-in`, writes a list of the networks' contents for `src/networks.rs`.

use std::path::{Path, PathBuf};
use std::{env, error::Error, fs};

const NAMES: [&str; 5] = ["detector", "mesh", "lips", "left_eye", "right_eye"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_BUILT_IN").is_none() {
        return Ok(());
    }
    let folder = folder().ok_or("neither FACEWIRE_NETWORKS nor HOME is set")?;
    let list = NAMES.map(|name| {
        let file = folder.join(format!("{name}.fwnet"));
        println!("cargo::rerun-if-changed={}", file.display());
        if !file.is_file() {
            println!("cargo::error={} is missing: run scripts/setup networks", file.display());
        }
        let path = fs::canonicalize(&file).unwrap_or(file).display().to_string();
        format!("({name:?}, include_bytes!({path:?}) as &[u8]),")
    });
    fs::write(Path::new(&env::var("OUT_DIR")?).join("networks.rs"), format!("[{}]", list.concat()))?;
    Ok(())
}

/// Where `scripts/setup networks` puts the networks.
fn folder() -> Option<PathBuf> {
    println!("cargo::rerun-if-env-changed=FACEWIRE_NETWORKS");
    println!("cargo::rerun-if-env-changed=XDG_CACHE_HOME");
    let cache = || {
        let home = || env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
        env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or_else(home)
    };
    env::var_os("FACEWIRE_NETWORKS").map(PathBuf::from).or_else(|| Some(cache()?.join("facewire/networks")))
}
