//! What the settings promise.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use std::fs;

use facewire_face::BLENDSHAPES;

use super::section::Section as _;
use super::*;

/// A file that uses every key.
const EVERY_KEY: &str = include_str!("../../tests/settings.toml");

/// Returns the faults of a text, one per line.
fn faults(text: &str) -> String {
    parse("facewire.toml", text).err().unwrap_or_default().to_string()
}

/// Removes the "# " in front of each setting.
fn uncommented(text: &str) -> String {
    let is_setting = |line: &str| line.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '));
    let line = |line| match str::strip_prefix(line, "# ") {
        Some(setting) if is_setting(setting) => setting.to_owned() + "\n",
        _ => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

/// The keys of the table under these headings: those that are named beside an unknown one.
fn keys(headings: &str) -> Vec<String> {
    let faults = faults(&format!("{headings}\"?\" = 1\n"));
    let (_, keys) = faults.lines().find_map(|fault| fault.split_once("; there are ")).unwrap();
    keys.split(", ").map(str::to_owned).collect()
}

/// Checks that the text of a table explains every key, with the values that it takes.
fn assert_explained(headings: &str, text: &str) {
    for key in keys(headings).iter().filter(|key| !BLENDSHAPES.contains(&key.as_str())) {
        assert!(text.contains(&format!("\n{key} = ")) || text.contains(&format!("[[link.{key}]]")), "{headings}{key}");
        let faults = faults(&format!("{headings}{key} = []\n"));
        let fault = faults.lines().find_map(|fault| fault.split_once(&format!("{key} = []: give ")));
        if let Some((_, expected)) = fault.filter(|(_, expected)| *expected != "a table") {
            let explained = format!("# Takes {expected}.\n{key} = ");
            assert!(text.contains(&explained), "{headings}{explained}");
        }
    }
}

#[test]
fn defaults_load_back_unchanged_whether_the_settings_are_commented_out_or_not() {
    assert_eq!(parse("defaults", DEFAULTS).unwrap(), Settings::default());
    assert_eq!(parse("defaults", &uncommented(DEFAULTS)).unwrap(), Settings::default());
    for (name, _) in BOARDS {
        let text = DEFAULTS.replace("# board = \"auto\"", &format!("board = \"{name}\""));
        assert_eq!(parse("defaults", &text).unwrap(), load(Some(name), "generic", None, |_, _| {}).unwrap(), "{name}");
    }
}

#[test]
fn defaults_explain_every_setting_with_its_type_and_bounds() {
    let text = uncommented(DEFAULTS);
    for table in keys("").iter().filter(|table| *table != "link" && *table != "board") {
        let (_, section) = text.split_once(&format!("\n[{table}]\n")).unwrap_or_else(|| panic!("{table}"));
        assert_explained(&format!("[{table}]\n"), section.split("\n[").next().unwrap());
    }
    let boards = faults("board = 3\n");
    assert!(text.contains(&format!("# Takes {}.\nboard = \"auto\"\n", boards.split_once("give ").unwrap().1)));
}

#[test]
fn every_kind_of_link_explains_its_settings_and_loads_to_its_defaults() {
    let (all, kinds) = (uncommented(DEFAULTS), faults("[[link]]\nkind = 3\n"));
    let kinds = format!("# Takes {}.\nkind = ", kinds.split_once("give ").unwrap().1);
    for name in LinkKind::NAMES {
        let text = default_link(name).unwrap();
        assert!(text.contains(&kinds) && text.contains(&format!("# - \"{name}\": ")), "{text}");
        let heading = format!("[[link]]\nkind = \"{name}\"\n");
        assert_explained(&heading, &text);
        let mut want = LinkSettings::of(LinkKind::named(name).unwrap());
        if let LinkKind::Maestro(MaestroSettings { channels, .. })
        | LinkKind::Pca9685(Pca9685Settings { channels, .. }) = &mut want.kind
        {
            assert_explained(&format!("{heading}[[link.channel]]\n"), &text);
            let mut jaw = ChannelSettings::default();
            jaw.sources.0[SOURCE_NAMES.iter().position(|name| *name == "jawOpen").unwrap()] = 1.0;
            channels.push(jaw);
        }
        assert_eq!(parse("link", &text).unwrap().links, [want], "{text}");
        if *name == "udp" || *name == "serial" {
            let is_own =
                |part: &&str| ["\naddress = ", "\ndevice = ", "\nbaud = "].iter().any(|key| part.contains(key));
            text.split("\n\n").filter(is_own).for_each(|part| assert!(all.contains(part), "{part}"));
        }
    }
    assert_eq!(default_link("seriell"), None);
}

#[test]
fn a_file_with_every_key_loads_and_each_of_its_tables_counts_as_changed() {
    let settings = parse("file", EVERY_KEY).unwrap();
    let default = Settings::default();
    assert_eq!(settings.changed_keys(&default), keys(""), "the board and every table");
    let changed = [
        (settings.camera.changed_keys(&default.camera), "[camera]\n"),
        (settings.networks.changed_keys(&default.networks), "[networks]\n"),
        (settings.wearer.changed_keys(&default.wearer), "[wearer]\n"),
        (settings.failsafe.changed_keys(&default.failsafe), "[failsafe]\n"),
        (settings.realtime.changed_keys(&default.realtime), "[realtime]\n"),
        (settings.hardware.changed_keys(&default.hardware), "[hardware]\n"),
    ];
    changed.into_iter().for_each(|(changed, heading)| assert_eq!(changed, keys(heading)));
    let sections: Vec<&str> = EVERY_KEY.split("\n[[link]]\n").skip(1).collect();
    assert_eq!((sections.len(), settings.links.len()), (LinkKind::NAMES.len(), LinkKind::NAMES.len()));
    for (link, text) in settings.links.iter().zip(sections) {
        let shared = ["kind", "pace", "rate_hz", "loss", "adjust"];
        let own = link.keys().into_iter().filter(|key| !shared.contains(key));
        own.for_each(|key| assert!(text.contains(&format!("{key} = ")), "{}: {key}", link.kind.name()));
    }
    let jaw = settings.links[0].adjust.coefficients[17];
    assert_eq!((jaw.gain, jaw.offset, jaw.min, jaw.max), (1.25, 0.0, 0.0, 0.9));
    let LinkKind::Maestro(maestro) = &settings.links[5].kind else { panic!() };
    let used: Vec<Vec<_>> = maestro.channels.iter().map(|channel| channel.sources.used().collect()).collect();
    assert_eq!(used, [vec![("jawOpen", 0.8), ("headYaw", 0.001)], vec![("eyeBlinkLeft", 1.0)]]);
}

#[test]
fn a_single_changed_table_is_named_whichever_it_is() {
    let settings = Settings::default();
    for table in EVERY_KEY.split("\n\n").filter(|table| !table.starts_with("[[")) {
        let changed = parse("file", table).unwrap().changed_keys(&settings);
        let name = table.split(['[', ']']).nth(1).unwrap_or("board");
        // A board changes the tables that its file names.
        assert!(changed == [name] || name == "board" && changed.starts_with(&["board"]), "{name}: {changed:?}");
    }
    assert_eq!(parse("file", "[[link]]\n").unwrap().changed_keys(&settings), ["link"]);
    assert!(settings.changed_keys(&Settings::default()).is_empty());
}

#[test]
fn every_board_is_valid_and_names_its_machine_in_a_comment() {
    for (name, text) in BOARDS {
        assert!(load(Some(name), "generic", None, |_, _| {}).is_ok(), "{name}");
        assert!(text.starts_with("# "), "{name}");
    }
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/boards");
    assert_eq!(fs::read_dir(folder).unwrap().count(), BOARDS.len());
}

#[test]
fn the_argument_counts_before_the_file_and_the_file_before_the_board_that_is_recognised() {
    let loaded = |argument, text: &str| {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), text).unwrap();
        load(argument, "pi-zero-2w", Some(file.path()), |_, _| {}).unwrap()
    };
    let cases = [
        (None, "", "pi-zero-2w"),
        (None, "board = \"auto\"\n", "pi-zero-2w"),
        (None, "board = \"pi4\"\n", "pi4"),
        (Some("auto"), "board = \"pi4\"\n", "pi-zero-2w"),
        (Some("pi5"), "board = \"pi4\"\n", "pi5"),
    ];
    for (argument, text, board) in cases {
        assert_eq!(
            loaded(argument, text),
            load(Some(board), "generic", None, |_, _| {}).unwrap(),
            "{argument:?} {text}"
        );
    }
    let camera = loaded(None, "[camera]\nfps = 20\n").camera;
    assert_eq!((camera.fps, camera.width, camera.stall_timeout_ms), (20, 320, 1000));
}

