//! What the settings promise.

use facewire_face::BLENDSHAPES;
use facewire_face::settings::{Fields, keys};
use facewire_servo::{ChannelSettings, SOURCE_NAMES};

use super::link::channel_fields;
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

/// Checks that the text of a table explains every key, with the values that it takes.
fn assert_explained(keys: Vec<(&str, Takes)>, text: &str) {
    for (key, takes) in keys.into_iter().filter(|(key, _)| !BLENDSHAPES.contains(key)) {
        assert!(text.contains(&format!("\n{key} = ")) || text.contains(&format!("[[link.{key}]]")), "{key}");
        if !matches!(takes, Takes::Table(_) | Takes::Channels) {
            let explained = format!("# Takes {takes}.\n{key} = ");
            assert!(text.contains(&explained), "{explained}");
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
    for (table, takes) in keys(&mut Settings::default()) {
        match takes {
            Takes::Table(keys) => {
                let (_, section) = text.split_once(&format!("\n[{table}]\n")).unwrap_or_else(|| panic!("{table}"));
                assert_explained(keys, section.split("\n[").next().unwrap());
            }
            Takes::OneOf(_) => assert_explained(vec![(table, takes)], &text),
            _ => assert_eq!(takes, Takes::Links),
        }
    }
}

#[test]
fn every_kind_of_link_explains_its_settings_and_loads_to_its_defaults() {
    for name in LinkKind::NAMES {
        let text = default_link(name).unwrap();
        assert!(text.contains(&format!("# - \"{name}\": ")), "{text}");
        assert_explained(keys(&mut LinkSettings::of(LinkKind::named(name).unwrap())), &text);
        let mut want = LinkSettings::of(LinkKind::named(name).unwrap());
        if let LinkKind::Maestro(MaestroSettings { channels, .. })
        | LinkKind::Pca9685(Pca9685Settings { channels, .. })
        | LinkKind::BusServo(BusServoSettings { channels, .. })
        | LinkKind::Sacn(SacnSettings { channels, .. })
        | LinkKind::ArtNet(ArtNetSettings { channels, .. }) = &mut want.kind
        {
            assert_explained(keys(&mut Fields(&mut ChannelSettings::default(), channel_fields)), &text);
            let channel = u32::from(text.contains("\nuniverse = "));
            let mut jaw = ChannelSettings { channel, ..ChannelSettings::default() };
            jaw.sources[SOURCE_NAMES.iter().position(|name| *name == "jawOpen").unwrap()] = 1.0;
            channels.push(jaw);
        }
        assert_eq!(parse("link", &text).unwrap().links, [want], "{text}");
    }
}

#[test]
fn the_schema_has_every_setting_with_its_type_bounds_choices_unit_default_and_comment() {
    let schema = schema();
    let at = |path: &str| schema.pointer(path).unwrap_or_else(|| panic!("{path}: {schema:#}"));
    let kind = |name: &str| LinkKind::NAMES.iter().position(|kind| *kind == name).unwrap();
    let link = |name: &str, rest: &str| format!("/properties/link/items/oneOf/{}{rest}", kind(name));
    let fps = at("/properties/camera/properties/fps");
    let channel = at("/$defs/channel/properties");
    assert_eq!([&fps["type"], &fps["unit"], &fps["description"]], ["integer", "1/s", "Frame rate."]);
    assert_eq!([&fps["minimum"], &fps["maximum"], &fps["default"]], [1, 240, 30]);
    assert_eq!(at("/properties/board/default"), "auto");
    assert!(at("/properties/smoothing/properties/jaw/enum").as_array().unwrap().contains(&"one-euro".into()));
    assert_eq!(at(&link("pca9685", "/properties/kind/const")), "pca9685");
    assert_eq!(at(&link("pca9685", "/properties/address/default")), 64);
    assert_eq!(at(&link("maestro", "/properties/channel/items/$ref")), "#/$defs/channel");
    assert_eq!(channel["sources"]["properties"]["headYaw"]["maximum"], 10.0);
    assert_eq!(channel["loss"]["default"], "neutral");
    assert_eq!(at("/$defs/adjust/properties/jawOpen/$ref"), "#/$defs/coefficient");
    assert_eq!(at("/$defs/coefficient/properties/gain/maximum"), 10.0);
    assert_eq!(at("/$defs/adjust/properties/mirror/type"), "boolean");
    let text = schema.to_string();
    assert!(!text.contains("\"minimum\":null") && !text.contains("\"default\":null"), "{text}");
    let explained = Settings::default().keys().iter().filter(|key| !["link", "adjust"].contains(key)).all(|key| {
        let table = at(&format!("/properties/{key}"));
        table["properties"].as_object().is_none_or(|keys| keys.values().all(|it| it["description"].is_string()))
    });
    assert!(explained, "{schema:#}");
}

#[test]
fn a_file_with_every_kind_of_link_loads_with_the_values_that_it_gives() {
    let settings = parse("file", EVERY_KEY).unwrap();
    let every_key = Settings::default().keys();
    assert_eq!(settings.changed_keys(&Settings::default()), every_key, "the board and every table");
    assert_eq!(settings.links.len(), LinkKind::NAMES.len());
    let shown = [8, 9].map(|index: usize| settings.links[index].to_string());
    assert_eq!(shown, ["10.0.0.3:5568, universe 7 (6 by Art-Net)", "10.0.0.3:6454, universe 300 (301 by sACN)"]);
    let jaw = settings.links[0].adjust.coefficients[17];
    assert_eq!((jaw.gain, jaw.offset, jaw.min, jaw.max), (1.25, 0.0, 0.0, 0.9));
    let LinkKind::Maestro(maestro) = &settings.links[5].kind else { panic!() };
    let used: Vec<Vec<_>> = maestro.channels.iter().map(|channel| channel.used_sources().collect()).collect();
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
    let refused = faults("[camera]\nrotation = 45");
    assert!(refused.ends_with("camera.rotation = 45: give one of 0, 90, 180, 270"), "{refused}");
    let camera = loaded(None, "[camera]\nfps = 20\n").camera;
    assert_eq!((camera.fps, camera.width, camera.stall_timeout_ms), (20, 320, 1000));
}

#[test]
fn all_faults_are_reported_at_once_with_line_key_value_and_bounds() {
    let lines = [
        ("camera = 3", "camera = 3: give a table"),
        ("[sned]", "sned is not a setting; did you mean send?"),
        ("[networks]\nthreads = 0", "networks.threads = 0: give a whole number from 1 to 8"),
        ("engine = \"tflite\"", "networks.engine = \"tflite\": give one of \"auto\", \"native\", \"onnxruntime\""),
        ("[failsafe]\nlive_ms = \"9\"", "failsafe.live_ms = \"9\": give a whole number from 20 to 5000 (ms)"),
        ("slew_per_s = nan", "failsafe.slew_per_s = nan: give a number from 0.1 to 100.0 (1/s)"),
        ("[adjust]\njawLeft = { min = 0.5, max = 0.4 }", "adjust.jawLeft = { min = 0.5, max = 0.4 }: give a min"),
        ("[wearer]\n\"line\\nend\" = 1", "wearer.line\\nend is not a setting; there are name, folder, neutral, wears"),
        ("[[link]]\nadjust = { mirror = 3 }", "link.adjust.mirror = 3: give true or false"),
        ("device = \"tty\"", "link.device is not a setting of a link with kind = \"udp\"; that has kind, address, "),
        ("[[link]]\nkind = \"maestro\"\n[[link.channel]]\nspeed = 1", "link.channel.speed is not a setting; did"),
        (
            "[log]\nlevel = \"Warning\"",
            "log.level = \"Warning\": give one of \"error\", \"warn\", \"info\", \"debug\", \"trace\"; did you mean warn?",
        ),
        ("[[link]]\nkind = \"seriell\"", "link.kind = \"seriell\": give one of \"udp\", \"serial\", \"live-link\", "),
        ("[metrics]\nlisten = \"tab\té\"", "metrics.listen = \"tab\\té\": give \"\", a loopback address"),
    ];
    let mut text = String::new();
    let mut want = Vec::new();
    for (lines, fault) in lines {
        text += &format!("{lines}\n");
        want.push(format!("facewire.toml:{}: {fault}", text.lines().count()));
    }
    let faults = faults(&text);
    assert_eq!(faults.lines().count(), want.len(), "{faults}");
    faults.lines().zip(want).for_each(|(fault, want)| assert!(fault.starts_with(&want), "{want}: {faults}"));
}

#[test]
fn wrong_values_and_settings_that_do_not_fit_together_are_refused() {
    let cases = [
        ("[camera]\nwidth = 6400\nheight = = 480\n", "facewire.toml:3: not valid TOML: "),
        ("board = \"pi6\"\n", "facewire.toml:1: board = \"pi6\": give one of \"auto\", \"generic\""),
        ("[failsafe]\nlive_ms = 400\n", "failsafe.hold_ms = 300: give more than failsafe.live_ms, which is 400"),
        ("[failsafe]\nneutral_ms = 200\n", "failsafe.neutral_ms = 200: give more than failsafe.hold_ms, which is 300"),
        ("[camera]\ndevice = \"rehearsal: nap 2\"\n", "camera.device = \"rehearsal: nap 2\": give a rehearsal such as"),
        ("[solver]\nmethod = \"paper\"\nmodel = \"a\"\n", "solver.model = \"a\": give none with method = \"paper\""),
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
    let not_of_this_machine = "0.0.0.0:9464|localhost:9464|127.0.0.1:0|unix:m";
    let longest = "é".repeat(64);
    let too_long = "x".repeat(65);
    let cases = [
        ("address", "head.local:1|[::1]:65535", "|:1|host|host:|host:0|host:65536|::1:5252", "\"host:port\""),
        ("kind = \"serial\"\ndevice", "/dev/ttyUSB0", "ttyUSB0", "\"auto\", or a path in quotes"),
        ("kind = \"live-link\"\nsubject", "my face", "|é", "1 to 64 printable ASCII characters"),
        ("kind = \"live-link\"\ndevice_id", "0123456789abcdef0123456789abcdef0123", "short", "36 printable"),
        ("kind = \"json\"\nto", "udp:host:1|unix:/run/lines", "file|unix:lines|udp:5000", "\"stdout\", "),
        ("kind = \"ifacialmocap\"\nlisten", "|0.0.0.0:1", "localhost:1|0.0.0.0:0|49983", "\"\", or an address of"),
        ("kind = \"ifacialmocap\"\naddress", "|pc.local:1", "pc.local", "\"\", or \"host:port\""),
        ("kind = \"vrchat\"\nprefix", "|FT/", "FT|/FT/|F T/|FT*/", "\"\", or up to 64"),
        ("kind = \"vrchat\"\nparameters", "JawOpen:8, MouthX", "JawOpen:9", "\"\", or names of parameters"),
        ("kind = \"maestro\"\n[[link.channel]]\nname", &longest, &too_long, "\"\", or a name of up to 64 characters"),
        (
            "kind = \"sacn\"\n[[link.channel]]\nname",
            "|left brow",
            "tab\\there",
            "\"\", or a name of up to 64 characters",
        ),
        ("[metrics]\nlisten", "|[::1]:9464|unix:/run/m", not_of_this_machine, "\"\", a loop"),
    ];
    for (key, good, bad, expected) in cases {
        let faults = |value| faults(&format!("[[link]]\n{key} = \"{value}\"\n"));
        good.split('|').for_each(|good| assert_eq!(faults(good), "", "{key} {good}"));
        for bad in bad.split('|') {
            assert!(faults(bad).contains(&format!(" = \"{bad}\": give {expected}")), "{key} {bad}: {}", faults(bad));
        }
    }
}

#[test]
fn a_file_may_have_a_byte_order_mark_and_one_in_another_encoding_is_refused_with_its_line() {
    let toml = "[camera]\nfps = 20\n# höher\n";
    let loaded = |bytes: &[u8]| {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let outcome = load(None, "generic", Some(file.path()), |_, _| {}).map(|settings| settings.camera.fps);
        outcome.map_err(|faults| faults.to_string().replace(file.path().to_str().unwrap(), "file"))
    };
    let marked = format!("\u{feff}{toml}");
    assert_eq!(loaded(marked.as_bytes()), Ok(20));
    assert_eq!(parse("file", &marked).unwrap().camera.fps, 20, "a text that was kept");
    let utf16: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
    for file in [&utf16[..], &utf16[2..]] {
        assert!(loaded(file).unwrap_err().starts_with("file:1: the file is in UTF-16"), "{:?}", loaded(file));
    }
    let latin1: Vec<u8> = toml.chars().map(|letter| letter as u8).collect();
    assert_eq!(loaded(&latin1), Err("file:3: this line is not in UTF-8; save the file as UTF-8".to_owned()));
}

#[test]
fn a_choice_that_is_spelt_differently_is_refused_with_the_one_that_may_be_meant() {
    let meant = [("live_link", "live-link"), ("LiveLink", "live-link"), ("livelink", "live-link"), ("UDP", "udp")];
    let meant = meant.into_iter().chain([("art-net", "artnet"), ("sACN", "sacn"), ("iFacialMocap", "ifacialmocap")]);
    for (written, kind) in meant {
        let faults = faults(&format!("[[link]]\nkind = \"{written}\"\n"));
        assert!(faults.ends_with(&format!("; did you mean {kind}?")) && !faults.contains('\n'), "{faults}");
    }
    assert!(!faults("[[link]]\nkind = \"quic\"\n").contains("did you mean"));
    assert!(faults("board = \"pi_4\"\n").ends_with("; did you mean pi4?"), "{}", faults("board = \"pi_4\"\n"));
}

#[test]
fn an_address_that_is_not_what_it_seems_is_refused_with_what_to_give() {
    let numbers = "four decimal numbers from 0 to 255 without leading zeros";
    let brackets = "an IPv6 address in brackets";
    let cases = [
        (
            "127.0.0.010:1|010.0.0.1:1|127.1:1|2130706433:1|0x7f.0.0.1:1|0X7F000001:1|1.2.3.256:1|1.2.3.4.:1|1.2.3:1",
            numbers,
        ),
        ("*:1|*.local:1", "in place of the star: 0.0.0.0 to listen"),
        (" head:1|head:1 |he ad:1|head :1|head:\\t1|\u{a0}head:1", "without blanks"),
        ("::1:1|fe80::1:1|[fe80::1%]:1|[head]:1|[127.0.0.1]:1|[]:1", brackets),
        ("udp://head:1|head/:1|a@b:1|head]:1", "a name has letters, digits and - _ . only"),
    ];
    for (bad, expected) in cases {
        for bad in bad.split('|') {
            let keys =
                [("kind = \"udp\"\naddress", ""), ("kind = \"sacn\"\naddress", ""), ("kind = \"json\"\nto", "udp:")];
            for (key, prefix) in keys {
                let faults = faults(&format!("[[link]]\n{key} = \"{prefix}{bad}\"\n"));
                assert!(faults.contains(expected) && !faults.contains('\n'), "{bad}: {faults}");
            }
        }
    }
    for bad in ["127.0.0.010:49983", "*:49983", " 0.0.0.0:49983"] {
        let faults = faults(&format!("[[link]]\nkind = \"ifacialmocap\"\nlisten = \"{bad}\"\n"));
        assert!(
            ["without leading zeros", "the star", "without blanks"].iter().any(|it| faults.contains(it)),
            "{faults}"
        );
    }
    for good in
        ["127.0.0.10:1", "head7:1", "7.head.local:1", "0xhead:1", "[fe80::1%eth0]:1", "[ff02::1%2]:1", "höhle.local:1"]
    {
        assert_eq!(faults(&format!("[[link]]\naddress = \"{good}\"\n")), "");
    }
}

#[test]
fn a_script_is_read_or_refused_and_another_camera_setting_is_none() {
    let scenes = vec![(Scene::Live, 5_000_000), (Scene::Gone, 2_500_000), (Scene::NoFace, 1_000_000)];
    assert_eq!(Script::of("rehearsal: live 5, gone 2.5,no-face 1"), Some(Ok(Script::Scenes(scenes))));
    assert_eq!(Script::of("rehearsal: random 7"), Some(Ok(Script::Random(7))));
    assert_eq!(Script::of("/dev/video0"), None);
    for bad in ["", "live", "live 0", "live -1", "live x", "live 3,", "nap 3", "random", "random x", "live 1e9"] {
        assert!(Script::of(&format!("rehearsal:{bad}")).unwrap().is_err(), "{bad}");
    }
}
