//! Heads are set up, moved and stopped by hand, with the real service and simulated boards: bus servos, Maestros and universes of DMX.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

#[path = "../../servo/program/bus.rs"]
mod bus;
mod common;

use std::{
    env, fs,
    io::Write as _,
    net::{IpAddr, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use bus::Bus;
use common::{
    PATIENCE, Viewer,
    browser::{Browser, control, element, labelled, or_arm},
    command, eventually,
    hooks::hook,
    maestro::{Maestro, Model},
    python_with,
    service::elsewhere,
    skip,
};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

const PHONE: (u32, u32) = (360, 740);
const DESK: (u32, u32) = (1280, 900);
/// A service without a camera shows the neutral face.
const SETTINGS: &str = "[camera]\ndevice = \"/dev/video99\"\n\n[[link]]\naddress = \"127.0.0.1:9\" # nobody\n";

/// A service, a console of it, and a browser with its page of settings.
struct Head {
    service: Child,
    browser: Browser,
    size: (u32, u32),
    program: PathBuf,
    folder: TempDir,
    console: Viewer,
}

/// The program of the service. Cargo puts it into the folder above that of this test, but does not build it for this test. It
/// must be newer than its sources.
fn program() -> PathBuf {
    let folder = env::current_exe().unwrap().parent().unwrap().to_owned();
    let program = folder.with_file_name("facewire");
    let modified = |path: &Path| fs::metadata(path).and_then(|file| file.modified()).ok();
    let built = modified(&program);
    let sources = sources(&folder);
    assert!(sources.len() > 20, "{sources:?}");
    let newer = sources.iter().find(|source| modified(source) > built);
    assert!(
        built.is_some() && newer.is_none(),
        "{} is missing or older than {}: run cargo test --workspace --no-run",
        program.display(),
        newer.map_or("its sources".into(), |source| source.display().to_string())
    );
    program
}

/// What the program is built from: the files that rustc names beside the libraries of its crates.
fn sources(libraries: &Path) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let tree = "tree --package facewire --edges normal,build --prefix none --offline --format {p}";
    let tree = Command::new(cargo).args(tree.split(' ')).current_dir(root).output().unwrap();
    // A crate of this repository has its folder behind its name.
    let tree = String::from_utf8(tree.stdout).unwrap();
    let crates: Vec<String> = tree
        .lines()
        .filter(|line| line.contains(" (/"))
        .map(|line| line.split(' ').next().unwrap().replace('-', "_"))
        .collect();
    let mut sources = vec![root.join("src/main.rs")];
    for list in fs::read_dir(libraries).unwrap().map(|entry| entry.unwrap().path()) {
        let is_list = list.extension().is_some_and(|extension| extension == "d");
        let name = list.file_stem().unwrap().to_str().unwrap().rsplit_once('-').map_or("", |(name, _)| name);
        if is_list && crates.iter().any(|known| known == name) {
            let text = fs::read_to_string(&list).unwrap();
            // Lists of a library's unit tests name more files. They belong to a program or, if clippy made them, to no code.
            let is_library = text.contains(&format!("/lib{name}-")) && text.contains(".rlib:");
            // For each file, the list has a line with only the file and a colon.
            let files = text.lines().filter_map(|line| line.strip_suffix(':'));
            sources.extend(files.filter(|_| is_library).map(|file| root.join(file.replace("\\ ", " "))));
        }
    }
    // Leave out what build scripts have written: it may be newer, because its crate was compiled for another purpose since.
    sources.retain(|source| !source.starts_with(libraries.parent().unwrap()));
    sources
}

impl Head {
    /// `None`, with a note, if there is no browser.
    fn start(size: (u32, u32)) -> Option<Self> {
        Self::with(size, SETTINGS)
    }

    /// As [`Self::start`], with these settings.
    fn with(size: (u32, u32), settings: &str) -> Option<Self> {
        if !Browser::is_installed() {
            skip("there is no chromium; scripts/setup tests installs it");
            return None;
        }
        let program = program();
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let config = path("facewire.toml");
        fs::write(&config, settings).unwrap();
        let mut service = Command::new(&program);
        service
            .args(["run", "--config", &config])
            .env("RUNTIME_DIRECTORY", folder.path())
            .env("STATE_DIRECTORY", path("kept"))
            .env("LD_PRELOAD", hook("answers"));
        service.env("FACEWIRE_SYSROOT", "/nonexistent").stdin(Stdio::null()).stdout(Stdio::null());
        let service = service.stderr(fs::File::create(path("log")).unwrap()).spawn().unwrap();
        let (control, state) = (path("control"), path("state"));
        let arguments = ["--listen", "0.0.0.0:0", "--config", &config, "--control", &control, "--state", &state];
        let console = Viewer::spawn(command(&arguments).env("FACEWIRE_PROGRAM", &program));
        let browser = Browser::start(size.0, size.1);
        let mut head = Self { service, browser, size, program, folder, console };
        head.open([127, 0, 0, 1].into());
        head.may_operate();
        head.browser.wait_for_text("A new link");
        Some(head)
    }

    /// Opens the page of settings at this address of the console.
    fn open(&mut self, address: IpAddr) {
        let (_, port) = self.console.host().rsplit_once(':').unwrap();
        self.browser.open(&format!("http://{address}:{port}/#links"));
    }

    /// Waits until STOP can be pressed.
    fn may_operate(&mut self) {
        self.browser.wait_until("document.getElementById('stop')?.disabled === false");
    }

    /// Clicks a button that changes the draft of the settings, and waits until the page shows the new draft.
    fn click(&mut self, text: &str) {
        self.browser.click(text);
        self.browser.settle();
    }

    /// Adds a link of this kind on the page of settings, and opens its form.
    fn add_link(&mut self, kind: &str) {
        self.add_link_after(1, kind);
    }

    /// As [`Self::add_link`], after this many other links.
    fn add_link_after(&mut self, links: usize, kind: &str) {
        self.browser.wait_until(&format!("document.querySelector('option[value={kind}]')"));
        self.browser.choose(&format!("document.querySelector('option[value={kind}]')?.parentElement"), kind);
        self.click("Add");
        self.browser.wait_until(&format!("document.querySelectorAll('details.link')[{links}]?.open"));
    }

    /// Sets a field of the second link.
    fn set(&mut self, key: &str, value: &str) {
        self.put(&element(&format!("[id='field-link.1.{key}']")), value);
    }

    /// Types a value into a field, or chooses it in a list.
    fn put(&mut self, field: &str, value: &str) {
        self.browser.wait_until(field);
        if self.browser.value(&format!("{field}.matches('select')")) == true {
            self.browser.choose(field, value);
        } else {
            self.browser.fill(field, value);
            self.browser.press("Tab");
        }
        self.browser.settle();
    }

    /// Gives the field of a channel with this label a value.
    fn choose(&mut self, card: &str, label: &str, value: &str) {
        self.put(&labelled(&format!("[aria-label='{card}']"), label), value);
    }

    /// Adds a source to a channel.
    fn follow(&mut self, card: &str, source: &str) {
        self.choose(card, "Add from the list", source);
        let button = format!("[aria-label='Add {source} to {}']", card.to_lowercase());
        self.browser.click_on(&element(&button));
        self.browser.settle();
    }

    /// Gives the password on the form for it.
    fn enter(&mut self, button: &str) {
        self.browser.fill(&element("[name=password]"), "a good password");
        if self.browser.value("document.querySelector('[name=again]') !== null") == true {
            self.browser.fill(&element("[name=again]"), "a good password");
        }
        self.browser.click(button);
        self.may_operate();
    }

    /// Lets the servos move that an operator has released.
    fn let_move(&mut self) {
        self.browser.click("Let servos move again");
        self.browser.wait_until("!document.querySelector('.released')");
    }

    /// Keeps the settings once they have no fault.
    fn keep(&mut self) {
        self.browser.wait_for_text("changed and not kept yet");
        self.browser.click("Keep");
        self.browser.wait_until("!document.getElementById('draft')");
    }

    /// Drags a slider to `position`, waits until the servo arrives and the page shows `text`, and then clicks `button`. Begins
    /// again if the page has disarmed, even just before the click: a busy machine delays its heartbeat.
    fn drive(&mut self, name: &str, position: f64, text: &str, button: &str, mut has_arrived: impl FnMut() -> bool) {
        let begun = Instant::now();
        let slider = element(&format!("[aria-label='Move {name}']"));
        let is_armed = format!("!{slider}.disabled");
        let is_done = format!("document.body.innerText.includes({text:?}) && {} !== undefined", control(button));
        // The hand remembers which control it has clicked.
        let is_clicked = format!("hand.control?.textContent.trim().startsWith({button:?})");
        loop {
            assert!(begun.elapsed() < PATIENCE, "{button} is not clicked at {position} of {name}");
            self.browser.drive(&slider, position);
            while self.browser.value(&is_armed) == true {
                if has_arrived() && self.browser.value(&is_done) == true {
                    self.browser.click_on(&or_arm(button));
                    self.browser.settle();
                    if self.browser.value(&is_clicked) == true {
                        return;
                    }
                    break;
                }
                let shown = "document.querySelector('main')?.innerText";
                assert!(
                    begun.elapsed() < PATIENCE,
                    "{name} does not come to {position}: {}",
                    self.browser.value(shown)
                );
                self.browser.wait_for_picture();
            }
        }
    }

    /// Takes pictures of a page at both sizes, from its form on. Nothing is wider than the screen.
    fn look(&mut self, name: &str) {
        for ((width, height), device) in [(PHONE, "phone"), (DESK, "desk")] {
            self.browser.resize(width, height);
            self.browser.value("(document.querySelector('.channel details[open]') ?? document.querySelector('.board'))?.scrollIntoView()");
            self.browser.screenshot(&format!("{name} on a {device}"));
            let excess = "document.documentElement.scrollWidth - document.documentElement.clientWidth";
            assert_eq!(self.browser.value(excess), 0, "{name} on a {device}");
        }
        self.browser.resize(self.size.0, self.size.1);
    }

    /// The links that were added, once `facewire check` has accepted the settings.
    fn saved(&self) -> String {
        let path = self.folder.path().join("facewire.toml");
        let check =
            Command::new(&self.program).args(["check", "--settings-only", "--config"]).arg(&path).output().unwrap();
        let settings = fs::read_to_string(path).unwrap();
        assert!(check.status.success(), "{settings}{}", String::from_utf8_lossy(&check.stderr));
        settings.strip_prefix(SETTINGS).unwrap_or_else(|| panic!("{settings}")).to_owned()
    }
}

impl Drop for Head {
    fn drop(&mut self) {
        let _ = self.service.kill();
        let _ = self.service.wait();
        if thread::panicking() {
            eprintln!("{}", fs::read_to_string(self.folder.path().join("log")).unwrap_or_default());
        }
    }
}

/// What other people's programs find in this many datagrams of a kind that come to the socket, as JSON.
fn decoded(python: &Path, kind: &str, socket: &UdpSocket, count: usize) -> String {
    let mut lines = String::new();
    for _ in 0..count {
        let mut datagram = [0; 2048];
        let length = socket.recv(&mut datagram).unwrap();
        let digits: String = datagram[..length].iter().map(|byte| format!("{byte:02x}")).collect();
        lines += &format!("{kind} {digits}\n");
    }
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/receivers.py");
    let mut decoder = Command::new(python).arg(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    decoder.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    String::from_utf8(decoder.wait_with_output().unwrap().stdout).unwrap()
}

#[test]
fn the_first_page_leads_from_settings_without_a_link_to_a_face_in_unreal_and_in_vrchat() {
    let Some(python) = python_with("venv-tests", "pythonosc, pylivelinkface") else {
        skip("there is no python-osc or PyLiveLinkFace: run scripts/setup tests");
        return;
    };
    let Some(mut head) = Head::with(DESK, "[camera]\ndevice = \"demo\"\n") else { return };
    let [unreal, vrchat] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    for socket in [&unreal, &vrchat] {
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
    }
    head.browser.turn_to("start");
    head.browser.wait_for_text("The built-in clip");
    // The landmarks are bright points on black.
    let points = "((canvas) => canvas?.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data\
                  .filter((value, at) => at % 4 === 1 && value > 200).length)(document.querySelector('.camera canvas'))";
    head.browser.wait_until(&format!("{points} > 400"));
    head.browser.screenshot("first 1 camera");
    head.browser.click("Next");
    head.browser.wait_for_text("Yes: the face is followed.");
    head.browser.screenshot("first 2 face");
    head.browser.click("Next");
    for (title, socket) in [("Unreal (Live Link)", &unreal), ("VRChat", &vrchat)] {
        let program =
            format!("[...document.querySelectorAll('details')].find((one) => one.innerText.startsWith('{title}'))");
        head.browser.click_on(&format!("{program}?.querySelector('summary')"));
        head.browser.fill(&format!("{program}.querySelector('input')"), &socket.local_addr().unwrap().to_string());
        head.browser.screenshot(&format!("first 3 {title}"));
        head.browser.click_on(&format!("{program}.querySelector('button')"));
        head.browser.wait_for_text(&format!("{title} {}", socket.local_addr().unwrap()));
    }
    head.keep();
    head.browser.click("Next");
    head.browser.wait_for_text("Open and close your mouth");
    head.browser.wait_until("document.querySelectorAll('.list li').length === 2");
    head.browser.screenshot("first 4 sent");

    // The clip opens its mouth and shuts it again.
    let mut jaws: Vec<f64> = Vec::new();
    eventually("a mouth that opens", || {
        let faces = decoded(&python, "live-link", &unreal, 60);
        let faces = faces.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        jaws.extend(faces.filter_map(|face| face["values"]["JawOpen"].as_f64()));
        jaws.iter().any(|jaw| *jaw > 0.5) && jaws.iter().any(|jaw| *jaw < 0.2)
    });
    let bundles = decoded(&python, "osc", &vrchat, 30);
    assert!(bundles.contains("/avatar/parameters/v2/JawOpen"), "{bundles}");
}

#[test]
fn bus_servos_are_added_moved_and_kept_by_clicks_and_one_that_does_not_answer_is_told() {
    let Some(mut head) = Head::start(PHONE) else { return };
    let bus = Bus::plugged_in("feetech-sts", &[1]);
    let device = bus.device.to_str().unwrap();
    // It stands close to its range, because it is slow: from where simulated servos begin, its way takes half a minute.
    bus.lock().servos[0].place = 174.0 * 4096.0 / 360.0;
    let is_at = |degrees: f64| (bus.servos()[0].1 - degrees * 4096.0 / 360.0).abs() < 3.0;
    head.add_link("bus-servo");
    for (key, value) in [("device", device), ("family", "feetech-sts"), ("unit", "degrees")] {
        head.set(key, value);
    }
    head.look("a link to bus servos");
    head.browser.turn_to("servos");
    for (id, source) in [(1, "jawOpen"), (2, "headYaw")] {
        head.click("Add a servo");
        head.follow(&format!("Servo {id}"), source);
    }
    head.keep();
    let link = format!(
        "\n[[link]]\nkind = \"bus-servo\"\ndevice = \"{device}\"\nfamily = \"feetech-sts\"\nunit = \"degrees\"\n"
    );
    let ends = "position_at_0 = 175\nposition_at_1 = 185\n";
    let jaw = format!("\n[[link.channel]]\nchannel = 1\n{ends}sources = {{ jawOpen = 1 }}\nspeed_per_s = 0.5\n");
    let neck = format!(
        "\n[[link.channel]]\nchannel = 2\n{ends}sources = {{ headYaw = 0.0125 }}\nspeed_per_s = 0.5\noffset = 0.5\n"
    );
    assert_eq!(head.saved(), [&*link, &jaw, &neck].concat());
    head.browser.wait_for_text("Servo 2: it does not answer: check its power and cable");
    head.look("a bus servo that does not answer");
    assert!(!bus.servos()[0].0, "a new servo moves only once it may");
    // It is moved by hand before the face ever moves it.
    head.drive("servo 1", 0.25, "place 177.5 degrees", "Set end 0 here", || is_at(177.5));
    head.browser.click("Ends, speed and more");
    head.choose("Servo 1", "Place at end 1", "190.5");
    head.look("a bus servo with new ends");
    // The servo that does not answer may have torque, and the one in the hand has.
    head.browser.wait_for_text("STOP holds");
    head.browser.click("Let servos move again");
    head.keep();
    let ends = "position_at_0 = 177.5\nposition_at_1 = 190.5\n";
    assert_eq!(
        head.saved(),
        [&*link, &jaw.replace("position_at_0 = 175\nposition_at_1 = 185\n", ends), &neck].concat()
    );
    head.drive("servo 1", 1.0, "", "Disarm", || is_at(190.5));
    bus.lock().plug_in(2, Instant::now());
    head.browser.wait_until("!document.body.innerText.includes('does not answer')");
    assert_eq!(head.browser.errors(), Vec::<Value>::new());
}

#[test]
fn every_setting_of_the_service_has_a_name_and_no_page_shows_marks_of_code_or_commands() {
    let Some(mut head) = Head::start(DESK) else { return };
    let nameless = "Promise.all([import('./words.js'), fetch('api/1/settings').then((answer) => answer.json())]).then(([{ NAMES, KINDS }, { schema }]) => {
        const isField = ({ type, enum: choices }) => choices !== undefined || ['string', 'integer', 'number', 'boolean'].includes(type);
        const of = ({ properties }) => Object.entries(properties);
        const has = (path, key) => `${path}${key}` in NAMES || key in NAMES;
        const sections = of(schema).map(([name, it]) => [name, it.$ref ? schema.$defs[it.$ref.split('/').pop()] : it]);
        const kinds = schema.properties.link.items.oneOf;
        const below = [
            ...sections.filter(([, it]) => it.properties).map(([name, it]) => [`${name}.`, it]),
            ...kinds.map((it) => [`link.${it.properties.kind.const}.`, it]),
            ['link.channel.', schema.$defs.channel],
        ];
        return [
            ...sections.map(([name]) => name).filter((name) => !has('', name)),
            ...kinds.map((it) => it.properties.kind.const).filter((kind) => !(kind in KINDS)),
            ...below.flatMap(([path, it]) => of(it).filter(([key, field]) => isField(field) && !has(path, key)).map(([key]) => path + key)),
        ];
    })";
    assert_eq!(head.browser.value(nameless), serde_json::json!([]));
    let text =
        "[...document.querySelectorAll('header, #banners, main, aside')].map((part) => part.textContent).join(' ')";
    for page in ["links", "live", "start", "servos", "wearer", "health", "recordings", "links"] {
        head.browser.turn_to(page);
        if page == "health" {
            head.browser.click("Check now");
            head.browser.wait_until("document.querySelectorAll('.check-lines li').length > 2");
        }
        let shown = head.browser.value(text).as_str().unwrap().to_owned();
        let found: Vec<_> = ["`", "sudo ", "systemctl"].into_iter().filter(|word| shown.contains(word)).collect();
        assert!(found.is_empty(), "{page} shows {found:?}: {shown}");
    }
    // A link by UDP does not claim that anybody receives.
    head.browser.wait_for_text("Nobody listens on port 9 of 127.0.0.1");
}