#[test]
fn an_unknown_board_and_an_unreadable_file_are_refused_with_the_remedy() {
    let refused =
        |argument, path: &str| load(argument, "generic", Some(Path::new(path)), |_, _| {}).unwrap_err().to_string();
    let both = refused(Some("pi6"), "/nowhere/facewire.toml");
    let (board, file) = both.split_once('\n').unwrap();
    let known = "auto, generic, pi3, pi4, pi5, pi-zero-2w, orange-pi-5, radxa-zero-3, intel-n100";
    assert_eq!(board, format!("board \"pi6\": not known; give --board one of {known}"));
    assert!(file.starts_with("/nowhere/facewire.toml: cannot be read (No such file"), "{file}");
    assert!(
        faults("board = \"pi6\"\n").starts_with("facewire.toml:1: board = \"pi6\": give one of \"auto\", \"generic\"")
    );
    assert!(faults("[camera]\nboard = \"pi4\"\n").starts_with("facewire.toml:2: camera.board is not a setting"));
}

#[test]
fn all_faults_are_reported_at_once_with_line_key_value_and_bounds() {
    let text = "\
camera = 3
[sned]
[networks]
threds = 2
threads = 0
engine = \"tflite\"
[solver]
smoothing_ms = 180
[failsafe]
live_ms = \"150\"
slew_per_s = nan
[adjust]
jawopen = { gain = 2 }
jawLeft = { min = 0.5, max = 0.4 }
cheekPuff = { gian = 2.0 }
mouthLeft = { gain = 20 }
[metrics]
listen = \"0.0.0.0:9464\"
[wearer]
\"line\\nend\" = 1
name = \"tab\tand é\"
folder = \"~/wearers\"
[[link]]
address = \"127.0.0.1\"
adjust = { mirror = 3 }
[[link]]
kind = \"maestro\"
[[link.channel]]
sources = { jawopen = 1.0, headYaw = 40.0 }
nuetral = 0.5
";
    let want = "\
facewire.toml:1: camera = 3: give a table
facewire.toml:2: sned is not a setting; did you mean send?
facewire.toml:4: networks.threds is not a setting; did you mean threads?
facewire.toml:5: networks.threads = 0: give a whole number from 1 to 8
facewire.toml:6: networks.engine = \"tflite\": give one of \"auto\", \"native\", \"onnxruntime\"
facewire.toml:8: solver.smoothing_ms is no longer a setting: [smoothing] has a filter and a time for each part of the \
face, such as mouth_ms = 180
facewire.toml:10: failsafe.live_ms = \"150\": give a whole number from 20 to 5000 (ms)
facewire.toml:11: failsafe.slew_per_s = nan: give a number from 0.1 to 100.0 (1/s)
facewire.toml:13: adjust.jawopen is not a setting; did you mean jawOpen?
facewire.toml:14: adjust.jawLeft = { min = 0.5, max = 0.4 }: give a min that is at most max
facewire.toml:15: adjust.cheekPuff.gian is not a setting; did you mean gain?
facewire.toml:16: adjust.mouthLeft.gain = 20: give a number from 0.0 to 10.0
facewire.toml:18: metrics.listen = \"0.0.0.0:9464\": give \"\", a loopback address and port such as \"127.0.0.1:9464\" or \
\"[::1]:9464\", or \"unix:\" and a path that begins with /
facewire.toml:20: wearer.line\\nend is not a setting; there are name, folder, neutral
facewire.toml:24: link.address = \"127.0.0.1\": give \"host:port\" with a port from 1 to 65535
facewire.toml:25: link.adjust.mirror = 3: give true or false
facewire.toml:29: link.channel.sources.jawopen is not a setting; did you mean jawOpen?
facewire.toml:29: link.channel.sources.headYaw = 40.0: give a number from -10.0 to 10.0
facewire.toml:30: link.channel.nuetral is not a setting; did you mean neutral?
wearer.folder = \"~/wearers\": give a path from / on: no shell replaces the ~ of a setting
wearer.name = \"tab\\tand é\": give 1 to 32 letters, digits, - or _, or \"\"";
    assert_eq!(faults(text), want);
}

