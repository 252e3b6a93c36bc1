//! The whole HTTP interface under requests that nobody sends in good faith, with rights and without.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    fs,
    io::{Read as _, Write as _},
    net::{IpAddr, SocketAddr, TcpStream},
    thread,
    time::Duration,
};

use common::{
    memory_kb,
    service::{Console, elsewhere, in_time},
    skip,
};
use serde_json::{Value, json};

const SETTINGS: &str = "# The head in the hall.\n[camera]\nfps = 30 # enough\n\n[[link]]\nkind = \"udp\"\n";
const JSON: &str = "Content-Type: application/json\r\n";
const THREADS: u64 = 8;
/// How long an answer is waited for. Some requests make the program wait for the rest of them.
const PATIENCE: Duration = Duration::from_millis(50);
const MOST_KB: u64 = 64_000;

const GETS: [&str; 21] = [
    "",
    "app.js",
    "api/1/",
    "api/2/status",
    "api/1/nothing",
    "api/1/session",
    "api/1/events",
    "api/1/status",
    "api/1/settings",
    "api/1/settings?version=1",
    "api/1/wearers",
    "api/1/recordings",
    "api/1/recordings/1.fwrec",
    "api/1/recordings/../access.json",
    "api/1/recordings/%2e%2e%2faccess.json",
    "api/1/history",
    "api/1/devices",
    "api/1/picture",
    "api/1/landmarks",
    "api/1/log",
    "api/1/report",
];
/// The paths of changes, and the keys of their bodies.
const POSTS: [(&str, &[&str]); 22] = [
    ("api/1/login", &["password"]),
    ("api/1/login", &["token"]),
    ("api/1/logout", &[]),
    ("api/1/password", &["new", "old"]),
    ("api/1/tokens/look", &[]),
    ("api/1/settings/check", &["text"]),
    ("api/1/settings/edit", &["text", "changes"]),
    ("api/1/settings/edit", &["text", "changes"]),
    ("api/1/settings/keep", &["text", "base"]),
    ("api/1/settings/restore", &["id"]),
    ("api/1/settings/reload", &[]),
    ("api/1/wearers/use", &["name"]),
    ("api/1/wearers/delete", &["name"]),
    ("api/1/calibration/begin", &["wearer"]),
    ("api/1/servos/release", &["on"]),
    ("api/1/servos/arm", &[]),
    ("api/1/servos/drive", &["drive", "link", "channel", "position"]),
    ("api/1/servos/drive", &["drive", "coefficients", "head_deg"]),
    ("api/1/servos/disarm", &["drive"]),
    ("api/1/recordings/begin", &[]),
    ("api/1/recordings/play", &["name"]),
    ("api/1/service", &["do"]),
];

/// A source of hostile requests to a console at this address.
struct Attacker {
    random: fastrand::Rng,
    host: SocketAddr,
    /// The headers that give rights.
    rights: String,
}

