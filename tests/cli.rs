//! Errors of the commands about wrong settings, networks, cameras and outputs, the help, and the figures of `bench`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs::{self, File};
use std::io::pipe;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use common::PATIENCE;
use common::film::demo_y4m;
use common::networks;
use common::program::{Run, facewire, settings, text};
use serde_json::Value;
use tempfile::NamedTempFile;

/// Multiply-adds of all networks without the detector. MediaPipe's own networks have the same number.
const MULTIPLY_ADDS: u64 = 43_476_672;

fn with_settings(command: &[&str], toml: &str) -> Run {
    let file = settings(toml);
    Run::of(facewire(command).args(["--config", text(file.path())]))
}

fn with_networks(command: &[&str], folder: &Path) -> Run {
    Run::of(facewire(command).env("FACEWIRE_NETWORKS", folder))
}

/// The commands that read settings, with the fewest arguments that they accept.
const COMMANDS: [&[&str]; 4] = [&["run"], &["check"], &["track", "demo"], &["bench"]];

#[test]
fn every_command_names_all_faults_of_the_settings_before_it_tries_anything_else() {
    let toml = "[camera]\nwidht = 640\nfps = 0\n[networks]\nfolder = \"/nowhere\"\n";
    for command in COMMANDS {
        let run = with_settings(command, toml);
        let [first, second] = run.sentences(78)[..] else { panic!("{}", run.err) };
        assert!(first.ends_with(":2: camera.widht is not a setting; did you mean width?"), "{first}");
        assert!(second.ends_with(":3: camera.fps = 0: give a whole number from 1 to 240 (1/s)"), "{second}");
        assert!(run.out.is_empty());
        let run = Run::of(facewire(command).args(["--board", "pi6"]));
        let told = "\"pi6\": not known; give --board one of auto, generic, pi3,";
        assert!(run.sentence(78).contains(told), "{}", run.err);
    }
    for path in ["/nowhere/facewire.toml", "/"] {
        let run = Run::of(&mut facewire(["check", "--config", path]));
        assert!(run.sentence(78).starts_with(&format!("{path}: cannot be read (")), "{}", run.err);
    }
    let binary = NamedTempFile::new().unwrap();
    fs::write(binary.path(), [0xff; 100]).unwrap();
    Run::of(&mut facewire(["check", "--config", text(binary.path())])).sentence(78);
}

#[test]
fn check_says_of_every_part_that_it_works() {
    let absent = "[camera]\ndevice = \"/nowhere\"\n";
    assert_eq!(with_settings(&["check", "--settings-only"], absent).succeeded().out, "settings  ok\n");
    let paper = with_settings(&["check"], &format!("{absent}[solver]\nmethod = \"paper\"\n")).out;
    assert!(paper.contains("\nmodel     ok: the built-in formulas of the paper\n"), "{paper}");
    // The printed defaults load back.
    let defaults = Run::of(&mut facewire(["defaults"])).succeeded().out;
    let demo = defaults.replacen("# device = \"auto\"", "device = \"demo\"", 1);
    let out = with_settings(&["check"], &[&demo, "[[link]]\naddress = \"localhost:5252\"\n"].concat()).succeeded().out;
    let parts: Vec<&str> = out.lines().collect();
    let [settings, model, wearer, networks, camera, board, .., link] = parts.as_slice() else { panic!("{out}") };
    assert_eq!([*settings, *model], ["settings  ok", "model     ok: the built-in network"]);
    assert!(wearer.starts_with("wearer    ok: no profile is in use"), "{wearer}");
    assert_eq!(*networks, "networks  ok: they find the face of the built-in clip");
    assert!(camera.starts_with("camera    ok: demo: MJPEG 640x480 at 30 fps; brightness 13"), "{camera}");
    assert!(camera.contains(" of 255; a face of 2"), "{camera}");
    assert!(board.starts_with("board     ok: generic, because this machine is not one of those"), "{board}");
    assert!(board.ends_with(" (without a name); no temperature sensor"), "{board}");
    assert_eq!(*link, "link      ok: localhost:5252; localhost is 127.0.0.1 at present");
}

