//! Errors of the commands about wrong settings, networks, cameras and hosts, and the help.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use common::networks::{Networks, content};
use common::program::{Run, facewire, settings, text};
use common::skip;
use facewire::config::{self, Settings};
use tempfile::NamedTempFile;

/// Runs a command with these settings.
fn with_settings(command: &[&str], toml: &str) -> Run {
    let file = settings(toml);
    Run::of(facewire(command).args(["--config", text(file.path())]))
}

/// Runs a command with the networks in this folder.
fn with_networks(command: &[&str], folder: &Path) -> Run {
    Run::of(facewire(command).env("FACEWIRE_NETWORKS", folder))
}

/// The commands that read settings, with the fewest arguments that they accept.
const COMMANDS: [&[&str]; 4] = [&["run"], &["check"], &["track", "demo"], &["bench"]];

#[test]
fn every_fault_of_the_settings_is_named_at_once_before_anything_else_is_tried() {
    let toml = "\
[camera]
widht = 640
fps = 0
height = \"480\"
[networks]
folder = \"/nowhere\"
[[link]]
address = \"nowhere.invalid\"
";
    let wants = [
        ":2: camera.widht is not a setting; did you mean width?",
        ":3: camera.fps = 0: give a whole number from 1 to 240 (1/s)",
        ":4: camera.height = \"480\": give a whole number from 120 to 2160 (pixels)",
        ":8: link.address = \"nowhere.invalid\": give \"host:port\" with a port from 1 to 65535",
    ];
    for command in COMMANDS {
        let run = with_settings(command, toml);
        let sentences = run.sentences(78);
        assert_eq!(sentences.len(), wants.len(), "{}", run.err);
        assert!(sentences.iter().zip(wants).all(|(sentence, want)| sentence.ends_with(want)), "{}", run.err);
        assert!(run.out.is_empty());
    }
}

#[test]
fn an_unknown_board_is_refused_with_the_names_there_are() {
    for command in COMMANDS {
        let run = Run::of(facewire(command).args(["--board", "pi6"]));
        assert!(
            run.sentence(78).contains("\"pi6\": not known; give --board one of auto, generic, pi3,"),
            "{}",
            run.err
        );
    }
}

#[test]
fn settings_that_cannot_be_read_are_named() {
    for path in ["/nowhere/facewire.toml", "/"] {
        let run = Run::of(&mut facewire(["check", "--config", path]));
        assert!(run.sentence(78).starts_with(&format!("{path}: cannot be read (")), "{}", run.err);
    }
    let binary = NamedTempFile::new().unwrap();
    fs::write(binary.path(), [0xff; 100]).unwrap();
    Run::of(&mut facewire(["check", "--config", text(binary.path())])).sentence(78);
    let run = with_settings(&["check"], "[camera]\nwidth = = 3\n");
    assert!(run.sentences(78)[0].contains(":2: not valid TOML: "), "{}", run.err);
}

#[test]
fn the_printed_defaults_load_back_unchanged() {
    let defaults = Run::of(&mut facewire(["defaults"])).succeeded().out;
    let file = settings(&defaults);
    assert_eq!(config::load(None, "generic", Some(file.path()), |_, _| {}).unwrap(), Settings::default());
    let demo = defaults.replacen("# device = \"auto\"", "device = \"demo\"", 1);
    assert!(with_settings(&["check"], &demo).succeeded().out.starts_with("settings  ok\n"));
}

#[test]
fn check_says_of_every_part_that_it_works() {
    let file = settings("[camera]\ndevice = \"demo\"\n[[link]]\naddress = \"localhost:5252\"\n");
    let unknown_machine = tempfile::tempdir().unwrap();
    let mut command = facewire(["check", "--config", text(file.path())]);
    let run = Run::of(command.env("FACEWIRE_SYSROOT", unknown_machine.path()));
    let out = run.succeeded().out;
    let parts: Vec<&str> = out.lines().collect();
    let [settings, model, wearer, networks, camera, board, link] = parts.as_slice() else { panic!("{out}") };
    assert_eq!([*settings, *model], ["settings  ok", "model     ok: the built-in one"]);
    assert!(wearer.starts_with("wearer    ok: nobody's profile"), "{wearer}");
    assert_eq!(*networks, "networks  ok: they find the face of the built-in clip");
    assert!(camera.starts_with("camera    ok: demo: MJPEG 640x480 at 30 fps; brightness 13"), "{camera}");
    assert!(camera.contains(" of 255; a face of 2"), "{camera}");
    assert!(board.starts_with("board     ok: generic, because this machine is not one of those"), "{board}");
    assert!(board.ends_with(" (without a name); no temperature sensor"), "{board}");
    assert_eq!(*link, "link      ok: localhost:5252");
}

