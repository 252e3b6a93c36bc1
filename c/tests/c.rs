//! The header is that of the code, and programs in C work with it, under AddressSanitizer and UndefinedBehaviorSanitizer.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use facewire::capture::{Clip, Source as _};
use facewire_library::{FaceTracker, Pixels};

const FOLDER: &str = env!("CARGO_MANIFEST_DIR");
const FRAMES: usize = 40;

#[test]
fn the_header_is_made_of_the_code() {
    let config = cbindgen::Config::from_file(format!("{FOLDER}/cbindgen.toml")).unwrap();
    let bindings =
        cbindgen::Builder::new().with_src(format!("{FOLDER}/src/lib.rs")).with_config(config).generate().unwrap();
    let (mut made, path) = (Vec::new(), format!("{FOLDER}/include/facewire.h"));
    bindings.write(&mut made);
    if std::env::var_os("FACEWIRE_UPDATE").is_some() {
        fs::write(&path, &made).unwrap();
    }
    let made = String::from_utf8(made).unwrap();
    assert!(fs::read_to_string(path).unwrap() == made, "run this test once with FACEWIRE_UPDATE=1 set");
}

/// The static library that cargo has built with this test.
fn library() -> PathBuf {
    let folder = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    let is_library = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy();
        name.starts_with("libfacewire_c") && name.ends_with(".a")
    };
    let found = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(is_library);
    found.max_by_key(|path| fs::metadata(path).unwrap().modified().unwrap()).unwrap()
}

/// Compiles a program, and runs it.
fn run(source: &str, compiler: &str, arguments: &[&Path]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("program");
    let mut compile = Command::new(compiler);
    compile.args(["-g", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]);
    if compiler == "c++" {
        compile.args(["-x", "c++"]);
    } else {
        compile.args(["-std=c11", "-pedantic"]);
    }
    compile.arg(format!("-I{FOLDER}/include")).arg(format!("{FOLDER}/{source}")).args(["-x", "none"]).arg(library());
    let linking = compile.args(["-lm", "-lpthread", "-ldl", "-o"]).arg(&program).output().unwrap();
    assert!(linking.status.success(), "{}", String::from_utf8_lossy(&linking.stderr));
    Command::new(program).args(arguments).output().unwrap()
}

#[test]
fn a_program_in_c_gets_the_values_of_the_rust_crate_to_the_last_bit() {
    let (folder, mut clip, mut tracker) =
        (tempfile::tempdir().unwrap(), Clip::once().unwrap(), FaceTracker::new().unwrap());
    let (mut film, mut expected) = (Vec::new(), Vec::new());
    for _ in 0..FRAMES {
        let frame = clip.next().unwrap().unwrap();
        let picture = frame.picture().unwrap();
        let Pixels::Planar { planes, .. } = picture.pixels else { unreachable!("the clip has planes") };
        planes
            .iter()
            .zip([307_200, 153_600, 153_600])
            .for_each(|(plane, bytes)| film.extend_from_slice(&plane[..bytes]));
        let face = tracker.process(picture, std::time::Duration::from_micros(frame.captured_us)).unwrap().unwrap();
        let values = face.coefficients.iter().chain(&face.head.rotation_xyzw).chain(&face.head.position_mm);
        expected.extend(values.chain(face.landmarks.0.as_flattened()).flat_map(|value| value.to_le_bytes()));
    }
    let (path, values) = (folder.path().join("film.i422"), folder.path().join("values.f32"));
    fs::write(&path, film).unwrap();
    let ran = run("examples/film.c", "cc", &[&path, Path::new("640"), Path::new("480"), &values]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(String::from_utf8_lossy(&ran.stdout).lines().count(), FRAMES);
    assert!(fs::read(values).unwrap() == expected, "the values differ");
}

#[test]
fn careless_programs_are_refused_without_harm() {
    for (compiler, source) in [("cc", "tests/hostile.c"), ("c++", "tests/hostile.c")] {
        let ran = run(source, compiler, &[]);
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        assert_eq!(String::from_utf8_lossy(&ran.stdout), "all refused\n");
    }
}