#[test]
fn the_ready_made_servos_of_a_head_are_settings_that_the_service_takes() {
    let Some(mut head) = Head::start(PHONE) else { return };
    head.add_link("maestro");
    head.browser.turn_to("servos");
    head.click("Whole head");
    head.click("Lower lids");
    head.keep();
    assert_eq!(head.saved().matches("[[link.channel]]").count(), 10);
    head.browser.wait_for_text("Waits for a Pololu Maestro");
    head.look("a whole head");
}

#[test]
fn a_service_that_nobody_reaches_is_told_as_such_in_its_log_and_on_the_page() {
    let Some(mut head) = Head::start(PHONE) else { return };
    let config = head.folder.path().join("facewire.toml");
    head.service.kill().unwrap();
    head.service.wait().unwrap();
    let log = head.folder.path().join("log");
    let mut service = Command::new(&head.program);
    service.args(["run", "--config"]).arg(&config).env_remove("RUNTIME_DIRECTORY").env("XDG_RUNTIME_DIR", "");
    service.env("FACEWIRE_SYSROOT", "/nonexistent").stdin(Stdio::null()).stdout(Stdio::null());
    head.service = service.stderr(fs::File::create(&log).unwrap()).spawn().unwrap();
    let told = format!("The service runs as process {}, but this console does not reach it", head.service.id());
    head.browser.wait_for_text(&told);
    head.browser.screenshot("a service that nobody reaches");
    let log = fs::read_to_string(log).unwrap();
    assert!(log.contains("WARN") && log.contains("no control socket") && log.contains("set XDG_RUNTIME_DIR"), "{log}");
}

