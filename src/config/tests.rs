//! What the settings promise.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use facewire_face::BLENDSHAPES;

use super::overlay::Section as _;
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
fn defaults_and_those_of_every_board_load_back_unchanged_whether_they_are_commented_out_or_not() {
    assert_eq!(parse("defaults", &uncommented(DEFAULTS)).unwrap(), Settings::default());
    for (name, _) in BOARDS {
        let text = DEFAULTS.replace("# board = \"auto\"", &format!("board = \"{name}\""));
        assert_eq!(parse("defaults", &text).unwrap(), load(Some(name), "generic", None, |_, _| {}).unwrap(), "{name}");
    }
    assert_eq!(parse("defaults", DEFAULTS).unwrap(), Settings::default());
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
fn the_argument_counts_before_the_file_and_the_file_before_the_board_that_is_recognised() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/boards");
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), BOARDS.len(), "every file is known");
    let loaded = |argument, text: &str| {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
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
        let want = load(Some(board), "generic", None, |_, _| {}).unwrap();
        assert_eq!(loaded(argument, text), want, "{argument:?} {text}");
    }
    let camera = loaded(None, "[camera]\nfps = 20\n").camera;
    assert_eq!((camera.fps, camera.width, camera.stall_timeout_ms), (20, 320, 1000));
    let file = Some(Path::new("/nowhere/facewire.toml"));
    let refused = load(Some("pi6"), "generic", file, |_, _| {}).unwrap_err().to_string();
    let (board, file) = refused.split_once('\n').unwrap();
    assert!(board.starts_with("board \"pi6\": not known; give --board one of auto, generic, pi3"), "{board}");
    assert!(file.starts_with("/nowhere/facewire.toml: cannot be read (No such file"), "{file}");
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
[wearer]
\"line\\nend\" = 1
name = \"tab\tand é\"
[[link]]
address = \"127.0.0.1\"
adjust = { mirror = 3 }
device = \"/dev/ttyUSB0\"
[[link]]
kind = \"maestro\"
[[link.channel]]
sources = { jawopen = 1.0, headYaw = 40.0 }
nuetral = 0.5
[[link]]
kind = \"seriell\"
baud = 300
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
facewire.toml:18: wearer.line\\nend is not a setting; there are name, folder, neutral
facewire.toml:21: link.address = \"127.0.0.1\": give \"host:port\" with a port from 1 to 65535
facewire.toml:22: link.adjust.mirror = 3: give true or false
facewire.toml:23: link.device is not a setting of a link with kind = \"udp\"; that has kind, address, pace, rate_hz, loss, adjust
facewire.toml:27: link.channel.sources.jawopen is not a setting; did you mean jawOpen?
facewire.toml:27: link.channel.sources.headYaw = 40.0: give a number from -10.0 to 10.0
facewire.toml:28: link.channel.nuetral is not a setting; did you mean neutral?
facewire.toml:30: link.kind = \"seriell\": give one of \"udp\", \"serial\", \"live-link\", \"vmc\", \"vrchat\", \
\"maestro\", \"pca9685\", \"ifacialmocap\", \"json\"
wearer.name = \"tab\\tand é\": give 1 to 32 letters, digits, - or _, or \"\"";
    assert_eq!(faults(text), want);
}

#[test]
fn wrong_values_and_settings_that_do_not_fit_together_are_refused() {
    let cases = [
        ("[camera]\nwidth = 6400\nheight = = 480\n", "facewire.toml:3: not valid TOML: "),
        ("board = \"pi6\"\n", "facewire.toml:1: board = \"pi6\": give one of \"auto\", \"generic\""),
        ("[camera]\nboard = \"pi4\"\n", "facewire.toml:2: camera.board is not a setting"),
        ("[failsafe]\nlive_ms = 400\n", "failsafe.hold_ms = 300: give more than failsafe.live_ms, which is 400"),
        ("[failsafe]\nneutral_ms = 200\n", "failsafe.neutral_ms = 200: give more than failsafe.hold_ms, which is 300"),
        ("[camera]\ndevice = \" \"\n", "camera.device = \" \": give \"auto\", the path of a camera"),
        ("[camera]\ndevice = \"rehearsal: nap 2\"\n", "camera.device = \"rehearsal: nap 2\": give a rehearsal such as"),
        ("[solver]\nmodel = \"~\"\n", "solver.model = \"~\": give a path from / on"),
        ("link = []\n", "link = []: give at least one [[link]]"),
        ("[link]\n", "facewire.toml:1: link = [link]: give each link under its own [[link]]"),
        ("[[link]]\nrate_hz = 9\n", "link.rate_hz = 9: give 0 or at least 10"),
    ];
    for (text, want) in cases {
        let faults = faults(text);
        assert!(faults.lines().all(|fault| fault.starts_with(want)) && !faults.is_empty(), "{want}: {faults}");
    }
}

#[test]
fn texts_are_taken_or_refused_with_what_to_give() {
    let cases: [(&str, &[&str], &[&str], &str); 10] = [
        ("[[link]]\nkind = \"live-link\"\nsubject", &["my face"], &["", "é"], "1 to 64 printable ASCII characters"),
        ("[[link]]\nkind = \"live-link\"\ndevice_id", &[], &["short"], "36 printable ASCII characters in quotes"),
        ("[[link]]\nkind = \"json\"\nto", &["udp:host:1"], &["file", "unix:lines", "udp:5000"], "\"stdout\", "),
        (
            "[[link]]\nkind = \"ifacialmocap\"\nlisten",
            &["", "0.0.0.0:49983"],
            &["localhost:49983", "0.0.0.0:0", "49983"],
            "\"\", or an address of this",
        ),
        ("[[link]]\nkind = \"ifacialmocap\"\naddress", &["", "pc.local:1"], &["pc.local"], "\"\", or \"host:port\""),
        ("[[link]]\nkind = \"vrchat\"\nprefix", &["FT/"], &["FT", "/FT/", "F T/", "FT*/"], "\"\", or up to 64"),
        ("[[link]]\nkind = \"vrchat\"\nparameters", &["JawOpen:8"], &["JawOpen:9"], "\"\", or names of parameters"),
        ("[[link]]\nkind = \"serial\"\ndevice", &["/dev/ttyUSB0"], &["ttyUSB0"], "\"auto\", or a path in quotes"),
        (
            "[[link]]\naddress",
            &["head.local:1", "[::1]:65535"],
            &["", ":1", "host", "host:", "host:0", "host:65536", "::1:5252", "host:port"],
            "\"host:port\"",
        ),
        // Metrics are for this machine alone.
        (
            "[metrics]\nlisten",
            &["127.0.0.1:9464", "127.0.0.2:1", "[::1]:9464", "unix:/run/facewire/metrics.sock", ""],
            &["0.0.0.0:9464", "[::]:9464", "192.168.1.5:9464", "localhost:9464", "127.0.0.1:0", "unix:m.sock", "9464"],
            "\"\", a loopback address and port",
        ),
    ];
    for (key, good, bad, expected) in cases {
        good.iter().for_each(|value| assert_eq!(faults(&format!("{key} = \"{value}\"\n")), "", "{key} {value}"));
        for value in bad {
            let fault = faults(&format!("{key} = \"{value}\"\n"));
            assert!(fault.contains(&format!(" = \"{value}\": give {expected}")), "{fault}");
        }
    }
}