impl Attacker {
    fn one_of<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[self.random.usize(..choices.len())]
    }

    /// A count that is small, at a limit, or far beyond it.
    fn count(&mut self) -> usize {
        [1, 2, 16, 17, 128, 1000, 30_000, 30_000, 30_000][self.random.usize(..9)]
    }

    fn text(&mut self) -> String {
        let count = self.count();
        match self.random.u8(..8) {
            0 => SETTINGS.to_owned(),
            1 => "a.".repeat(count) + "a = 1",
            2 => format!("a = {}1{}", "[".repeat(count), "]".repeat(count)),
            3 => format!("[{}]", vec!["a"; count].join(".")),
            4 => "\u{0}\u{1b}[2J\u{202e}\u{10ffff}".repeat(count),
            5 => "../".repeat(count) + "access.json",
            6 => "x".repeat(8 * count),
            _ => self
                .one_of(&["", "1", "0", "null", "a good guess", "-1", "9999999999999999999999", "1.fwrec"])
                .to_owned(),
        }
    }

    fn value(&mut self) -> Value {
        let count = self.count().min(1000);
        match self.random.u8(..8) {
            0 => Value::Null,
            1 => json!(self.random.bool()),
            2 => [0.0, -0.0, 1e308, 5e-324, -1.0][self.random.usize(..5)].into(),
            3 => [u64::MAX, 0, 1][self.random.usize(..3)].into(),
            4 => (0..count.min(100)).fold(json!(1), |value, _| json!([value])),
            5 => (0..count.min(100)).fold(json!(1), |value, _| json!({"a": value})),
            6 => json!(vec![0; count]),
            _ => json!(self.text()),
        }
    }

    /// A body with these keys, or with anything.
    fn body(&mut self, keys: &[&str]) -> String {
        if self.random.u8(..8) == 0 {
            return ["[".repeat(8 * self.count()), self.text(), "{}".to_owned()][self.random.usize(..3)].clone();
        }
        let fields = keys.iter().map(|key| ((*key).to_owned(), self.field(key)));
        Value::from(serde_json::Map::from_iter(fields)).to_string()
    }

    fn field(&mut self, key: &str) -> Value {
        match (key, self.random.bool()) {
            ("text", true) => SETTINGS.into(),
            ("changes", true) => serde_json::Map::from_iter([(self.text(), self.value())]).into(),
            ("changes", false) => serde_json::Map::from_iter([("camera.fps".to_owned(), self.value())]).into(),
            ("on", true) => true.into(),
            (_, true) => self.text().into(),
            (_, false) => self.value(),
        }
    }

    fn headers(&mut self, length: usize) -> String {
        let host = self.host.to_string();
        let mut headers = format!("Host: {}\r\n", self.one_of(&[&host, &host, &host, "localhost", "evil.example", ""]));
        for _ in 0..self.random.u8(..3) {
            let junk = "x".repeat(self.count());
            headers += &match self.random.u8(..9) {
                0 => format!("Cookie: facewire-console={junk}\r\n"),
                1 => format!("Origin: http://{host}\r\nSec-Fetch-Site: same-origin\r\n"),
                2 => "Origin: http://evil.example\r\n".to_owned(),
                3 => "X-Forwarded-For: 127.0.0.1\r\nX-Forwarded-Proto: https\r\n".to_owned(),
                4 => "Expect: 100-continue\r\n".to_owned(),
                5 => "Upgrade: websocket\r\nConnection: upgrade\r\n".to_owned(),
                6 => format!("X-{junk}: {junk}\r\n"),
                7 => format!("Range: bytes={junk}\r\n"),
                _ => "Transfer-Encoding: chunked\r\n".to_owned(),
            };
        }
        if self.random.u8(..8) > 0 {
            headers += JSON;
        }
        match self.random.u8(..16) {
            0 => headers += "Content-Length: 99999999999999999999\r\n",
            1 => headers += &format!("Content-Length: {}\r\n", length.saturating_sub(1)),
            2 => headers += "Content-Length: 1\r\nContent-Length: 2\r\n",
            _ => headers += &format!("Content-Length: {length}\r\n"),
        }
        headers + &self.rights
    }

    fn request(&mut self) -> Vec<u8> {
        let (path, keys) = POSTS[self.random.usize(..POSTS.len())];
        let (method, path) = match self.random.u8(..16) {
            0 => (self.one_of(&["PUT", "OPTIONS", "get", "POST"]), self.one_of(&GETS)),
            1..5 => (self.one_of(&["GET", "HEAD"]), self.one_of(&GETS)),
            _ => ("POST", path),
        };
        let body = self.body(keys);
        let headers = self.headers(body.len());
        let mut bytes = format!("{method} /{path} HTTP/1.1\r\n{headers}\r\n{body}").into_bytes();
        if self.random.u8(..4) == 0 {
            for _ in 0..self.random.u8(1..8) {
                let at = self.random.usize(0..bytes.len());
                match self.random.u8(..4) {
                    0 => bytes[at] = self.random.u8(..),
                    1 => bytes[at] ^= 1 << self.random.u8(..8),
                    2 => bytes.truncate(at.max(1)),
                    _ => bytes.insert(at, self.random.u8(..)),
                }
            }
        }
        bytes
    }

    /// Sends a request, and waits for the beginning of an answer.
    fn attack(&mut self) {
        let Ok(mut stream) = TcpStream::connect(self.host) else { return };
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // The program may refuse before it has read everything.
        let _ = stream.write_all(&self.request());
        let _ = stream.read(&mut [0; 4096]);
    }
}