/// Returns what `facewire check` prints about a camera that plays this scene.
fn checked_camera(scene: &str) -> String {
    let run = with_settings(&["check"], &format!("[camera]\ndevice = \"rehearsal: {scene} 3600\"\n"));
    let out = run.succeeded().out;
    out.lines().filter(|line| line.starts_with("camera ")).collect::<Vec<_>>().join("\n")
}

#[test]
fn check_says_what_makes_tracking_poor_and_what_to_do_and_succeeds() {
    for (scene, sentences) in [
        ("live", &[][..]),
        ("dark", &["the picture is dark or noisy: light the face from the front"]),
        ("cut-off", &["a part of the face is outside the picture: turn the camera"]),
        ("half-rate", &["half its frame rate or less, as many do to expose longer: add light"]),
        ("lossy", &["frames get lost or damaged between camera and board: give the camera a USB port of its own"]),
    ] {
        let camera = checked_camera(scene);
        let poor: Vec<&str> = camera.lines().filter_map(|line| line.strip_prefix("camera    POOR: ")).collect();
        assert_eq!(poor.len(), sentences.len(), "{scene}: {camera}");
        assert!(poor.iter().zip(sentences).all(|(poor, sentence)| poor.contains(sentence)), "{scene}: {camera}");
    }
}

#[test]
fn check_says_that_nobody_is_in_the_picture_and_that_is_no_fault() {
    let camera = checked_camera("no-face");
    assert!(camera.ends_with("; brightness 128 of 255; no face is in the picture now"), "{camera}");
    assert_eq!(camera.lines().count(), 1, "{camera}");
}

#[test]
fn check_goes_on_after_a_fault_and_fails_with_the_first() {
    let run =
        with_settings(&["check"], "[camera]\ndevice = \"/dev/null\"\n[[link]]\naddress = \"nowhere.invalid:1\"\n");
    assert!(run.sentence(66).starts_with("/dev/null is not a camera"), "{}", run.err);
    for part in ["settings  ok\n", "model     ok: ", "networks  ok: ", "camera    FAILED: ", "link      FAILED: "] {
        assert!(run.out.contains(part), "{}", run.out);
    }
}

#[test]
fn missing_networks_are_refused_with_what_to_run() {
    let empty = tempfile::tempdir().unwrap();
    let absent = empty.path().join("absent");
    for command in COMMANDS {
        let run = with_networks(command, &absent);
        let sentence = run.sentence(69);
        assert!(sentence.contains(text(&absent)) && sentence.contains("run scripts/setup"), "{sentence}");
        let run = with_networks(command, empty.path());
        assert!(run.sentence(69).contains("detector.fwnet is missing: run scripts/setup"), "{}", run.err);
    }
}

#[test]
fn a_damaged_network_is_named() {
    let mesh = content("mesh.fwnet");
    let garbled: Vec<u8> = mesh.iter().map(|byte| byte ^ 0x55).collect();
    for damaged in [&mesh[..mesh.len() / 2], &mesh[..mesh.len() - 1], &garbled, &content("detector.fwnet"), b""] {
        let networks = Networks::copy().with("mesh.fwnet", damaged);
        let run = with_networks(&["track", "demo"], networks.path());
        let sentence = run.sentence(69);
        assert!(sentence.contains("mesh.fwnet is damaged or of another version ("), "{sentence}");
        assert!(run.out.is_empty());
    }
}

