//! The header is that of the code, and programs in C work with it, under AddressSanitizer and UndefinedBehaviorSanitizer.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

#[path = "../../library/tests/common/films.rs"]
mod films;
#[path = "../../tests/common/skip.rs"]
mod skip;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use facewire::capture::{Clip, Source as _};
use facewire_library::{FaceTracker, Format, Pixels};
use films::films;

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

/// Compares a film of this size, 4:2:2 in full range, and returns how many pictures show a face.
fn compare([width, height]: [usize; 2], film: &[u8]) -> usize {
    let (folder, mut tracker) = (tempfile::tempdir().unwrap(), FaceTracker::new().unwrap());
    let mut expected = Vec::new();
    let mut found = 0;
    for (number, samples) in (0..).zip(film.chunks(2 * width * height)) {
        let picture = Format::I422.picture(samples, [width, height]).unwrap();
        let time = std::time::Duration::from_micros(number * 1_000_000 / 30);
        let Some(face) = tracker.process(&picture, time).unwrap() else { continue };
        found += 1;
        let values = face.coefficients.iter().chain(&face.head.rotation_xyzw).chain(&face.head.position_mm);
        let visibility = face.visibility.values();
        let box_px = face.box_px();
        let values = values.chain(&visibility).chain([&face.score]).chain(&box_px);
        expected.extend(values.chain(face.landmarks.0.as_flattened()).flat_map(|value| value.to_le_bytes()));
    }
    let (path, values) = (folder.path().join("film.i422"), folder.path().join("values.f32"));
    fs::write(&path, film).unwrap();
    let size = [width, height].map(|side| PathBuf::from(side.to_string()));
    let ran = run("examples/film.c", "cc", &[&path, &size[0], &size[1], &values]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let printed = String::from_utf8_lossy(&ran.stdout).into_owned();
    assert_eq!(printed.lines().filter(|line| !line.ends_with("no face")).count(), found);
    assert!(fs::read(values).unwrap() == expected, "the values differ");
    found
}

#[test]
fn a_program_in_c_gets_the_values_of_the_rust_crate_to_the_last_bit() {
    let (mut clip, mut film) = (Clip::once().unwrap(), Vec::new());
    for _ in 0..FRAMES {
        let frame = clip.next().unwrap().unwrap();
        let Pixels::Planar { planes, .. } = frame.picture().unwrap().pixels() else {
            unreachable!("the clip has planes")
        };
        planes
            .iter()
            .zip([307_200, 153_600, 153_600])
            .for_each(|(plane, bytes)| film.extend_from_slice(&plane[..bytes]));
    }
    assert_eq!(compare([640, 480], &film), FRAMES);
    for (size, film) in films() {
        assert!(compare(size, &film) > 50);
    }
}

#[test]
fn careless_programs_are_refused_without_harm() {
    for (compiler, source) in [("cc", "tests/hostile.c"), ("c++", "tests/hostile.c")] {
        let ran = run(source, compiler, &[]);
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        assert_eq!(String::from_utf8_lossy(&ran.stdout), "all refused\n");
    }
}
