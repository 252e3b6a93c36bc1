//! What the settings promise.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use std::fs;

use super::*;

/// Returns the faults of a text, one per line.
fn faults(text: &str) -> String {
    parse("facewire.toml", text).unwrap_err().to_string()
}

/// Returns the defaults with every setting uncommented.
fn uncommented_defaults() -> String {
    let is_setting = |line: &str| line.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '));
    let line = |line| match str::strip_prefix(line, "# ") {
        Some(setting) if is_setting(setting) => setting.to_owned() + "\n",
        _ => format!("{line}\n"),
    };
    defaults().lines().map(line).collect()
}

#[test]
fn defaults_load_back_unchanged_whether_the_settings_are_commented_out_or_not() {
    assert_eq!(parse("defaults", &defaults()).unwrap(), Settings::default());
    assert_eq!(parse("defaults", &uncommented_defaults()).unwrap(), Settings::default());
}

#[test]
fn commented_out_defaults_leave_the_settings_of_a_board_in_force() {
    for (name, _) in BOARDS {
        let text = defaults().replace("# board = \"auto\"", &format!("board = \"{name}\""));
        assert_eq!(parse("defaults", &text).unwrap(), load(Some(name), "generic", None).unwrap(), "{name}");
    }
}

#[test]
fn settings_of_every_type_load_back_from_their_written_form() {
    let text = "[camera]\ndevice = 'a \"b\"\\c é'\nhorizontal_fov_deg = 71.3\nformat = \"nv12\"\n[realtime]\nhot_cpu = 3\n\
                [[link]]\nkind = \"serial\"\ndevice = \"/dev/tty\\nS0\"\n[[link]]\naddress = \"[::1]:1\"\nloss = \"hold\"\n\
                adjust = { mirror = true, jawOpen = { gain = 1.25, max = 0.9 } }\n";
    let settings = parse("file", text).unwrap();
    assert_eq!(parse("written", &written(&settings)).unwrap(), settings);
}

#[test]
fn defaults_explain_every_setting_with_its_type_and_bounds() {
    let text = uncommented_defaults();
    let settings = text.lines().filter(|line| !line.starts_with('#') && line.contains(" = "));
    assert_eq!(settings.count(), 61, "the board, and the settings of all tables");
    assert!(
        text.contains("# Height of the picture.\n# Takes a whole number from 120 to 2160 (pixels).\nheight = 480\n")
    );
    assert!(text.contains(" - \"serial\": facewire packets on a serial line"), "{text}");
}

#[test]
fn any_rate_of_camera_and_packets_suits_the_link_to_the_board_that_is_plugged_in() {
    let settings = parse("file", "[camera]\nfps = 240\n[send]\nrate_hz = 240\n").unwrap();
    assert_eq!(settings.links, Settings::default().links);
    let [_, board] = &settings.links[..] else { panic!("{} links", settings.links.len()) };
    assert_eq!((board.kind.name(), board.to_string().as_str()), ("serial", "auto"));
}

#[test]
fn a_link_to_any_board_beside_a_link_to_a_certain_one_is_refused() {
    let named = "[[link]]\nkind = \"serial\"\ndevice = \"/dev/ttyACM0\"\n";
    let want = "link.device = \"auto\": another link has the port /dev/ttyACM0, which \"auto\" may find, too; give the path \
                of a port, or remove this link";
    assert_eq!(faults(&(named.to_owned() + "[[link]]\nkind = \"serial\"\n")), want);
}

#[test]
fn every_board_is_valid_and_names_its_machine_in_a_comment() {
    for (name, text) in BOARDS {
        assert!(load(Some(name), "generic", None).is_ok(), "{name}: {:?}", load(Some(name), "generic", None));
        assert!(text.starts_with("# "), "{name}");
    }
}

#[test]
fn every_file_in_boards_is_built_in() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/boards");
    assert_eq!(fs::read_dir(folder).unwrap().count(), BOARDS.len());
}