#[test]
fn channels_of_dmx_are_added_moved_and_kept_by_clicks_and_none_overlap() {
    let Some(mut head) = Head::start(DESK) else { return };
    let node = UdpSocket::bind("127.0.0.1:0").unwrap();
    node.set_nonblocking(true).unwrap();
    let address = node.local_addr().unwrap().to_string();
    // The first three values of the newest datagrams.
    let has = |wanted: [u8; 3]| {
        let mut bytes = [0; 18 + 512];
        std::iter::from_fn(|| node.recv(&mut bytes).ok().map(|_| bytes[18..21] == wanted)).last() == Some(true)
    };
    head.add_link("artnet");
    head.set("address", &address);
    head.look("a link by Art-Net");
    head.keep();
    let link = format!("\n[[link]]\nkind = \"artnet\"\naddress = \"{address}\"\n");
    assert_eq!(head.saved(), link);
    head.browser.turn_to("servos");
    head.browser.wait_for_text("it sends the whole face");
    head.click("Add a channel");
    head.browser.click("Ends, speed and more");
    head.follow("Channel 1", "jawOpen");
    head.choose("Channel 1", "Value in the universe", "16-bit");
    head.click("Add a channel");
    head.follow("Channel 3", "headYaw");
    head.keep();
    let ends = "pulse_at_0_us = 1450\npulse_at_1_us = 1550\n";
    let jaw = format!(
        "\n[[link.channel]]\nchannel = 1\n{ends}sources = {{ jawOpen = 1 }}\nspeed_per_s = 0.5\ndmx = \"16-bit\"\n"
    );
    let neck = format!(
        "\n[[link.channel]]\nchannel = 3\n{ends}sources = {{ headYaw = 0.0125 }}\nspeed_per_s = 0.5\noffset = 0.5\n"
    );
    assert_eq!(head.saved(), [&*link, &*jaw, &*neck].concat());
    head.browser.wait_for_text("All servos are released");
    head.browser.click("Let servos move again");
    eventually("the neutral face", || has([0x73, 0x33, 128]));
    head.drive("channel 1", 0.25, "", "Set end 1 here", || has([0x79, 0x9a, 128]));
    head.look("DMX");
    head.keep();
    let narrow = jaw.replace("pulse_at_1_us = 1550", "pulse_at_1_us = 1475");
    assert_eq!(head.saved(), [&*link, &*narrow, &*neck].concat());
    assert_eq!(head.browser.errors(), Vec::<Value>::new());
}

