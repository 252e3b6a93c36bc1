//! Compiles the C and C++ programs of the tests, and runs them.
#![allow(dead_code, clippy::unwrap_used, reason = "each test uses some of it")]

use std::{
    env,
    ffi::OsStr,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::{self, Command, Stdio},
    thread,
};

/// The folder of the package.
pub fn package() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Compiles a C program of the folder `tests`, with every warning an error, and returns its path.
pub fn compiled_c(source: &str) -> PathBuf {
    compiled(source, source, "CC", "cc", &["-std=c99"])
}

/// Compiles an Arduino sketch with the stand-ins of `tests/arduino`, every warning an error, and returns the program's path.
pub fn compiled_sketch(sketch: &str, options: &[&str]) -> PathBuf {
    let source = format!("-DSKETCH=\"../../arduino/{sketch}/{sketch}.ino\"");
    let mut arguments = vec!["-std=c++11", "-Wno-unused-function", "-include", "Arduino.h", &source];
    arguments.extend(options);
    compiled("arduino/main.cpp", &format!("{sketch}{}", options.concat()), "CXX", "c++", &arguments)
}

fn compiled(source: &str, name: &str, variable: &str, compiler: &str, arguments: &[&str]) -> PathBuf {
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name.replace(['/', '.'], "_"));
    // Another test may run a program of this name, which must not be written to: the new one takes its place whole.
    let unfinished = program.with_extension(format!("{}-{:?}", process::id(), thread::current().id()));
    let compiler = env::var_os(variable).unwrap_or_else(|| compiler.into());
    let status = Command::new(compiler)
        .args(arguments)
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"])
        .args([OsStr::new("-I"), package().join("include").as_ref()])
        .args([OsStr::new("-I"), package().join("tests/arduino").as_ref()])
        .arg(package().join("tests").join(source))
        .arg("-o")
        .arg(&unfinished)
        .status()
        .unwrap();
    assert!(status.success(), "the compiler refuses {source}");
    fs::rename(&unfinished, &program).unwrap();
    program
}

/// Runs a program with these bytes as its standard input and returns the numbers it prints.
pub fn printed(program: &Path, bytes: &[u8]) -> Vec<i64> {
    printed_by(&mut Command::new(program), bytes)
}

/// Runs a command with these bytes as its standard input and returns the numbers it prints.
pub fn printed_by(command: &mut Command, bytes: &[u8]) -> Vec<i64> {
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let bytes = bytes.to_vec();
    // From a thread of its own, because the program may fill its output before it has read its whole input.
    let writer = thread::spawn(move || stdin.write_all(&bytes));
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{command:?} ends with {}", output.status);
    writer.join().unwrap().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    text.split_whitespace().map(|number| number.parse().unwrap()).collect()
}
