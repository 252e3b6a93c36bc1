//! The header is that of the code, and programs in C work with it, under AddressSanitizer and UndefinedBehaviorSanitizer.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

#[path = "../../library/tests/common/films.rs"]
mod films;
#[path = "../../tests/common/skip.rs"]
mod skip;

use std::collections::BTreeSet;
use std::fs;
use std::mem::{self, MaybeUninit};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::ptr;

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

/// The library that cargo has built with this test, whose name has this end.
fn library(end: &str) -> PathBuf {
    let folder = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    let is_library = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy();
        name.starts_with("libfacewire_c") && name.ends_with(end)
    };
    let found = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(is_library);
    found.max_by_key(|path| fs::metadata(path).unwrap().modified().unwrap()).unwrap()
}

/// Compiles a program with what finds wrong accesses to memory, and runs it.
fn run(source: &str, compiler: &str, arguments: &[&Path]) -> Output {
    run_with(&["-fsanitize=address,undefined", "-fno-sanitize-recover=all"], source, compiler, arguments)
}

/// Compiles a program with these flags, and runs it.
fn run_with(flags: &[&str], source: &str, compiler: &str, arguments: &[&Path]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("program");
    let mut compile = Command::new(compiler);
    compile.args(["-g", "-Wall", "-Wextra", "-Werror"]).args(flags);
    if compiler == "c++" {
        compile.args(["-x", "c++"]);
    } else {
        compile.args(["-std=c11", "-pedantic"]);
    }
    compile
        .arg(format!("-I{FOLDER}/include"))
        .arg(format!("{FOLDER}/{source}"))
        .args(["-x", "none"])
        .arg(library(".a"));
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

/// The first pictures of the built-in clip: planes of 4:2:2, one after another.
fn clip(frames: usize) -> Vec<u8> {
    clip_from(0, frames)
}

/// These pictures of the built-in clip, of which the first has this number.
fn clip_from(first: usize, frames: usize) -> Vec<u8> {
    let (mut clip, mut film) = (Clip::once().unwrap(), Vec::new());
    for number in 0..first + frames {
        let frame = clip.next().unwrap().unwrap();
        if number < first {
            continue;
        }
        let Pixels::Planar { planes, .. } = frame.picture().unwrap().pixels() else {
            unreachable!("the clip has planes")
        };
        planes
            .iter()
            .zip([307_200, 153_600, 153_600])
            .for_each(|(plane, bytes)| film.extend_from_slice(&plane[..bytes]));
    }
    film
}

#[test]
fn a_program_in_c_gets_the_values_of_the_rust_crate_to_the_last_bit() {
    assert_eq!(compare([640, 480], &clip(FRAMES)), FRAMES);
    for (size, film) in films() {
        assert!(compare(size, &film) > 50);
    }
}

#[test]
fn no_picture_that_a_program_in_c_gives_makes_the_library_allocate() {
    // SAFETY: there are default options, and no room for a message.
    let tracker = unsafe { facewire_c::facewire_open(ptr::null(), ptr::null_mut(), 0) };
    let film = clip(FRAMES);
    // SAFETY: numbers and null pointers may be 0.
    let mut picture = unsafe { mem::zeroed::<facewire_c::Picture>() };
    (picture.width, picture.height, picture.format) = (640, 480, facewire_c::FACEWIRE_I422);
    let mut process = |samples: &[u8]| {
        (picture.data, picture.bytes) = (samples.as_ptr(), samples.len());
        let mut face = MaybeUninit::<facewire_c::Face>::uninit();
        // SAFETY: the tracker and the picture are there, and there is memory for one face.
        assert_eq!(unsafe { facewire_c::facewire_process(tracker, &raw const picture, 0, face.as_mut_ptr(), 1) }, 1);
    };
    let (before, measured) = film.split_at(film.len() / 2);
    before.chunks(2 * 640 * 480).for_each(&mut process);
    let allocated = allocation_counter::measure(|| measured.chunks(2 * 640 * 480).for_each(&mut process));
    // SAFETY: the tracker is used no more.
    unsafe { facewire_c::facewire_close(tracker) };
    assert_eq!(allocated.count_total, 0);
}

#[test]
fn careless_programs_are_refused_without_harm() {
    for (compiler, source) in [("cc", "tests/hostile.c"), ("c++", "tests/hostile.c")] {
        let ran = run(source, compiler, &[]);
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        assert_eq!(String::from_utf8_lossy(&ran.stdout), "all refused\n");
    }
}

#[test]
fn planes_options_and_what_is_known_of_a_wearer_pass_the_interface() {
    let folder = tempfile::tempdir().unwrap();
    let film = folder.path().join("film.i422");
    fs::write(&film, clip(1)).unwrap();
    let ran = run("tests/whole.c", "cc", &[&film]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(String::from_utf8_lossy(&ran.stdout).trim_end(), env!("CARGO_PKG_VERSION"));
}

#[test]
fn a_forked_child_gets_errors_for_a_tracker_of_its_parent_and_neither_hangs_nor_dies() {
    let ran = run_with(&[], "tests/fork.c", "cc", &[]);
    assert!(ran.status.success(), "{:?}: {}", ran.status, String::from_utf8_lossy(&ran.stderr));
    assert_eq!(String::from_utf8_lossy(&ran.stdout), "no child hung\n");
}

/// Installs the library below this folder, and returns the prefix.
fn install(folder: &Path) -> PathBuf {
    let [built, prefix] = ["built", "installed"].map(|name| folder.join(name));
    fs::create_dir(&built).unwrap();
    for end in [".a", ".so"] {
        fs::copy(library(end), built.join(format!("libfacewire_c{end}"))).unwrap();
    }
    let installed = Command::new(format!("{FOLDER}/install")).args([&prefix, &built]).output().unwrap();
    assert!(installed.status.success(), "{}", String::from_utf8_lossy(&installed.stderr));
    prefix
}

/// Runs a script in this folder, with the library in its prefix, and returns what it prints.
fn shell(folder: &Path, prefix: &Path, script: &str) -> String {
    let mut shell = Command::new("bash");
    shell.args(["-euo", "pipefail", "-c", script]).current_dir(folder).env("C", FOLDER);
    shell.env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")).env("LD_LIBRARY_PATH", prefix.join("lib"));
    let ran = shell.output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    String::from_utf8(ran.stdout).unwrap()
}

#[test]
fn an_installed_library_is_found_by_pkg_config_and_linked_by_the_name_of_its_interface() {
    let folder = tempfile::tempdir().unwrap();
    let prefix = install(folder.path());
    let shell = |script: &str| shell(folder.path(), &prefix, script);
    shell("cc $C/examples/film.c -o program $(pkg-config --cflags --libs facewire)");
    let needed = shell("readelf --dynamic program; pkg-config --modversion facewire");
    assert!(
        needed.contains("[libfacewire.so.0]") && needed.ends_with(concat!(env!("CARGO_PKG_VERSION"), "\n")),
        "{needed}"
    );
    let usage = shell("./program 2>&1 || true");
    assert!(usage.starts_with("usage: film"), "{usage}");
}

/// Pictures of the built-in clip in which the mouth opens twice: the first of them and how many.
const SPEECH: [usize; 2] = [86, 16];

/// Runs this script with the library installed, and checks the values of jawOpen that it prints for `film.i422`: one line for
/// each picture in each of these formats. Each value must be close to what the crate finds before a host converts the picture.
fn check_speech(formats: &[&str], script: &str) {
    let folder = tempfile::tempdir().unwrap();
    let film = clip_from(SPEECH[0], SPEECH[1]);
    fs::write(folder.path().join("film.i422"), &film).unwrap();
    let prefix = install(folder.path());
    let printed = shell(folder.path(), &prefix, script);
    let mut tracker = FaceTracker::new().unwrap();
    let expected: Vec<f32> = (0..)
        .zip(film.chunks(2 * 640 * 480))
        .map(|(number, samples)| {
            let picture = Format::I422.picture(samples, [640, 480]).unwrap();
            let time = std::time::Duration::from_micros(number * 1_000_000 / 30);
            tracker.process(&picture, time).unwrap().unwrap().coefficient("jawOpen").unwrap()
        })
        .collect();
    for format in formats {
        let of_format = printed.lines().filter_map(|line| line.strip_prefix(&format!("{format} ")));
        let values: Vec<f32> = of_format.map(|value| value.parse().unwrap()).collect();
        assert_eq!(values.len(), expected.len(), "{printed}");
        let differences = values.iter().zip(&expected).map(|(value, expected)| (value - expected).abs());
        assert!(differences.reduce(f32::max).unwrap() < 0.05, "{printed}: {expected:?}");
    }
    let [least, most] = [f32::min, f32::max].map(|choose| expected.iter().copied().reduce(choose).unwrap());
    assert!(least < 0.1 && most > 0.8, "{expected:?}");
}

#[test]
fn a_filter_of_obs_follows_a_face_in_nv12_and_i420_with_padding() {
    if !Command::new("pkg-config").args(["--exists", "libobs"]).status().unwrap().success() {
        skip::skip("there is no libobs: apt-get install libobs-dev");
        return;
    }
    check_speech(
        &["NV12", "I420"],
        "cc -shared -fPIC -Wall -Werror $C/examples/facewire_obs.c -o facewire_obs.so $(pkg-config --cflags --libs libobs facewire)
         cc -rdynamic -Wall -Wextra -Werror $C/tests/obs.c -o host $(pkg-config --cflags --libs libobs)
         ./host ./facewire_obs.so film.i422",
    );
}

#[test]
#[cfg(target_pointer_width = "64")]
fn an_extension_of_godot_follows_a_face_for_scripts_with_and_without_types() {
    check_speech(
        &["RGB"],
        "flags='-std=c11 -Wall -Wextra -Werror'
         cc $flags -shared -fPIC $C/examples/facewire_godot.c -o libfacewire_godot.so $(pkg-config --cflags --libs facewire)
         cc $flags -fsanitize=address,undefined -fno-sanitize-recover=all $C/tests/godot.c -o host
         ./host ./libfacewire_godot.so film.i422",
    );
}

#[test]
fn a_relative_cargo_target_dir_is_that_of_the_callers_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let cargo = "#!/bin/sh\nmkdir -p \"$CARGO_TARGET_DIR/release\"\ncd \"$CARGO_TARGET_DIR/release\"\n\
                 echo built | tee libfacewire_c.a >libfacewire_c.so\n";
    for folder in ["bin", "c/include", "scripts", "elsewhere"] {
        fs::create_dir_all(path.join(folder)).unwrap();
    }
    for file in ["install", "build.rs", "include/facewire.h"] {
        fs::copy(format!("{FOLDER}/{file}"), path.join("c").join(file)).unwrap();
    }
    fs::write(path.join("Cargo.toml"), "version = \"0.1.0\"\n").unwrap();
    for (program, text) in [("bin/cargo", cargo), ("scripts/setup", "#!/bin/sh\n")] {
        fs::write(path.join(program), text).unwrap();
        fs::set_permissions(path.join(program), fs::Permissions::from_mode(0o755)).unwrap();
    }
    let programs = format!("{}:{}", path.join("bin").display(), std::env::var("PATH").unwrap());
    let mut install = Command::new(path.join("c/install"));
    install.arg("installed").current_dir(path.join("elsewhere"));
    let installed = install.env("PATH", programs).env("CARGO_TARGET_DIR", "built").output().unwrap();
    assert!(installed.status.success(), "{}", String::from_utf8_lossy(&installed.stderr));
    assert_eq!(fs::read_to_string(path.join("elsewhere/installed/lib/libfacewire.a")).unwrap(), "built\n");
    assert!(path.join("elsewhere/built/release").exists());
}

/// One line for each function, constant and field that programs in C rely on: a field with its place and size on 64-bit systems.
fn interface(header: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let (mut layout, mut structure, mut prototype) = (Vec::new(), None, Vec::new());
    for line in header.lines().map(str::trim).filter(|line| !line.starts_with("//")) {
        if let Some(constant) = line.strip_prefix("#define FACEWIRE_").filter(|constant| constant.contains(' ')) {
            found.insert(format!("FACEWIRE_{constant}"));
        } else if let Some(name) = line.strip_prefix("struct ").and_then(|line| line.strip_suffix(" {")) {
            structure = Some(name.to_owned());
        } else if line.starts_with('}') {
            structure = None;
        } else if let (Some(name), Some(field)) = (&structure, line.strip_suffix(';')) {
            let (_, declared) = field.rsplit_once([' ', '*']).unwrap();
            let plain = declared.split('[').next().unwrap();
            let of = format!("struct {name}");
            layout.push(format!(
                "printf(\"{of}: {field}: at %zu, %zu bytes\\n\", offsetof({of}, {plain}), sizeof((({of} *)0)->{plain}));\n"
            ));
        } else if line.contains('(') && line.contains("facewire_") || !prototype.is_empty() {
            prototype.push(line);
            if line.ends_with(';') {
                found.insert(prototype.join(" "));
                prototype.clear();
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let [header_path, source, program] = ["facewire.h", "layout.c", "layout"].map(|name| folder.path().join(name));
    fs::write(header_path, header).unwrap();
    fs::write(
        &source,
        format!("#include <stdio.h>\n#include \"facewire.h\"\nint main(void) {{\n{}}}\n", layout.concat()),
    )
    .unwrap();
    let compiled = Command::new("cc").arg(source).arg("-o").arg(&program).output().unwrap();
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let printed = Command::new(program).output().unwrap().stdout;
    found.extend(String::from_utf8(printed).unwrap().lines().map(str::to_owned));
    found
}

/// The lines that one interface has and the other has not.
fn differences(listed: &BTreeSet<String>, found: &BTreeSet<String>) -> Vec<String> {
    let gone = listed.difference(found).map(|line| format!("gone: {line}"));
    gone.chain(found.difference(listed).map(|line| format!("new:  {line}"))).collect()
}

fn header() -> String {
    fs::read_to_string(format!("{FOLDER}/include/facewire.h")).unwrap()
}

#[test]
#[cfg(target_pointer_width = "64")]
fn the_interface_is_the_one_that_is_listed() {
    let (found, path) = (interface(&header()), format!("{FOLDER}/interface.txt"));
    if std::env::var_os("FACEWIRE_UPDATE").is_some() {
        let lines: Vec<_> = found.iter().map(|line| format!("{line}\n")).collect();
        fs::write(&path, lines.concat()).unwrap();
    }
    let listed = fs::read_to_string(path).unwrap().lines().map(str::to_owned).collect();
    let differences = differences(&listed, &found).join("\n");
    assert!(
        differences.is_empty(),
        "{differences}\nIf that is intended, run this test once with FACEWIRE_UPDATE=1 set. If anything was removed or moved, \
         also increase the number in c/build.rs; options added at the end do not need that."
    );
}

#[test]
fn the_library_exports_the_functions_of_the_header_and_nothing_else() {
    let symbols = Command::new("nm")
        .args(["--dynamic", "--defined-only", "--format=posix"])
        .arg(library(".so"))
        .output()
        .unwrap();
    let symbols = String::from_utf8(symbols.stdout).unwrap();
    let exported: BTreeSet<_> = symbols.lines().filter_map(|line| line.split(' ').next()).map(str::to_owned).collect();
    let of_header = interface(&header()).into_iter().filter_map(|line| {
        let (before, _) = line.split_once('(').filter(|_| line.ends_with(';'))?;
        Some(before.rsplit([' ', '*']).next().unwrap().to_owned())
    });
    assert_eq!(exported, of_header.collect());
}

/// Writes what abidw says of the library that cargo has built, as far as it concerns programs: without what is behind the pointer to a
/// tracker, without other crates, and without names of folders. Returns false if this machine has no abidw.
#[cfg(all(target_arch = "x86_64", debug_assertions))]
fn describe_library(folder: &Path, path: &Path) -> bool {
    let private = folder.join("private");
    fs::write(&private, "[suppress_type]\nname = facewire_c::Tracker\ndrop_artifact = yes\n").unwrap();
    let mut describe = Command::new("abidw");
    describe.args([
        "--no-corpus-path",
        "--no-comp-dir-path",
        "--no-show-locs",
        "--no-elf-needed",
        "--type-id-style",
        "hash",
    ]);
    let Ok(described) = describe.arg("--suppressions").arg(private).arg(library(".so")).output() else {
        skip::skip("there is no abidw: apt-get install abigail-tools");
        return false;
    };
    assert!(described.status.success(), "{}", String::from_utf8_lossy(&described.stderr));
    let text = String::from_utf8(described.stdout).unwrap();
    let (start, end) = ("  <abi-instr ", "  </abi-instr>\n");
    let (head, units) = text.split_once(start).unwrap();
    let own = units.split(start).filter_map(|unit| Some(unit.split_once('\n')?.1)).filter(|unit| *unit != end);
    let own: Vec<_> = own.map(|unit| format!("{start}address-size='64' path='c/src/lib.rs'>\n{unit}")).collect();
    fs::write(path, head.to_owned() + &own.concat()).unwrap();
    true
}

/// How the library of one description differs from that of another, as abidiff reports it.
#[cfg(all(target_arch = "x86_64", debug_assertions))]
fn abidiff(listed: &Path, found: &Path) -> String {
    let compared =
        Command::new("abidiff").args(["--no-show-locs", "--harmless"]).args([listed, found]).output().unwrap();
    let report = String::from_utf8_lossy(&compared.stdout).into_owned();
    assert_eq!(compared.status.success(), report.trim().is_empty(), "{compared:?}");
    report
}

/// Only the profile dev describes the types of the library.
#[test]
#[cfg(all(target_arch = "x86_64", debug_assertions))]
fn the_compiled_library_has_the_interface_that_abidw_has_described() {
    let folder = tempfile::tempdir().unwrap();
    let (found, listed) = (folder.path().join("found.xml"), PathBuf::from(format!("{FOLDER}/interface.xml")));
    if !describe_library(folder.path(), &found) {
        return;
    }
    if std::env::var_os("FACEWIRE_UPDATE").is_some() {
        fs::copy(&found, &listed).unwrap();
    }
    let report = abidiff(&listed, &found);
    assert!(
        report.is_empty(),
        "{report}\nIf that is intended, run this test once with FACEWIRE_UPDATE=1 set. If anything was removed or moved, \
         also increase the number in c/build.rs; options added at the end do not need that."
    );
    let text = fs::read_to_string(&found).unwrap();
    let changes = [
        ("name='facewire_reset'", "name='facewire_forget'"),
        ("layout-offset-in-bits='2464'>", "layout-offset-in-bits='2465'>"),
        ("soname='libfacewire.so.0'", "soname='libfacewire.so.1'"),
    ];
    for (before, after) in changes {
        let other = folder.path().join("other.xml");
        fs::write(&other, text.replace(before, after)).unwrap();
        assert!(text.contains(before) && !abidiff(&listed, &other).is_empty(), "{before}");
    }
}

#[test]
fn a_function_that_is_gone_and_a_field_that_changed_are_differences_of_the_interface() {
    let header = header();
    let changes = [
        ("void facewire_reset(struct facewire_tracker *tracker);", "", "gone: void facewire_reset"),
        ("uint32_t method;", "uint64_t method;", "gone: struct facewire_options: uint32_t method"),
        ("float score;", "uint32_t score;", "gone: struct facewire_face: float score"),
        ("#define FACEWIRE_GREY 4", "#define FACEWIRE_GREY 5", "gone: FACEWIRE_GREY 4"),
        ("size_t index);", "uint32_t index);", "gone: const char *facewire_blendshape"),
        ("float score;", "float score; float more;", "gone: struct facewire_face: float box_px"),
    ];
    let listed = interface(&header);
    for (text, by, wanted) in changes {
        let found = differences(&listed, &interface(&header_with(&header, text, by)));
        assert!(found.iter().any(|line| line.starts_with(wanted)), "{wanted}: {found:?}");
    }
}

fn header_with(header: &str, text: &str, by: &str) -> String {
    assert_eq!(header.matches(text).count(), 1, "{text}");
    header.replace(text, &by.replace("; ", ";\n"))
}