#[test]
fn a_slider_moves_the_board_of_its_card_although_the_draft_has_removed_the_board_before_it() {
    let nodes = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    nodes.iter().for_each(|node| node.set_nonblocking(true).unwrap());
    let addresses = nodes.each_ref().map(|node| node.local_addr().unwrap().to_string());
    let board = |address: &String| {
        format!(
            "\n[[link]]\nkind = \"artnet\"\naddress = \"{address}\"\n\n[[link.channel]]\nchannel = 1\nsources = {{ jawOpen = 1 }}\n"
        )
    };
    let Some(mut head) = Head::with(DESK, &[SETTINGS, &addresses.each_ref().map(board).concat()].concat()) else {
        return;
    };
    // The values that have come since the last look.
    let values = |node: &UdpSocket| {
        let mut bytes = [0; 18 + 512];
        std::iter::from_fn(|| node.recv(&mut bytes).ok().map(|_| bytes[18])).collect::<Vec<_>>()
    };
    head.browser.click("Link 2: DMX by Art-Net");
    head.click("Remove this link");
    head.add_link_after(2, "artnet");
    head.browser.turn_to("servos");
    head.browser.wait_for_text("This board is new or changed");
    let names = "[...document.querySelectorAll('.board')].map((board) => board.ariaLabel).join()";
    let names = head.browser.value(names).as_str().unwrap().to_owned();
    assert!(names.contains(&addresses[1]) && !names.contains(&addresses[0]), "{names}");
    head.look("a board that was removed and one that is new");
    head.drive("channel 1", 1.0, "", "Disarm", || values(&nodes[1]).last() == Some(&255));
    let of_first = values(&nodes[0]);
    assert!(
        !of_first.is_empty() && of_first.iter().all(|value| *value == 1),
        "the jaw of the other board: {of_first:?}"
    );
}

