//! Heads are set up by clicks, with the real service: bus servos, which are simulated, and a universe of DMX.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

#[path = "../../servo/program/bus.rs"]
mod bus;
mod common;

use std::{
    env, fs,
    net::UdpSocket,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::Instant,
};

use bus::Bus;
use common::{
    PATIENCE, Viewer,
    browser::{Browser, control, element, labelled, or_arm},
    command, eventually, skip,
};
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
    _console: Viewer,
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
            .env("STATE_DIRECTORY", path("kept"));
        service.env("FACEWIRE_SYSROOT", "/nonexistent").stdin(Stdio::null()).stdout(Stdio::null());
        let service = service.stderr(fs::File::create(path("log")).unwrap()).spawn().unwrap();
        let (control, state) = (path("control"), path("state"));
        let arguments = ["--listen", "127.0.0.1:0", "--config", &config, "--control", &control, "--state", &state];
        let console = Viewer::spawn(command(&arguments).env("FACEWIRE_PROGRAM", &program));
        let mut browser = Browser::start(size.0, size.1);
        browser.open(&format!("http://{}/#links", console.host()));
        browser.wait_until("document.getElementById('stop')?.disabled === false");
        browser.wait_for_text("A new link");
        Some(Self { service, browser, size, program, folder, _console: console })
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
        self.browser.click(&format!("Link {}: {kind}", links + 1));
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

    /// Keeps the settings once they have no fault.
    fn keep(&mut self) {
        self.browser.wait_for_text("changed and not kept yet");
        self.browser.click("Keep");
        self.browser.wait_until("!document.getElementById('draft')");
    }

    /// Drags a slider to `position`, waits until the servo arrives and the page shows `text`, and then clicks `button`. Begins
    /// again if the page has disarmed, because a busy machine has delayed its heartbeat.
    fn drive(&mut self, name: &str, position: f64, text: &str, button: &str, mut has_arrived: impl FnMut() -> bool) {
        let begun = Instant::now();
        let slider = element(&format!("[aria-label='Move {name}']"));
        let is_armed = format!("!{slider}.disabled");
        let is_done = format!("document.body.innerText.includes({text:?}) && {} !== undefined", control(button));
        loop {
            self.browser.drive(&slider, position);
            while self.browser.value(&is_armed) == true {
                if has_arrived() && self.browser.value(&is_done) == true {
                    self.browser.click_on(&or_arm(button));
                    return self.browser.settle();
                }
                assert!(begun.elapsed() < PATIENCE, "{name} does not come to {position}");
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

#[test]
fn bus_servos_are_added_moved_and_kept_by_clicks_and_one_that_does_not_answer_is_told() {
    let Some(mut head) = Head::start(PHONE) else { return };
    let bus = Bus::plugged_in("feetech-sts", &[1]);
    let device = bus.device.to_str().unwrap();
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
    head.browser.wait_for_text("All servos are released");
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
    head.browser.click("Link 2: artnet");
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