#[test]
fn check_says_what_makes_tracking_poor_and_what_to_do_and_succeeds() {
    // A busy machine may lose frames of any scene.
    let is_of_machine = |poor: &str| poor.contains("half its frame rate") || poor.contains("frames get lost");
    for (scene, sentences) in [
        ("live", &[][..]),
        ("no-face", &[]),
        ("dark", &["the picture is dark or noisy: light the face from the front"]),
        ("cut-off", &["a part of the face is outside the picture: turn the camera"]),
        ("half-rate", &["half its frame rate or less, as many do to expose longer: add light"]),
        ("lossy", &["frames get lost or damaged between camera and board: give the camera a USB port of its own"]),
    ] {
        let toml = format!("[camera]\ndevice = \"rehearsal: {scene} 3600\"\n");
        let is_wanted = |poor: &str| sentences.iter().any(|sentence| poor.contains(sentence));
        let poor = |out: &str| -> Vec<String> {
            let poor = out.lines().filter_map(|line| line.strip_prefix("camera    POOR: "));
            poor.filter(|poor| is_wanted(poor) || !is_of_machine(poor)).map(str::to_owned).collect()
        };
        let mut out = with_settings(&["check"], &toml).succeeded().out;
        let begun = Instant::now();
        // A busy machine may handle so few frames that too few of them are lost or damaged.
        while poor(&out).len() < sentences.len() && begun.elapsed() < PATIENCE {
            out = with_settings(&["check"], &toml).succeeded().out;
        }
        let poor = poor(&out);
        assert_eq!(poor.len(), sentences.len(), "{scene}: {out}");
        assert!(poor.iter().zip(sentences).all(|(poor, sentence)| poor.contains(sentence)), "{scene}: {out}");
        assert_eq!(out.contains("; no face is in the picture now\n"), scene == "no-face", "{out}");
    }
}

#[test]
fn check_goes_on_after_a_fault_and_fails_with_the_first() {
    for device in ["/dev/null", "/dev/tty", "/", "/etc/passwd", "/dev/video99", "/nowhere", "no such camera"] {
        let toml = format!("[camera]\ndevice = \"{device}\"\n[[link]]\naddress = \"nowhere.invalid:1\"\n");
        let run = with_settings(&["check"], &toml);
        run.sentence(66);
        for part in ["settings  ok\n", "model     ok: ", "networks  ok: ", "camera    FAILED: ", "link      FAILED: "] {
            assert!(run.out.contains(part), "{}", run.out);
        }
    }
}

#[test]
fn missing_and_damaged_networks_are_named_with_what_to_run() {
    let empty = tempfile::tempdir().unwrap();
    let absent = empty.path().join("absent");
    for command in COMMANDS {
        let run = with_networks(command, &absent);
        assert!(run.sentence(69).contains(&format!("{}; run scripts/setup", text(&absent))), "{}", run.err);
        let run = with_networks(command, empty.path());
        assert!(run.sentence(69).contains("detector.fwnet is missing: run scripts/setup"), "{}", run.err);
    }
    let [mesh, other] = ["mesh", "detector"].map(|name| networks::installed().join(name).with_extension("fwnet"));
    let [mesh, other] = [mesh, other].map(|path| fs::read(path).unwrap());
    for damaged in [&mesh[..mesh.len() - 1], &other, b""] {
        let run = with_networks(&["track", "demo"], networks::with("mesh.fwnet", Some(damaged)).path());
        assert!(run.sentence(69).contains("mesh.fwnet is damaged or of another version ("), "{}", run.err);
    }
}