#[test]
fn boards_are_added_removed_moved_and_stopped_by_thumb_and_by_mouse_and_stop_is_there_again_after_the_next_login() {
    let Some(address) = elsewhere() else { return skip("this machine has no address besides loopback") };
    for (size, device) in [(PHONE, "phone"), (DESK, "desk")] {
        let maestro = Maestro::plugged_in(Model::MINI_24);
        let node = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
        let Some(mut head) = Head::start(size) else { return };
        head.open(address);
        head.enter("Set the password");
        head.add_link("artnet");
        head.set("address", &node);
        head.add_link_after(2, "maestro");
        head.put(&element("[id='field-link.2.device']"), maestro.device.to_str().unwrap());
        head.browser.screenshot(&format!("two boards on a {device}"));
        head.browser.turn_to("servos");
        let buttons = "document.querySelector(\".board[aria-label^='maestro']\")?.querySelectorAll('button')";
        head.browser.click_on(&format!("[...{buttons} ?? []].at(-1)"));
        head.follow("Channel 0", "jawOpen");
        head.keep();
        head.browser.wait_for_text("All servos are released");
        head.browser.turn_to("links");
        head.browser.click("Link 2: DMX by Art-Net");
        head.click("Remove this link");
        head.keep();
        assert!(head.saved().contains("\"maestro\"") && !head.saved().contains("artnet"), "{}", head.saved());
        head.let_move();
        head.browser.turn_to("servos");
        head.drive("channel 0", 1.0, "", "STOP", || maestro.pulse_us(0) == Some(1550.0));
        eventually("the end of pulses", || maestro.pulse_us(0).is_none());
        head.browser.wait_for_text(&format!("maestro {}: no pulses", maestro.device.display()));
        head.browser.screenshot(&format!("stopped on a {device}"));
        head.browser.turn_to("links");
        head.browser.click("Log out");
        let loud =
            "STOP does not work here: this page is logged out. To stop servos, log in, or switch their supply off.";
        head.browser.wait_for_text(loud);
        let is_seen = "(({ x, y }, alert) => alert.contains(document.elementFromPoint(x + 5, y + 5)))";
        let alert = element("#stop-alerts p");
        head.browser.wait_until(&format!("{is_seen}({alert}.getBoundingClientRect(), {alert})"));
        head.browser.screenshot(&format!("signed out on a {device}"));
        head.enter("Log in");
        head.browser.wait_until("!document.body.innerText.includes('STOP does not work')");
        head.let_move();
        eventually("pulses", || maestro.pulse_us(0).is_some());
        if size == PHONE {
            head.browser.click("STOP");
        } else {
            head.browser.press("Escape");
        }
        eventually("the end of pulses", || maestro.pulse_us(0).is_none());
        head.browser.wait_for_text("All servos are released");
        head.browser.screenshot(&format!("stopped again on a {device}"));
        assert_eq!(head.browser.events("Runtime.exceptionThrown"), Vec::<Value>::new());
    }
}