#[test]
fn a_text_that_is_not_toml_has_syntax_errors_alone() {
    let text = faults("[camera]\nwidth = 6400\nheight = = 480\n");
    let is_syntax = |fault: &str| fault.starts_with("facewire.toml:3: not valid TOML: ");
    assert!(!text.is_empty() && text.lines().all(is_syntax), "{text}");
}

#[test]
fn settings_that_do_not_fit_together_are_refused() {
    let cases = [
        ("[failsafe]\nlive_ms = 400\n", "failsafe.hold_ms = 300: give more than failsafe.live_ms, which is 400"),
        ("[failsafe]\nneutral_ms = 200\n", "failsafe.neutral_ms = 200: give more than failsafe.hold_ms, which is 300"),
        ("[camera]\ndevice = \" \"\n", "camera.device = \" \": give \"auto\", the path of a camera"),
        ("[camera]\ndevice = \"rehearsal: nap 2\"\n", "camera.device = \"rehearsal: nap 2\": give a rehearsal such as"),
        ("[solver]\nmodel = \"~\"\n", "solver.model = \"~\": give a path from / on"),
        ("link = []\n", "link = []: give at least one [[link]]"),
        ("[[link]]\nrate_hz = 9\n", "link.rate_hz = 9: give 0 or at least 10"),
    ];
    for (text, want) in cases {
        assert!(faults(text).starts_with(want), "{want}: {}", faults(text));
    }
    assert_eq!(faults("[camera]\ndevice = \"rehearsal: live 5, gone 2\"\n[[link]]\nrate_hz = 10\n"), "");
}