#[test]
fn a_missing_or_wrong_onnx_runtime_is_named() {
    let library = "libonnxruntime.so";
    let onnx_runtime = settings("[networks]\nengine = \"onnxruntime\"\n");
    let track = ["track", "demo", "--config", text(onnx_runtime.path())];
    let run = with_networks(&track, Networks::copy().without(library).path());
    assert!(run.sentence(69).contains("libonnxruntime.so is missing: run scripts/setup onnxruntime"), "{}", run.err);
    let whole = content(library);
    for wrong in [&b"a letter"[..], b"", &whole[..whole.len() / 2], &whole[..whole.len() - 1]] {
        let run = with_networks(&track, Networks::copy().with(library, wrong).path());
        assert!(run.sentence(69).starts_with("ONNX Runtime cannot be loaded from "), "{}", run.err);
    }
}

#[test]
fn a_missing_or_damaged_model_is_named() {
    let shipped = include_str!("../models/blendshapes.toml");
    let without_jaw = shipped.replace(".jawOpen", ".jawOpened");
    let cases = [
        (&shipped[..20_000], "is damaged in line"),
        ("", "is damaged in line 1"),
        ("format = 99\n", "has format 99"),
        (&without_jaw, "jawOpened"),
    ];
    for (content, reason) in cases {
        let model = settings(content);
        let toml = format!("[solver]\nmodel = \"{}\"\n", text(model.path()));
        let run = with_settings(&["track", "demo"], &toml);
        let sentence = run.sentence(78);
        assert!(sentence.contains(text(model.path())) && sentence.contains(reason), "{sentence}");
    }
    let run = with_settings(&["check"], "[solver]\nmodel = \"/nowhere/model.toml\"\n");
    assert!(run.sentence(66).starts_with("the model /nowhere/model.toml cannot be read ("), "{}", run.err);
    assert!(run.out.contains("model     FAILED: ") && run.out.contains("networks  ok: "), "{}", run.out);
}

#[test]
fn a_model_that_gives_values_of_no_face_is_told_from_the_networks() {
    let shipped = include_str!("../models/blendshapes.toml");
    let (head, rest) = shipped.split_once("neutral_unknown = [").unwrap();
    let model = settings(&format!("{head}neutral_unknown = [999.0, {}", rest.split_once(", ").unwrap().1));
    let run = with_settings(&["check"], &format!("[solver]\nmodel = \"{}\"\n", text(model.path())));
    assert!(run.out.contains("model     FAILED: the blendshape model gave a value that no face has; "), "{}", run.out);
    assert!(run.out.contains("networks  ok: "), "{}", run.out);
}

#[test]
fn a_host_that_does_not_resolve_is_named() {
    let toml = "[camera]\ndevice = \"demo\"\n[[link]]\naddress = \"nowhere.invalid:5252\"\n";
    for command in ["run", "check"] {
        let run = with_settings(&[command], toml);
        assert!(run.sentence(68).starts_with("link nowhere.invalid:5252: the host does not resolve"), "{}", run.err);
    }
}

#[test]
fn what_is_no_camera_is_refused_by_name() {
    for device in
        ["/dev/null", "/dev/tty", "/dev/zero", "/", "/etc/passwd", "/dev/video99", "/nowhere", "no such camera"]
    {
        let run = with_settings(&["check"], &format!("[camera]\ndevice = \"{device}\"\n"));
        run.sentence(66);
        assert!(run.out.contains("camera    FAILED: "), "{}", run.out);
    }
    let run = with_settings(&["check"], "[camera]\ndevice = \"/dev/null\"\n");
    assert!(run.sentence(66).starts_with("/dev/null is not a camera that captures pictures"), "{}", run.err);
}

#[test]
fn without_any_camera_check_says_so() {
    if Path::new("/dev/video0").exists() {
        return skip("this machine has a camera");
    }
    let run = Run::of(&mut facewire(["check"]));
    assert!(run.sentence(66).starts_with("there is no camera; plug one in"), "{}", run.err);
    assert!(Run::of(&mut facewire(["devices"])).succeeded().out.starts_with("no camera\n"));
}