/// What goes on while an operator presses STOP on the page.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    BoardHangs,
    PortPulled,
    BrokenSettings,
    NoRoomOnDisk,
}

#[test]
fn stop_on_the_page_says_no_pulses_only_of_boards_that_answer_and_what_the_disk_does_not_keep_whatever_goes_wrong() {
    for trouble in [Trouble::BoardHangs, Trouble::PortPulled, Trouble::BrokenSettings, Trouble::NoRoomOnDisk] {
        let takes_commands = trouble != Trouble::BoardHangs;
        let good = Maestro::plugged_in(Model::MINI_24);
        let mut other = Some(Maestro::plugged_in(Model { takes_commands, ..Model::MINI_24 }));
        let devices = [&good.device, &other.as_ref().unwrap().device].map(|device| device.display().to_string());
        let link = |device: &String| {
            format!(
                "\n[[link]]\nkind = \"maestro\"\ndevice = \"{device}\"\n[[link.channel]]\nsources = {{ jawOpen = 1 }}\n"
            )
        };
        let Some(mut head) = Head::with(PHONE, &[SETTINGS, &devices.each_ref().map(link).concat()].concat()) else {
            return;
        };
        eventually("pulses", || good.pulse_us(0).is_some());
        head.browser.turn_to("health");
        match trouble {
            Trouble::BoardHangs => {}
            Trouble::PortPulled => drop(other.take()),
            Trouble::BrokenSettings => {
                fs::write(head.folder.path().join("facewire.toml"), "[link").unwrap();
                kill_process(Pid::from_child(&head.service), Signal::HUP).unwrap();
                head.browser.wait_for_text("goes on with the former ones");
            }
            Trouble::NoRoomOnDisk => {
                let kept = head.folder.path().join("kept");
                eventually("the kept settings", || fs::read_dir(&kept).is_ok_and(|mut files| files.next().is_some()));
                fs::remove_dir_all(&kept).unwrap();
                fs::write(kept, "").unwrap();
            }
        }
        let is_named = matches!(trouble, Trouble::BoardHangs | Trouble::PortPulled);
        let [of_good, of_other] = devices.each_ref().map(|device| format!("maestro {device}: no pulses"));
        let missed = format!("maestro {}: not reached: switch its supply off", devices[1]);
        let not_kept = "After a restart the service will not know whether servos are released";
        // A busy machine may delay one answer of the console or of a board or another, but not all.
        eventually(&format!("{trouble:?}: a right answer within 300 ms"), || {
            if head.browser.value("document.querySelector('.released') !== null") == true {
                head.let_move();
                eventually("pulses again", || good.pulse_us(0).is_some());
            }
            let answers = head.browser.answers("servos/release");
            head.browser.click("STOP");
            head.browser.await_answers("servos/release", answers + 1);
            let is_in_time = head.browser.waited("servos/release").unwrap() < Duration::from_millis(300);
            for text in [&of_good, if is_named { &missed } else { &of_other }] {
                head.browser.wait_for_text(text);
            }
            assert_eq!(good.pulse_us(0), None, "{trouble:?}: the page says that there are no pulses");
            if trouble == Trouble::NoRoomOnDisk {
                head.browser.wait_for_text(not_kept);
            }
            if is_named {
                head.browser.wait_for_text("Some servos were not released");
            }
            let page = head.browser.value("document.body.innerText").to_string();
            assert!(!is_named || !page.contains(&of_other), "{trouble:?}: {page}");
            let told = [not_kept, "servos were not released"].map(|text| page.contains(text));
            let alert = head.browser.value("document.getElementById('stop-alerts').innerText").to_string();
            let named = devices.each_ref().map(|device| alert.contains(&format!("maestro {device} (")));
            let is_right = told == [trouble == Trouble::NoRoomOnDisk, is_named] && named == [false, is_named];
            is_right && is_in_time
        });
        head.look(&format!("STOP, {trouble:?}"));
    }
}