#[test]
fn an_unknown_board_is_refused_with_the_known_names() {
    let fault = load(Some("pi6"), "generic", None).unwrap_err().to_string();
    let want = "board \"pi6\": not known; give --board one of auto, generic, pi3, pi4, pi5, pi-zero-2w, orange-pi-5, \
                radxa-zero-3, intel-n100";
    assert_eq!(fault, want);
}

/// Returns the camera settings for the arguments `--board` and `--config`.
fn camera(board: Option<&str>, text: &str) -> CameraSettings {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), text).unwrap();
    load(board, "pi5", Some(file.path())).unwrap().camera
}

#[test]
fn the_file_overlays_the_board_which_overlays_the_defaults() {
    let by_argument = camera(Some("pi-zero-2w"), "[camera]\nfps = 20\n");
    assert_eq!((by_argument.fps, by_argument.width, by_argument.stall_timeout_ms), (20, 320, 1000));
    assert_eq!(camera(None, "board = \"pi-zero-2w\"\n[camera]\nfps = 20\n"), by_argument);
}

#[test]
fn a_board_given_as_an_argument_replaces_the_board_in_the_file() {
    assert_eq!(camera(Some("pi4"), "board = \"pi-zero-2w\"\n"), camera(Some("pi4"), ""));
}

#[test]
fn the_board_that_is_recognised_counts_unless_the_file_or_the_argument_names_another_one() {
    let board = |argument, text: &str| {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), text).unwrap();
        load(argument, "pi-zero-2w", Some(file.path())).unwrap()
    };
    let recognised = board(None, "");
    assert_eq!((recognised.board, recognised.camera.width), ("pi-zero-2w", 320));
    assert_eq!(load(None, "pi-zero-2w", None).unwrap(), recognised);
    assert_eq!(board(None, "board = \"auto\"\n"), recognised);
    assert_eq!(board(Some("auto"), "board = \"pi4\"\n"), recognised);
    assert_eq!(board(None, "board = \"pi4\"\n").board, "pi4");
    assert_eq!(board(Some("pi5"), "board = \"pi4\"\n").board, "pi5");
}

#[test]
fn an_unknown_board_in_a_file_is_refused_with_its_line_and_the_known_names() {
    let want = "facewire.toml:1: board = \"pi6\": give one of \"auto\", \"generic\", \"pi3\", \"pi4\", \"pi5\", \"pi-zero-2w\", \
                \"orange-pi-5\", \"radxa-zero-3\", \"intel-n100\"";
    assert_eq!(faults("board = \"pi6\"\n"), want);
    assert!(faults("[camera]\nboard = \"pi4\"\n").starts_with("facewire.toml:2: camera.board is not a setting"));
}

#[test]
fn an_unreadable_file_is_refused_by_its_name() {
    let fault = load(None, "generic", Some(Path::new("/nowhere/facewire.toml"))).unwrap_err().to_string();
    assert!(fault.starts_with("/nowhere/facewire.toml: cannot be read (No such file"), "{fault}");
}