#[test]
fn help_explains_every_subcommand_and_its_arguments() {
    let overview = Run::of(&mut facewire(["--help"])).succeeded().out;
    assert!(overview.contains("Examples:") && overview.contains("Exit status:"), "{overview}");
    let definition = facewire::cli::command();
    for command in definition.get_subcommands().map(clap::Command::get_name) {
        assert!(overview.contains(&format!("\n  {command} ")), "{overview}");
        let help = Run::of(&mut facewire([command, "--help"])).succeeded().out;
        assert!(help.contains(&format!("Usage: facewire {command}")), "{help}");
        assert!(help.contains("\nExample") && help.contains("\nExit status:\n"), "{help}");
        let lines: Vec<&str> = help.lines().map(str::trim).collect();
        let arguments =
            lines.windows(2).filter(|pair| ["<", "[INPUT]", "--", "-h"].iter().any(|sign| pair[0].starts_with(sign)));
        for pair in arguments {
            let described = pair[0].contains("  ") || !pair[1].is_empty();
            assert!(described, "{command}: {}", pair[0]);
        }
    }
    assert_eq!(
        Run::of(&mut facewire(["--version"])).succeeded().out,
        format!("facewire {}\n", env!("CARGO_PKG_VERSION"))
    );
}

#[test]
fn sentences_of_the_help_are_broken_only_where_the_line_ends() {
    let help = Run::of(&mut facewire(["check", "--help"])).succeeded().out;
    let last = help.lines().skip_while(|line| !line.starts_with("Bad settings")).take_while(|line| !line.is_empty());
    let lines: Vec<&str> = last.collect();
    assert!(lines.len() >= 2 && lines[..lines.len() - 1].iter().all(|line| line.len() > 80), "{help}");
}

#[test]
fn networks_that_this_user_may_not_read_are_told_from_missing_ones() {
    if rustix::process::geteuid().is_root() {
        return skip("root may read everything");
    }
    let folder = tempfile::tempdir().unwrap();
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o000)).unwrap();
    for networks in [folder.path().to_owned(), folder.path().join("networks")] {
        let run = with_networks(&["track", "demo"], &networks);
        assert!(run.sentence(69).contains("cannot be read (Permission denied"), "{}", run.err);
    }
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o700)).unwrap();
}

#[test]
fn a_neutral_range_beyond_the_clip_is_refused_with_the_number_of_its_frames() {
    let run = Run::of(&mut facewire(["track", "demo", "--neutral", "500..600"]));
    assert_eq!(run.sentence(65), "--neutral 500..600: the input has 240 frames; give a range within them");
}

#[test]
fn bench_offers_only_what_it_takes() {
    let run = Run::of(&mut facewire(["bench", "/nowhere/film.avi"]));
    let sentence = run.sentence(66);
    assert!(sentence.ends_with("give the path of a .y4m, Motion-JPEG .avi or .npy file, or `demo`"), "{sentence}");
}

#[test]
fn a_drawing_that_cannot_be_written_leaves_the_figures_and_is_named() {
    let arguments = ["bench", "demo", "--rounds", "1", "--json", "--svg", "/nowhere/latency.svg"];
    let run = Run::of(&mut facewire(arguments));
    assert!(run.sentence(74).starts_with("cannot write /nowhere/latency.svg: No such file"), "{}", run.err);
    assert!(run.out.contains("\"p50_ms\""), "{}", run.out);
}

#[test]
fn unknown_subcommands_and_none_at_all_are_wrong_arguments() {
    let run = Run::of(&mut facewire(["frobnicate"]));
    assert!(run.status == Some(2) && run.err.contains("frobnicate"), "{}", run.err);
    let run = Run::of(&mut facewire::<&str>([]));
    assert!(run.status == Some(2) && run.err.contains("Usage: facewire"), "{}", run.err);
}

#[test]
fn a_command_of_the_tools_names_the_program_that_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let alone = folder.path().join("facewire");
    std::fs::copy(env!("CARGO_BIN_EXE_facewire"), &alone).unwrap();
    let run = Run::of(std::process::Command::new(&alone).args(["track", "demo"]));
    assert!(run.sentence(69).contains(folder.path().join("facewire-tools").to_str().unwrap()), "{}", run.err);
}