#[test]
fn keys_and_values_of_another_kind_of_link_are_refused() {
    let text = "\
[[link]]
device = \"/dev/ttyUSB0\"
[[link]]
kind = \"serial\"
channel = 3
device = \"ttyUSB0\"
pase = \"rate\"
[[link]]
kind = \"seriell\"
baud = 300
";
    let want = "\
facewire.toml:2: link.device is not a setting of a link with kind = \"udp\"; that has kind, address, pace, rate_hz, loss, adjust
facewire.toml:5: link.channel is not a setting of a link with kind = \"serial\"; that has kind, device, baud, pace, rate_hz, loss, adjust
facewire.toml:6: link.device = \"ttyUSB0\": give \"auto\", or a path in quotes that begins with /
facewire.toml:7: link.pase is not a setting; did you mean pace?
facewire.toml:9: link.kind = \"seriell\": give one of \"udp\", \"serial\", ";
    assert!(faults(text).starts_with(want), "{}", faults(text));
    assert!(
        faults("[link]\n").ends_with("link = [link]: give each link under its own [[link]]"),
        "{}",
        faults("[link]\n")
    );
}

#[test]
fn values_that_receivers_would_not_understand_are_refused() {
    let cases: [(&str, &[&str], &str); 8] = [
        ("kind = \"live-link\"\nsubject", &["", "é"], "1 to 64 printable ASCII characters in quotes"),
        ("kind = \"live-link\"\ndevice_id", &["short"], "36 printable ASCII characters in quotes"),
        ("kind = \"json\"\nto", &["file", "unix:lines", "udp:5000"], "\"stdout\", "),
        ("kind = \"ifacialmocap\"\nlisten", &["localhost:49983", "0.0.0.0:0", "49983"], "\"\", or an address of this"),
        ("kind = \"ifacialmocap\"\naddress", &["pc.local"], "\"\", or \"host:port\""),
        ("kind = \"vrchat\"\nprefix", &["FT", "/FT/", "F T/", "FT*/"], "\"\", or up to 64 letters"),
        ("kind = \"vrchat\"\nparameters", &["JawOpen:9"], "\"\", or names of parameters"),
        ("address", &["", ":1", "host", "host:", "host:0", "host:65536", "::1:5252", "host:port"], "\"host:port\""),
    ];
    for (key, values, expected) in cases {
        for value in values {
            let fault = faults(&format!("[[link]]\n{key} = \"{value}\"\n"));
            assert!(fault.contains(&format!(" = \"{value}\": give {expected}")), "{fault}");
        }
    }
    let addresses = "[[link]]\naddress = \"head.local:1\"\n[[link]]\naddress = \"[::1]:65535\"\n";
    let links = parse("file", addresses).unwrap().links;
    assert_eq!(links.iter().map(LinkSettings::to_string).collect::<Vec<_>>(), ["head.local:1", "[::1]:65535"]);
}

#[test]
fn metrics_are_for_this_machine_alone() {
    for good in ["127.0.0.1:9464", "127.0.0.2:1", "[::1]:9464", "unix:/run/facewire/metrics.sock", ""] {
        assert_eq!(Listen::new(good).unwrap().to_string(), good);
    }
    let others = ["0.0.0.0:9464", "[::]:9464", "192.168.1.5:9464", "localhost:9464", "127.0.0.1", "127.0.0.1:0"];
    for bad in others.into_iter().chain(["unix:", "unix:metrics.sock", "9464", "/run/facewire/metrics.sock"]) {
        assert_eq!(Listen::new(bad), None, "{bad}");
    }
}