#[test]
fn all_faults_are_reported_at_once_with_line_key_value_and_bounds() {
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
fn smoothing_of_earlier_versions_is_refused_with_the_table_that_replaces_it() {
    let want = "facewire.toml:2: solver.smoothing_ms is no longer a setting: [smoothing] has a filter and a time for each \
                part of the face, such as mouth_ms = 180";
    assert_eq!(faults("[solver]\nsmoothing_ms = 180\n"), want);
    assert!(faults("[solver]\nsmoothing_frames = 5\n").ends_with("such as mouth_ms = 180"));
}

#[test]
fn each_part_of_the_face_has_a_filter_and_a_time() {
    let smoothing = parse("file", "[smoothing]\nlids = \"low-pass\"\nhead_ms = 250\n").unwrap().smoothing;
    assert_eq!((smoothing.lids.name(), smoothing.head_ms), ("low-pass", 250));
    let want = "facewire.toml:2: smoothing.jaw = \"1euro\": give one of \"off\", \"kalman\", \"moving-average\", \
                \"time-weighted-average\", \"low-pass\", \"gated-average\", \"one-euro\"";
    assert_eq!(faults("[smoothing]\njaw = \"1euro\"\n"), want);
}

#[test]
fn single_coefficients_are_adjusted_by_their_name_and_load_back() {
    let text = "[adjust]\nmirror = true\njawOpen = { gain = 1.5, max = 0.8 }\nmouthSmileLeft = { offset = -0.1 }\n";
    let settings = parse("file", text).unwrap();
    let jaw = settings.adjust.0.coefficients.iter().find(|jaw| jaw.gain > 1.0).unwrap();
    assert_eq!((jaw.gain, jaw.offset, jaw.min, jaw.max), (1.5, 0.0, 0.0, 0.8));
    assert_eq!(parse("written", &written(&settings)).unwrap(), settings);
}

#[test]
fn adjustments_that_cannot_be_are_refused_with_the_nearest_name_or_the_bounds() {
    let text = "[adjust]\njawopen = { gain = 2 }\njawLeft = { min = 0.5, max = 0.4 }\ncheekPuff = { gian = 2.0 }\n";
    let bounds = "give { gain = 0.0 to 10.0, offset = -1.0 to 1.0, min = 0.0 to 1.0, max = 0.0 to 1.0 } with min at most \
                  max; each may be left out";
    let want = format!(
        "facewire.toml:2: adjust.jawopen is not a setting; did you mean jawOpen?\n\
         facewire.toml:3: adjust.jawLeft = {{ min = 0.5, max = 0.4 }}: {bounds}\n\
         facewire.toml:4: adjust.cheekPuff = {{ gian = 2.0 }}: {bounds}"
    );
    assert_eq!(faults(text), want);
}

#[test]
fn metrics_that_other_machines_could_read_are_refused_with_the_addresses_to_give() {
    let want = "facewire.toml:2: metrics.listen = \"0.0.0.0:9464\": give \"\", a loopback address and port such as \
                \"127.0.0.1:9464\" or \"[::1]:9464\", or \"unix:\" and a path that begins with /";
    assert_eq!(faults("[metrics]\nlisten = \"0.0.0.0:9464\"\n"), want);
}

#[test]
fn every_fault_is_one_line_whatever_characters_keys_and_values_contain() {
    let text = "\"line\\nend\" = 1\n[camera]\n\"\\u001b[2J\" = 2\nwidth = \"tab\tand é\"\n";
    let want = "\
facewire.toml:1: line\\nend is not a setting; did you mean link?
facewire.toml:3: camera.\\u{1b}[2J is not a setting; there are device, width, height, fps, format, stall_timeout_ms, \
horizontal_fov_deg
facewire.toml:4: camera.width = \"tab\\tand é\": give a whole number from 160 to 3840 (pixels)";
    assert_eq!(faults(text), want);
}

#[test]
fn syntax_errors_name_their_line() {
    let text = faults("[camera]\nwidth = 640\nheight = = 480\n");
    assert!(text.starts_with("facewire.toml:3: not valid TOML: "), "{text}");
}

#[test]
fn the_times_of_the_failsafe_must_be_in_order() {
    let text = faults("[failsafe]\nlive_ms = 400\nneutral_ms = 200\n");
    let want = "\
failsafe.hold_ms = 300: give more than failsafe.live_ms, which is 400
failsafe.neutral_ms = 200: give more than failsafe.hold_ms, which is 300";
    assert_eq!(text, want);
}

#[test]
fn settings_without_any_link_are_refused() {
    assert_eq!(faults("link = []"), "link = []: give at least one [[link]]");
}

#[test]
fn a_number_for_a_table_and_a_table_for_links_are_refused() {
    let text = faults("camera = 3\n[link]\naddress = \"a:1\"\n");
    let want = "\
facewire.toml:1: camera = 3: give a table
facewire.toml:2: link = [link]: give each link under its own [[link]]";
    assert_eq!(text, want);
}

#[test]
fn the_links_of_a_file_replace_the_default_link() {
    let text = "[[link]]\naddress = \"head.local:1\"\n[[link]]\naddress = \"[::1]:65535\"\n";
    let links = parse("file", text).unwrap().links;
    let addresses: Vec<String> = links.iter().map(LinkSettings::to_string).collect();
    assert_eq!(addresses, ["head.local:1", "[::1]:65535"]);
}

#[test]
fn keys_and_values_of_another_kind_of_link_are_refused() {
    let text = "\
[[link]]
device = \"/dev/ttyUSB0\"
[[link]]
kind = \"serial\"
address = \"127.0.0.1:5252\"
[[link]]
kind = \"serial\"
device = \"ttyUSB0\"
baud = 300
pase = \"rate\"
[[link]]
kind = \"seriell\"
baud = 300
";
    let want = "\
facewire.toml:2: link.device is not a setting of a link with kind = \"udp\"; that has kind, address, pace, rate_hz, loss, adjust
facewire.toml:5: link.address is not a setting of a link with kind = \"serial\"; that has kind, device, baud, pace, rate_hz, loss, adjust
facewire.toml:8: link.device = \"ttyUSB0\": give \"auto\", or a path in quotes that begins with /
facewire.toml:9: link.baud = 300: give a whole number from 19200 to 4000000 (1/s)
facewire.toml:10: link.pase is not a setting; did you mean pace?
facewire.toml:12: link.kind = \"seriell\": give one of \"udp\", \"serial\", ";
    assert!(faults(text).starts_with(want), "{}", faults(text));
}

#[test]
fn every_kind_of_link_explains_its_settings_and_loads_back() {
    for kind in LinkKind::all() {
        let text = default_link(kind.name()).unwrap();
        assert_eq!(parse("link", &text).unwrap().links, [LinkSettings::of(kind.with_example())], "{text}");
    }
    assert_eq!(default_link("seriell"), None);
}

#[test]
fn adjustments_of_a_link_have_a_table_of_their_own_and_the_bounds_of_adjust() {
    let text = "[[link]]\n[link.adjust]\nmirror = true\njawOpen = { gain = 2.0 }\n[[link]]\naddress = \"[::1]:1\"\n";
    let links = parse("file", text).unwrap().links;
    let seen: Vec<_> = links.iter().map(|link| (link.adjust.0.mirror, link.adjust.0.coefficients[17].gain)).collect();
    assert_eq!(seen, [(true, 2.0), (false, 1.0)]);
    let want = "\
facewire.toml:2: link.adjust.jawOpn is not a setting; did you mean jawOpen?
facewire.toml:2: link.adjust.mirror = 3: give true or false";
    assert_eq!(faults("[[link]]\nadjust = { jawOpn = { gain = 2.0 }, mirror = 3 }\n"), want);
}

#[test]
fn a_pace_slower_than_10_packets_per_second_is_refused() {
    let fault = |rate_hz| parse("file", &format!("[[link]]\npace = \"rate\"\nrate_hz = {rate_hz}\n")).err();
    let want = "link.rate_hz = 9: give 0 or at least 10: receivers go neutral when packets come more rarely";
    assert_eq!(fault(9).unwrap().to_string(), want);
    assert!(fault(10).is_none() && fault(0).is_none());
}

/// Returns the faults of a serial link at these rates, or an empty text.
fn line_faults(baud: u32, fps: u32, rate_hz: u32) -> String {
    let text = format!(
        "[camera]\nfps = {fps}\n[send]\nrate_hz = {rate_hz}\n\
         [[link]]\nkind = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nbaud = {baud}\n"
    );
    parse("file", &text).err().unwrap_or_default().to_string()
}

#[test]
fn a_rate_above_80_percent_of_the_line_is_refused_with_the_rates_that_fit() {
    // 134 bytes of 10 bits: 115200 baud carry 85.97 a second, of which 68.8 are 80 %.
    assert_eq!(line_faults(115_200, 30, 68), "");
    let want = "link.baud = 115200: give 230400 or more, or pace = \"rate\" and rate_hz = 68: 69 packets a second need \
                more than 80 % of the line at /dev/ttyUSB0";
    assert_eq!(line_faults(115_200, 30, 69), want);
    assert_eq!(line_faults(115_200, 69, 30), want);
}

#[test]
fn a_rate_of_exactly_80_percent_of_the_line_is_accepted_and_a_usual_baud_rate_carries_the_highest_rate() {
    assert_eq!(line_faults(134 * 10 * 60 * 10 / 8, 60, 60), "");
    assert!(line_faults(134 * 10 * 60 * 10 / 8 - 1, 60, 60).contains("rate_hz = 59: 60 packets"));
    assert!(line_faults(19_200, 240, 240).starts_with("link.baud = 19200: give 460800 or more"));
    assert_eq!(line_faults(460_800, 240, 240), "");
}

#[test]
fn a_slow_line_serves_a_fast_camera_at_a_rate_of_its_own() {
    for pace in ["rate", "change"] {
        let own = |rate_hz| {
            let link =
                format!("[[link]]\nkind = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nbaud = 19200\npace = \"{pace}\"\n");
            parse("file", &format!("[camera]\nfps = 60\n{link}rate_hz = {rate_hz}\n"))
        };
        assert!(own(11).is_ok() && own(12).is_err(), "{pace}");
        assert!(own(0).unwrap_err().to_string().contains("rate_hz = 11: 60 packets"), "send.rate_hz counts");
    }
}

#[test]
fn the_slowest_line_carries_the_lowest_rate() {
    assert_eq!(line_faults(19_200, 10, 10), "");
    assert!(line_faults(19_200, 10, 9).ends_with("send.rate_hz = 9: give a whole number from 10 to 240 (1/s)"));
}

#[test]
fn two_links_with_the_same_port_are_refused_but_two_names_of_one_device_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("null");
    std::os::unix::fs::symlink("/dev/null", &other).unwrap();
    let link = |device: &Path| format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\n", device.display());
    let want =
        "link.device = \"/dev/nowhere\": an earlier link has the same port; give this link another one, or remove it";
    assert_eq!(faults(&link(Path::new("/dev/nowhere")).repeat(2)), want);
    assert!(parse("file", &(link(Path::new("/dev/null")) + &link(&other))).is_ok());
}

#[test]
fn serial_lines_are_not_judged_while_a_rate_is_a_fault_by_itself() {
    assert_eq!(line_faults(19_200, 0, 60), "file:2: camera.fps = 0: give a whole number from 1 to 240 (1/s)");
}

#[test]
fn addresses_without_a_host_or_with_an_impossible_port_are_refused() {
    for bad in ["", ":5252", "host", "host:", "host:0", "host:65536", "::1:5252", "host:port"] {
        assert_eq!(Address::new(bad), None, "{bad}");
    }
}

#[test]
fn a_whole_number_is_accepted_for_any_number() {
    let failsafe = parse("file", "[failsafe]\nslew_per_s = 2\n").unwrap().failsafe;
    assert!((failsafe.slew_per_s - 2.0).abs() < f32::EPSILON);
}

#[test]
fn an_empty_camera_name_is_refused_because_it_is_part_of_every_name() {
    for empty in ["", " "] {
        let fault = faults(&format!("[camera]\ndevice = \"{empty}\""));
        assert!(fault.starts_with(&format!("camera.device = \"{empty}\": give \"auto\", the path of")), "{fault}");
    }
}

#[test]
fn paths_with_a_tilde_are_refused() {
    let want = "\
networks.folder = \"~/networks\": give a path from / on: no shell replaces the ~ of a setting
solver.model = \"~\": give a path from / on: no shell replaces the ~ of a setting";
    assert_eq!(faults("[networks]\nfolder = \"~/networks\"\n[solver]\nmodel = \"~\"\n"), want);
}

#[test]
fn an_unreadable_rehearsal_is_refused_with_an_example() {
    let fault = faults("[camera]\ndevice = \"rehearsal: live 5, nap 2\"");
    assert!(fault.starts_with("camera.device = \"rehearsal: live 5, nap 2\": give a rehearsal such as"), "{fault}");
    assert!(parse("file", "[camera]\ndevice = \"rehearsal: live 5, gone 2\"").is_ok());
}