/// Sends so many hostile requests.
fn attack(console: &Console, address: IpAddr, rights: &str, count: u64) {
    let host = SocketAddr::new(address, console.port());
    thread::scope(|scope| {
        for seed in 0..THREADS {
            let mut attacker = Attacker { random: fastrand::Rng::with_seed(seed), host, rights: rights.to_owned() };
            scope.spawn(move || (0..count / THREADS).for_each(|_| attacker.attack()));
        }
    });
    let peak_kb = memory_kb(console.viewer.pid(), "VmHWM");
    println!("peak memory {:.1} MB", peak_kb as f64 / 1e3);
    assert!(peak_kb < MOST_KB, "{peak_kb} KB");
}

/// Attacks what an operator has, with the rights of a link to look or without any, and checks that it is still there.
fn attack_what_an_operator_has(may_look: bool) {
    let Some(address) = elsewhere() else { return skip("this machine has no address but loopback") };
    let console = Console::start(SETTINGS);
    let recordings = console.folder.path().join("state/recordings");
    fs::create_dir_all(&recordings).unwrap();
    fs::write(recordings.join("1.fwrec"), "frames").unwrap();
    console.post("password", &json!({"new": "a good password"}));
    let token = console.post("tokens/look", &json!({})).json()["token"].clone();
    let ask = |request: &str, headers: &str, body: Value| {
        console.ask(address, request, &format!("{JSON}{headers}"), &body.to_string()).unwrap()
    };
    let operator = ask("POST /api/1/login", "", json!({"password": "a good password"}));
    let looker = ask("POST /api/1/login", "", json!({"token": token})).cookie();
    attack(&console, address, if may_look { &looker } else { "" }, 10_000);
    assert_eq!((console.service.changes(), console.settings().as_str()), (Vec::new(), SETTINGS));
    let settings = console.get("settings").json();
    assert_eq!((&settings["versions"], &settings["faults"]), (&json!([]), &json!([])));
    assert_eq!(console.get("recordings").json()["list"].as_array().unwrap().len(), 1);
    assert_eq!(ask("POST /api/1/login", "", json!({"token": token})).status, 200);
    assert_eq!(ask("GET /api/1/session", &operator.cookie(), json!({})).json()["role"], "operate");
    // Wrong guesses make the browser of the operator wait for nothing.
    let again = ask("POST /api/1/login", &operator.all_cookies(), json!({"password": "a good password"}));
    assert_eq!(again.status, 200, "{again:?}");
    let stop = in_time(|| ask("POST /api/1/servos/release", &operator.cookie(), json!({"on": true})));
    assert_eq!(stop.status, 200);
}

#[test]
fn ten_thousand_hostile_requests_without_rights_change_nothing() {
    attack_what_an_operator_has(false);
}

#[test]
fn ten_thousand_hostile_requests_with_a_link_to_look_change_nothing() {
    attack_what_an_operator_has(true);
}

#[test]
fn hostile_requests_of_an_operator_end_neither_the_program_nor_stop() {
    let console = Console::start(SETTINGS);
    let me = console.name();
    attack(&console, [127, 0, 0, 1].into(), &me, 4_000);
    let stop = in_time(|| console.post_with("servos/release", &format!("{JSON}{me}"), &json!({"on": true})));
    assert_eq!(stop.status, 200);
    assert_eq!(console.get("session").json()["role"], "operate");
}
