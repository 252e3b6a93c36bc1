//! The sketches compile for an Arduino Uno, fit its memory, and move servos there, as far as a simulated Uno tells.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod compiler;
#[path = "../../tests/common/skip.rs"]
mod skip;

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use compiler::{package, printed_by};
use facewire_packet::{Packet, State};
use skip::skip;

static HEAD: LazyLock<PathBuf> = LazyLock::new(|| compiled_for_uno("head"));
static PCA9685: LazyLock<PathBuf> = LazyLock::new(|| compiled_for_uno("head_pca9685"));

static SIMULATOR: LazyLock<Option<PathBuf>> = LazyLock::new(simulator);

/// Arduino's core for these boards, where Debian installs it.
const CORE: &str = "/usr/share/arduino/hardware/arduino/avr";
/// As the Arduino IDE compiles for an Uno. Debian's compiler does not know `DECIMAL_DIG` by itself.
const OPTIONS: &str = "-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR \
                       -DDECIMAL_DIG=__DECIMAL_DIG__ -Os -ffunction-sections -fdata-sections -Wl,--gc-sections";
const CPP_OPTIONS: &str = "-std=gnu++11 -fpermissive -fno-exceptions -fno-threadsafe-statics";
/// The flash memory without the boot loader, and the memory for variables and the stack.
const FLASH_BYTES: usize = 32_256;
const RAM_BYTES: usize = 2048;
/// What the stack and the interrupts need at least.
const STACK_BYTES: usize = 512;

/// Whether the compiler and the core are there. If not, notes that the test is left out.
fn can_compile() -> bool {
    let found = Path::new(CORE).is_dir() && Command::new("avr-g++").arg("--version").output().is_ok();
    if !found {
        skip("there is no compiler for AVR or no Arduino core: run scripts/setup tests");
    }
    found
}

fn run(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The sources of these folders with these endings.
fn sources(folders: &[PathBuf], endings: &[&str]) -> Vec<PathBuf> {
    let files = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).map(|entry| entry.unwrap().path());
    files.filter(|file| file.extension().is_some_and(|ending| endings.iter().any(|wanted| ending == *wanted))).collect()
}

/// Compiles a sketch with the core, Wire and the Servo library of `tests/avr`, and returns the program's path. Warnings in
/// the sketch are errors.
fn compiled_for_uno(sketch: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("avr_{sketch}"));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let in_core = |name: &str| Path::new(CORE).join(name);
    let ours = package().join("tests/avr");
    let includes = [in_core("cores/arduino"), in_core("variants/standard"), in_core("libraries/Wire/src")];
    let includes: Vec<OsString> = [package().join("include"), ours.clone()]
        .into_iter()
        .chain(includes)
        .flat_map(|folder| ["-I".into(), folder.into()])
        .collect();
    let compiler = |name: &str, options: &str| {
        let mut command = Command::new(name);
        command.current_dir(&folder).args(OPTIONS.split_whitespace()).args(options.split_whitespace()).args(&includes);
        command
    };
    let folders =
        [in_core("cores/arduino"), in_core("libraries/Wire/src"), in_core("libraries/Wire/src/utility"), ours];
    run(compiler("avr-gcc", "-c -w -std=gnu11").args(sources(&folders[..3], &["c", "S"])));
    run(compiler("avr-g++", CPP_OPTIONS).args(["-c", "-w"]).args(sources(&folders, &["cpp"])));
    let sketch = package().join(format!("arduino/{sketch}/{sketch}.ino"));
    let objects = sources(std::slice::from_ref(&folder), &["o"]);
    let warnings = "-Wall -Wextra -Werror -include Arduino.h -x c++";
    run(compiler("avr-g++", CPP_OPTIONS)
        .args(warnings.split_whitespace())
        .arg(sketch)
        .args(["-x", "none", "-o", "sketch.elf"])
        .args(objects)
        .arg("-lm"));
    folder.join("sketch.elf")
}

/// Bytes of flash memory and of variables that a program takes.
fn sizes(program: &Path) -> (usize, usize) {
    let text = run(Command::new("avr-size").arg(program));
    let numbers: Vec<usize> =
        text.lines().nth(1).unwrap().split_whitespace().take(3).map(|number| number.parse().unwrap()).collect();
    (numbers[0] + numbers[1], numbers[1] + numbers[2])
}

#[test]
fn the_sketches_fit_an_uno() {
    if !can_compile() {
        return;
    }
    for sketch in [&*HEAD, &*PCA9685] {
        let (flash, variables) = sizes(sketch);
        let sketch = sketch.display();
        println!("{sketch}: {flash} bytes of flash memory, {variables} bytes of variables");
        assert!(flash < FLASH_BYTES && variables + STACK_BYTES < RAM_BYTES, "{sketch}: {flash} {variables}");
    }
}

/// Compiles the simulator of an Uno, or notes that the test is left out.
fn simulator() -> Option<PathBuf> {
    if !can_compile() {
        return None;
    }
    if !Path::new("/usr/include/simavr/sim_avr.h").exists() {
        skip("there is no simulator of AVR: run scripts/setup tests");
        return None;
    }
    let simulator = Path::new(env!("CARGO_TARGET_TMPDIR")).join("avr_simulator");
    let source = package().join("tests/avr/simulate.c");
    run(Command::new("cc").args(["-O1", "-Wall", "-Werror"]).arg(source).arg("-lsimavr").arg("-o").arg(&simulator));
    Some(simulator)
}

/// The frames of 150 packets after the words of a starting board. The jaw is half open and the left lid shut.
fn line() -> Vec<u8> {
    let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
    packet.coefficients[17] = 0.5;
    packet.coefficients[0] = 1.0;
    let mut line = b"Booting\r\n\0".to_vec();
    for sequence in 0..150 {
        packet.sequence = sequence;
        line.extend(packet.encode_frame());
    }
    line
}

/// The address of `receiver.receiving` in the memory.
fn address_of_receiving(program: &Path) -> usize {
    let symbols = run(Command::new("avr-nm").arg(program));
    let line = symbols.lines().find(|line| line.ends_with(" receiver")).unwrap();
    let address = usize::from_str_radix(line.split(' ').next().unwrap(), 16).unwrap();
    // The symbols of the memory begin here; `receiving` comes after the 2 bytes of `travel_ms`.
    address - 0x80_0000 + 2
}

/// Runs a sketch in the simulator on the line, and 1.5 s longer. Returns the pulses of pins 9 to 11 and whether the receiver
/// receives, at the end of the line and at the end.
fn simulated(simulator: &Path, program: &Path) -> Vec<i64> {
    let address = address_of_receiving(program).to_string();
    printed_by(Command::new(simulator).arg(program).args(["1500", &address]), &line())
}

#[test]
fn a_simulated_uno_moves_its_servos_with_the_face_and_goes_neutral() {
    let Some(simulator) = SIMULATOR.as_ref() else { return };
    let state = simulated(simulator, &HEAD);
    let wanted = [1300, 1200, 1200, 1, 1000, 1800, 1200, 0];
    let agree =
        state.iter().zip(wanted).all(|(number, wanted)| (number - wanted).abs() <= if wanted > 1 { 8 } else { 0 });
    assert!(agree && state.len() == wanted.len(), "{state:?} instead of {wanted:?}");
}

#[test]
fn a_simulated_uno_whose_servo_board_does_not_answer_goes_on_receiving() {
    let Some(simulator) = SIMULATOR.as_ref() else { return };
    assert_eq!(simulated(simulator, &PCA9685), [0, 0, 0, 1, 0, 0, 0, 0]);
}