#[test]
fn a_missing_or_wrong_onnx_runtime_is_named() {
    let library = "libonnxruntime.so";
    let onnx_runtime = settings("[networks]\nengine = \"onnxruntime\"\n");
    let track = ["track", "demo", "--config", text(onnx_runtime.path())];
    let run = with_networks(&track, networks::with(library, None).path());
    assert!(run.sentence(69).contains("libonnxruntime.so is missing: run scripts/setup onnxruntime"), "{}", run.err);
    let whole = fs::read(networks::installed().join(library)).unwrap();
    for wrong in [&b"a letter"[..], b"", &whole[..whole.len() / 2], &whole[..whole.len() - 1]] {
        let run = with_networks(&track, networks::with(library, Some(wrong)).path());
        assert!(run.sentence(69).starts_with("ONNX Runtime cannot be loaded from "), "{}", run.err);
    }
}

#[test]
fn a_missing_damaged_or_absurd_model_is_named_and_told_from_the_networks() {
    let shipped = include_str!("../models/blendshapes.toml");
    let (head, rest) = shipped.split_once("neutral_unknown = [").unwrap();
    let absurd = settings(&format!("{head}neutral_unknown = [999.0, {}", rest.split_once(", ").unwrap().1));
    let cut = settings(&shipped[..20_000]);
    let solver = |path: &str| format!("[solver]\nmodel = \"{path}\"\n");
    for (path, told) in [
        ("/nowhere/model.toml", "the model /nowhere/model.toml cannot be read ("),
        (text(cut.path()), "is damaged in line"),
        (text(absurd.path()), "the blendshape model gave a value that no face has; "),
    ] {
        let run = with_settings(&["check"], &solver(path));
        let line = run.out.lines().find(|line| line.starts_with("model     FAILED: ")).unwrap();
        assert!(line.contains(told) && run.out.contains("networks  ok: "), "{}", run.out);
    }
    with_settings(&["track", "demo"], &solver(text(cut.path()))).sentence(78);
    with_settings(&["track", "demo"], &solver("/nowhere/model.toml")).sentence(66);
}

#[test]
fn help_explains_every_subcommand_and_its_arguments() {
    let overview = Run::of(&mut facewire(["--help"])).succeeded().out;
    assert!(overview.contains("Examples:") && overview.contains("Exit status:"), "{overview}");
    for command in facewire::cli::command().get_subcommands().map(clap::Command::get_name) {
        assert!(overview.contains(&format!("\n  {command} ")), "{overview}");
        let help = Run::of(&mut facewire([command, "--help"])).succeeded().out;
        assert!(help.contains(&format!("Usage: facewire {command}")), "{help}");
        assert!(help.contains("\nExample") && help.contains("\nExit status:\n"), "{help}");
        let lines: Vec<&str> = help.lines().map(str::trim).collect();
        let is_argument = |line: &str| ["<", "[INPUT]", "--", "-h"].iter().any(|sign| line.starts_with(sign));
        for pair in lines.windows(2).filter(|pair| is_argument(pair[0])) {
            assert!(pair[0].contains("  ") || !pair[1].is_empty(), "{command}: {}", pair[0]);
        }
    }
    let version = Run::of(&mut facewire(["--version"])).succeeded().out;
    assert_eq!(version, format!("facewire {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn unknown_subcommands_none_at_all_and_those_of_missing_tools_are_told() {
    let run = Run::of(&mut facewire(["frobnicate"]));
    assert!(run.status == Some(2) && run.err.contains("frobnicate"), "{}", run.err);
    let run = Run::of(&mut facewire::<&str>([]));
    assert!(run.status == Some(2) && run.err.contains("Usage: facewire"), "{}", run.err);
    let folder = tempfile::tempdir().unwrap();
    let alone = folder.path().join("facewire");
    fs::copy(env!("CARGO_BIN_EXE_facewire"), &alone).unwrap();
    let run = Run::of(Command::new(&alone).args(["track", "demo"]));
    assert!(run.sentence(69).contains(text(&folder.path().join("facewire-tools"))), "{}", run.err);
}

fn film(frames: usize) -> NamedTempFile {
    let film = NamedTempFile::with_suffix(".y4m").unwrap();
    fs::write(film.path(), demo_y4m(frames)).unwrap();
    film
}

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).unwrap_or_else(|| panic!("no {path}: {value}")).as_f64().unwrap()
}

