//! What the configuration promises.
#![allow(clippy::unwrap_used)]

use std::fs;

use super::*;

/// The faults of a text, one a line.
fn faults(text: &str) -> String {
    parse("facewire.toml", text).unwrap_err().to_string()
}

#[test]
fn defaults_load_back_unchanged() {
    assert_eq!(parse("defaults", &defaults()).unwrap(), Settings::default());
}

#[test]
fn defaults_explain_each_setting_with_type_and_bounds() {
    let text = defaults();
    let assignments = text.lines().filter(|line| line.contains(" = "));
    assert_eq!(assignments.count(), 19);
    assert!(text.contains("# Picture height.\n# Takes a whole number from 120 to 2160 (pixels).\nheight = 480\n"));
}

#[test]
fn every_board_is_valid_and_says_for_which_machine() {
    for (name, text) in BOARDS {
        assert!(load(Some(name), None).is_ok(), "{name}: {:?}", load(Some(name), None));
        assert!(text.starts_with("# "), "{name}");
    }
}

#[test]
fn every_file_in_boards_is_built_in() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/boards");
    assert_eq!(fs::read_dir(folder).unwrap().count(), BOARDS.len());
}

#[test]
fn unknown_board_is_refused_with_the_names_there_are() {
    let fault = load(Some("pi6"), None).unwrap_err().to_string();
    let want = "board \"pi6\": not known; give --board one of generic, pi4, pi5, pi-zero-2w";
    assert_eq!(fault, want);
}

#[test]
fn the_file_overlays_the_board_which_overlays_the_defaults() {
    let path = std::env::temp_dir().join(format!("facewire-overlay-{}.toml", std::process::id()));
    fs::write(&path, "[camera]\nfps = 20\n").unwrap();
    let settings = load(Some("pi-zero-2w"), Some(&path));
    fs::remove_file(&path).unwrap();
    let camera = settings.unwrap().camera;
    assert_eq!((camera.fps, camera.width, camera.stall_timeout_ms), (20, 320, 1000));
}

#[test]
fn unreadable_file_is_refused_by_its_name() {
    let fault = load(None, Some(Path::new("/nowhere/facewire.toml"))).unwrap_err().to_string();
    assert!(fault.starts_with("/nowhere/facewire.toml: cannot be read (No such file"), "{fault}");
}

#[test]
fn all_faults_are_named_at_once_with_line_key_value_and_bounds() {
    let text = "\
[camera]
widht = 640
fps = 0
format = \"rgb\"
horizontal_fov_deg = nan
[sned]
[failsafe]
live_ms = \"150\"
[[link]]
address = \"127.0.0.1\"
";
    let want = "\
facewire.toml:2: camera.widht is not a setting; did you mean width?
facewire.toml:3: camera.fps = 0: give a whole number from 1 to 240 (1/s)
facewire.toml:4: camera.format = \"rgb\": give one of \"auto\", \"yuyv\", \"mjpeg\", \"nv12\", \"grey\"
facewire.toml:5: camera.horizontal_fov_deg = nan: give a number from 10.0 to 170.0 (degrees)
facewire.toml:6: sned is not a setting; did you mean send?
facewire.toml:8: failsafe.live_ms = \"150\": give a whole number from 20 to 5000 (ms)
facewire.toml:10: link.address = \"127.0.0.1\": give \"host:port\" with a port from 1 to 65535";
    assert_eq!(faults(text), want);
}

#[test]
fn syntax_errors_name_their_line() {
    let text = faults("[camera]\nwidth = 640\nheight = = 480\n");
    assert!(text.starts_with("facewire.toml:3: not valid TOML: "), "{text}");
}

#[test]
fn times_of_the_failsafe_must_follow_each_other() {
    let text = faults("[failsafe]\nlive_ms = 400\nneutral_ms = 200\n");
    let want = "\
failsafe.hold_ms = 300: give more than failsafe.live_ms, which is 400
failsafe.neutral_ms = 200: give more than failsafe.hold_ms, which is 300";
    assert_eq!(text, want);
}

#[test]
fn no_link_at_all_is_refused() {
    assert_eq!(faults("link = []"), "link = []: give at least one [[link]]");
}

#[test]
fn tables_and_links_of_another_shape_are_refused() {
    let text = faults("camera = 3\n[link]\naddress = \"a:1\"\n");
    let want = "\
facewire.toml:1: camera = 3: give a table
facewire.toml:2: link = [link]: give each link under its own [[link]]";
    assert_eq!(text, want);
}

#[test]
fn links_of_a_file_replace_the_default_one() {
    let text = "[[link]]\naddress = \"head.local:1\"\n[[link]]\naddress = \"[::1]:65535\"\n";
    let links = parse("file", text).unwrap().links;
    let addresses: Vec<&str> = links.iter().map(|link| link.address.as_str()).collect();
    assert_eq!(addresses, ["head.local:1", "[::1]:65535"]);
}

#[test]
fn addresses_without_host_or_with_an_impossible_port_are_refused() {
    for bad in ["", ":5252", "host", "host:", "host:0", "host:65536", "::1:5252", "host:port"] {
        assert_eq!(Address::new(bad), None, "{bad}");
    }
}

#[test]
fn whole_numbers_serve_where_a_number_is_asked_for() {
    let failsafe = parse("file", "[failsafe]\nslew_per_s = 2\n").unwrap().failsafe;
    assert!((failsafe.slew_per_s - 2.0).abs() < f32::EPSILON);
}