/// They are printed even if the drawing cannot be written.
#[test]
fn json_of_bench_has_every_quantile_the_distribution_and_the_speed_of_each_layer() {
    let film = film(10);
    let arguments = ["bench", text(film.path()), "--rounds", "1", "--json", "--layers", "--svg", "/nowhere/a.svg"];
    let run = Run::of(&mut facewire(arguments));
    assert!(run.sentence(74).starts_with("cannot write /nowhere/a.svg: No such file"), "{}", run.err);
    let found: Value = serde_json::from_str(&run.out).unwrap();
    for stage in ["decode", "detect", "mesh", "solve", "whole", "decode_and_whole", "constant_work"] {
        let quantiles = ["p50", "p95", "p99", "p999", "max"].map(|name| number(&found, &format!("/{stage}/{name}_ms")));
        assert!(quantiles.is_sorted() && quantiles[4] > 0.0, "{stage}: {quantiles:?}");
    }
    let distribution = found["whole_distribution_ms"].as_array().unwrap();
    assert!(distribution.len() >= 10 && distribution.iter().map(|point| number(point, "/1")).is_sorted());
    assert!(number(&found, "/whole/p50_ms") < number(&found, "/decode_and_whole/p50_ms"));
    for key in ["/cpu_percent", "/cpu_percent_at_30_fps", "/peak_memory_mb", "/interruptions/interrupts"] {
        assert!(number(&found, key) > 0.0, "{key}: {found}");
    }
    let networks = found["layers"]["networks"].as_array().unwrap();
    let names: Vec<&str> = networks.iter().map(|network| network["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["mesh", "lips", "left_eye", "right_eye", "detector"]);
    assert_eq!(found["layers"]["frame"]["multiply_adds"], MULTIPLY_ADDS);
    for network in networks {
        let layers = network["layers"].as_array().unwrap();
        let of_layers: u64 = layers.iter().map(|layer| layer["multiply_adds"].as_u64().unwrap()).sum();
        assert!(layers.len() > 10 && network["multiply_adds"] == of_layers, "{network}");
    }
    // No network can be faster than the core. The margin allows for other programs that run while the peak is measured.
    let share = number(&found, "/layers/frame/percent_of_peak");
    assert!((0.1..120.0).contains(&share), "{share} % of the peak");
}

/// `facewire ... | head -1` closes standard output early.
#[test]
fn outputs_that_are_closed_early_change_no_exit_status() {
    let closed = || Stdio::from(pipe().unwrap().1);
    let film = film(3);
    let film = text(film.path());
    for command in
        [&["track", film][..], &["bench", film, "--rounds", "1"], &["check"], &["defaults"], &["devices"], &["--help"]]
    {
        let run = Run::ended(&facewire(command).stdout(closed()).output().unwrap()).succeeded();
        assert!(run.err.is_empty() || run.err.contains("3 frames, "), "{command:?}: {}", run.err);
    }
    for (command, status) in [
        (&["track", film][..], 0),
        (&["track", "/nowhere/film.avi"], 66),
        (&["check", "--board", "pi6"], 78),
        (&["frobnicate"], 2),
    ] {
        let ended = facewire(command).stderr(closed()).output().unwrap();
        assert_eq!(ended.status.code(), Some(status), "{command:?}");
    }
}

#[test]
fn standard_output_on_a_full_disk_is_told() {
    let film = film(3);
    for command in [&["track", text(film.path())][..], &["check"], &["defaults"], &["devices"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let run = Run::ended(&facewire(command).stdout(full).output().unwrap());
        let sentence = run.sentence(74);
        assert!(sentence.starts_with("cannot write standard output: No space left on device"), "{sentence}");
        assert!(sentence.ends_with("; free some space, or write to another disk"), "{sentence}");
    }
}
