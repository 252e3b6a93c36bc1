//! A service that speaks the contract of the control socket, and a console for it.

use std::{
    collections::HashMap,
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{IpAddr, Shutdown, SocketAddr, TcpStream},
    os::unix::{
        fs::PermissionsExt as _,
        net::{UnixListener, UnixStream},
    },
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_packet::Packet;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::{PATIENCE, Viewer, command, packet};

/// How often a request is made that a busy machine may delay for too long.
const TRIES: usize = 3;

/// A stand-in for the program `facewire`: it finds a fault in settings with the word `bad`, and judges no settings while there is
/// a file named `judging` beside it.
const PROGRAM: &str = r#"#!/bin/sh
case "$1 $2" in
"check --settings-only")
    while [ -e "${0%/*}/judging" ]; do sleep 0.02; done
    case $(cat "$4") in
    *bad*) echo 'facewire: /dev/stdin:2: camera.fps = "bad": give a whole number from 1 to 240 (1/s)' >&2; exit 78 ;;
    esac
    echo 'settings  ok' ;;
"check --config") printf 'settings  ok\ncamera    POOR: too dark\n'; echo 'facewire: no network; end the other program (the service: `sudo systemctl stop facewire`)' >&2; exit 69 ;;
"defaults --schema") echo '{"type":"object","properties":{"camera":{"type":"object","properties":{
    "device":{"order":0,"type":"string","default":"auto","description":"The camera: `facewire devices` lists them (`systemctl enable --now facewire-camera`)."},
    "fps":{"order":1,"type":"integer","minimum":1,"maximum":240,"unit":"1/s","default":30,"description":"Frame rate."},
    "format":{"order":2,"type":"string","enum":["auto","yuyv","mjpeg"],"default":"auto"}}},
    "adjust":{"type":"object","properties":{"mirror":{"type":"boolean","default":false}}},
    "link":{"type":"array","items":{"oneOf":[{"properties":{"kind":{"const":"udp"},"address":{"type":"string"}}},
    {"properties":{"kind":{"const":"maestro"},"device":{"type":"string","default":"auto"}}}]}}}}' ;;
"devices --json") echo '{"cameras":[{"path":"/dev/video0","stable_paths":[],"name":"Webcam","modes":["mjpeg 640x480"]}],
    "not_examined":[],"serial_ports":[{"path":"/dev/ttyACM0","stable_paths":["/dev/serial/by-id/usb-Pololu-if00"],
    "name":"USB","kind":"maestro","usb":null}],"i2c_buses":[1]}' ;;
"record "*)
    trap 'exit 0' INT
    printf 'frames' >"$2"
    # The console that began this may have been killed.
    while [ -e "$0" ]; do sleep 0.02; done ;;
"track "*)
    echo 'frame,time_s,state,jawOpen,head_yaw_deg'
    for row in 0 1 2 3 4; do echo "$row,$row,live,0.$row,1"; done ;;
"--version ") echo 'facewire 0.1.0' ;;
esac
"#;

/// What the service was asked, and when it got lines of drives.
#[derive(Debug, Default)]
pub struct Seen {
    pub requests: Vec<Value>,
    pub lines: Vec<(Instant, Value)>,
    /// When each drive has ended.
    pub ended: Vec<Instant>,
    /// The request that is refused, and why.
    pub refusal: Option<(&'static str, &'static str)>,
    /// Whether requests for landmarks get no answer.
    pub is_stuck: bool,
    /// What the servo at channel 3 tells of itself besides.
    pub health: Value,
    /// The links besides the servo board.
    pub more_links: Vec<Value>,
    /// The connection of the client that drives, and how many lines had come before it.
    driver: Option<(UnixStream, usize)>,
}

/// A service in this process.
pub struct Service {
    pub socket: PathBuf,
    pub seen: Arc<Mutex<Seen>>,
    /// What the links are offered.
    pub pose: Arc<Mutex<Packet>>,
}

impl Service {
    pub fn start(folder: &Path) -> Self {
        let socket = folder.join("control");
        let _ = fs::remove_file(&socket);
        let listener = UnixListener::bind(&socket).unwrap();
        let seen = Arc::<Mutex<Seen>>::default();
        let pose = Arc::new(Mutex::new(packet(&[("jawOpen", 0.5)])));
        let shared = (Arc::clone(&seen), Arc::clone(&pose));
        thread::spawn(move || {
            for stream in listener.incoming() {
                let (seen, pose) = shared.clone();
                thread::spawn(move || serve(stream.unwrap(), &seen, &pose));
            }
        });
        Self { socket, seen, pose }
    }

    /// The requests that change something.
    pub fn changes(&self) -> Vec<Value> {
        let seen = self.seen.lock().unwrap();
        let reads = ["status", "watch", "list", "picture", "landmarks"];
        seen.requests.iter().filter(|request| !reads.iter().any(|read| request["do"] == *read)).cloned().collect()
    }

    /// Waits until something was seen.
    pub fn until(&self, fits: impl Fn(&Seen) -> bool) {
        let begun = Instant::now();
        while !fits(&self.seen.lock().unwrap()) {
            // A panic while the lock is held would poison it for the threads that serve.
            let is_over = begun.elapsed() >= PATIENCE;
            let seen = if is_over { format!("{:?}", self.seen.lock().unwrap()) } else { String::new() };
            assert!(!is_over, "{seen}");
            thread::sleep(Duration::from_millis(2));
        }
    }
}

/// A status with the metrics that pages show, and a servo board with the channels 0 and 3.
fn status(seen: &Seen) -> Value {
    let metrics = "# TYPE facewire_frames counter\nfacewire_frames_total{result=\"faces\"} 100\n\
                   facewire_stage_seconds_bucket{le=\"0.01\",stage=\"mesh\"} 50\n\
                   facewire_stage_seconds_bucket{le=\"+Inf\",stage=\"mesh\"} 100\n\
                   facewire_impaired{by=\"dark\"} 1\n# EOF\n";
    let of = |what: &'static str| seen.requests.iter().filter(move |request| request["do"] == what);
    // A service that is stuck releases nothing. One that has not reached a board has released all others.
    let is_stuck = seen.refusal.is_some_and(|(refused, why)| refused == "release" && !why.contains("not reached"));
    let is_released = !is_stuck && of("release").next_back().is_some_and(|request| request["on"] == true);
    let channel = |number: u32| {
        let last = seen.lines.iter().rev().find(|(_, line)| line["channel"] == number);
        let is_jogged = seen.driver.as_ref().is_some_and(|(_, before)| {
            let jogged = seen.lines[*before..].iter().rev().find(|(_, line)| *line != json!({}));
            jogged.is_some_and(|(_, line)| line["channel"] == number)
        });
        let position = last.map_or(json!(0.5), |(_, line)| line["position"].clone());
        let pulse_us =
            position.as_f64().filter(|_| !is_released || is_jogged).map(|position| 1100.0 + 800.0 * position);
        let mut status = json!({"number": number, "target": position, "position": position, "pulse_us": pulse_us});
        if let Some(health) = seen.health.as_object().filter(|_| number == 3) {
            status.as_object_mut().unwrap().extend(health.clone());
        }
        status
    };
    let is_off = is_released && [0, 3].map(channel).iter().all(|channel| channel["pulse_us"].is_null());
    let link = json!({"name": "maestro /dev/ttyACM0", "kind": "maestro", "open": true, "sent": 100, "dropped": 0,
        "trouble": null, "stop": "no pulses", "released": is_off, "channels": [channel(0), channel(3)]});
    let is_driven = seen.driver.is_some();
    let links: Vec<&Value> = [&link].into_iter().chain(&seen.more_links).collect();
    json!({"status": {"version": "0.1.0", "metrics": metrics, "wearer": "anna", "released": is_released, "driven": is_driven,
        "settings_refused": seen.refusal.filter(|(refused, _)| *refused == "reload").map(|(_, why)| why), "links": links}})
}

fn serve(mut stream: UnixStream, seen: &Mutex<Seen>, pose: &Mutex<Packet>) -> Option<()> {
    let mut lines = BufReader::new(stream.try_clone().ok()?).lines();
    let request: Value = serde_json::from_str(&lines.next()?.ok()?).unwrap();
    seen.lock().unwrap().requests.push(request.clone());
    let mut say = |value: Value| writeln!(stream, "{value}").ok();
    let refusal = seen.lock().unwrap().refusal;
    if let Some((_, why)) = refusal.filter(|(refused, _)| request["do"] == *refused) {
        return say(json!({"refused": why}));
    }
    match request["do"].as_str()? {
        "status" => {
            let status = status(&seen.lock().unwrap());
            say(status)
        }
        "watch" => loop {
            let bytes = BASE64_STANDARD.encode(pose.lock().unwrap().encode());
            say(json!({"packet": bytes}))?;
            thread::sleep(Duration::from_millis(16));
        },
        "list" => say(
            json!({"wearers": {"wearers": [{"wearer": "anna", "profile": {"Ok": [1_700_000_000, 11]}}], "in_use": "anna", "folder": "/x"}}),
        ),
        "delete" => say(json!({"refused": "there is no profile of this wearer"})),
        "calibrate" => {
            say(
                json!({"progress": {"take": "smile", "done": 5, "of": 11, "phase": "wait", "measured": 0.4, "seen": 0.7,
                "waits_for": "head-turned", "refused": 2, "last_refusal": "too-short"}}),
            )?;
            // The calibration of this wearer goes on until the client cancels it.
            if request["wearer"] == "carla" {
                lines.next();
                return None;
            }
            say(
                json!({"calibrated": {"wearer": request["wearer"], "path": "/x/anna.profile", "taken": ["neutral", "smile"],
                "left_out": [["pucker", "not-seen"]], "refused": 2, "warning": null}}),
            )
        }
        "picture" => {
            say(
                json!({"picture": {"format": "yuyv", "width": 1280, "height": 720, "bytes": 1280 * 720 * 2, "time_us": 5, "landmarks": null}}),
            )?;
            stream.write_all(&[128; 1280 * 720 * 2]).ok()
        }
        "landmarks" => {
            while seen.lock().unwrap().is_stuck {
                thread::sleep(Duration::from_millis(5));
            }
            let places: Vec<[f32; 2]> = (0..478_u16).map(|k| [f32::from(k), 100.0]).collect();
            say(
                json!({"picture": {"format": "grey", "width": 640, "height": 480, "bytes": 0, "time_us": 5, "landmarks": places}}),
            )
        }
        "drive" => {
            say(json!({"driving": true}))?;
            let driver = stream.try_clone().ok()?;
            {
                let mut seen = seen.lock().unwrap();
                seen.driver = Some((driver, seen.lines.len()));
            }
            for line in lines.map_while(Result::ok) {
                let line = serde_json::from_str(&line).unwrap();
                seen.lock().unwrap().lines.push((Instant::now(), line));
            }
            let mut seen = seen.lock().unwrap();
            seen.driver = None;
            seen.ended.push(Instant::now());
            None
        }
        "release" if request["on"] == true => {
            // Whoever releases servos has the last word.
            if let Some((driver, _)) = &seen.lock().unwrap().driver {
                let _ = driver.shutdown(Shutdown::Both);
            }
            say(json!({"done": "it is done"}))
        }
        _ => say(json!({"done": "it is done"})),
    }
}

/// A console, its service, and its folder with the settings.
pub struct Console {
    pub viewer: Viewer,
    pub service: Arc<Service>,
    pub folder: Arc<TempDir>,
}

/// The answer to a request.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: HashMap<String, String>,
    /// The names and values of the cookies that it sets.
    pub cookies: Vec<String>,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}", self.text()))
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// The cookie of the session that it sets, as a header of the next request.
    pub fn cookie(&self) -> String {
        let cookie = self.cookies.iter().find(|cookie| cookie.starts_with("facewire-console="));
        format!("Cookie: {}\r\n", cookie.unwrap_or_else(|| panic!("it sets no cookie: {}", self.text())))
    }

    /// All cookies that it sets.
    pub fn all_cookies(&self) -> String {
        format!("Cookie: {}\r\n", self.cookies.join("; "))
    }
}

impl Console {
    /// Starts a console with these settings.
    pub fn start(settings: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let service = Service::start(folder.path());
        fs::write(folder.path().join("facewire.toml"), settings).unwrap();
        let program = folder.path().join("facewire");
        fs::write(&program, PROGRAM).unwrap();
        fs::set_permissions(program, fs::Permissions::from_mode(0o755)).unwrap();
        let viewer = Self::spawn(folder.path(), &[]);
        Self { viewer, service: Arc::new(service), folder: Arc::new(folder) }
    }

    /// Starts one more program for the same service and settings.
    pub fn again(&self) -> Self {
        self.again_with(&[])
    }

    /// As [`Self::again`], with more arguments.
    pub fn again_with(&self, more: &[&str]) -> Self {
        let viewer = Self::spawn(self.folder.path(), more);
        Self { viewer, service: Arc::clone(&self.service), folder: Arc::clone(&self.folder) }
    }

    fn spawn(folder: &Path, more: &[&str]) -> Viewer {
        let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
        let (config, control, state) = (path("facewire.toml"), path("control"), path("state"));
        let arguments = ["--listen", "0.0.0.0:0", "--config", &config, "--control", &control, "--state", &state];
        Viewer::spawn(command(&[&arguments, more].concat()).env("FACEWIRE_PROGRAM", path("facewire")))
    }

    pub fn settings(&self) -> String {
        fs::read_to_string(self.folder.path().join("facewire.toml")).unwrap()
    }

    /// The cookie that a browser on this machine gets, as a header.
    pub fn name(&self) -> String {
        self.get("session").cookie()
    }

    pub fn port(&self) -> u16 {
        self.viewer.host().rsplit_once(':').unwrap().1.parse().unwrap()
    }

    pub fn get(&self, path: &str) -> Answer {
        self.get_with(path, "")
    }

    pub fn get_with(&self, path: &str, headers: &str) -> Answer {
        self.ask([127, 0, 0, 1].into(), &format!("GET /api/1/{path}"), headers, "").unwrap()
    }

    pub fn post(&self, path: &str, body: &Value) -> Answer {
        self.post_with(path, "Content-Type: application/json\r\n", body)
    }

    pub fn post_with(&self, path: &str, headers: &str, body: &Value) -> Answer {
        self.ask([127, 0, 0, 1].into(), &format!("POST /api/1/{path}"), headers, &body.to_string()).unwrap()
    }

    /// Sends a request to this address of this machine, from which it then comes, and returns the answer if there is one.
    pub fn ask(&self, address: IpAddr, request: &str, headers: &str, body: &str) -> Option<Answer> {
        let address = SocketAddr::new(address, self.port());
        let length = body.len();
        let bytes = format!(
            "{request} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
        );
        send(address, bytes.as_bytes(), PATIENCE)
    }
}

/// Returns the first of three answers in which the console does not say that the service is late, or else the last. A busy
/// machine may delay this service for longer than a console waits for it.
pub fn in_time(ask: impl Fn() -> Answer) -> Answer {
    let mut answer = ask();
    for _ in 1..TRIES {
        if answer.status == 504 {
            answer = ask();
        }
    }
    answer
}

/// Sends these bytes and returns the answer if there is one.
pub fn send(address: SocketAddr, bytes: &[u8], patience: Duration) -> Option<Answer> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(patience)).unwrap();
    // The program may refuse before it has read everything.
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let end = answer.windows(4).position(|part| part == b"\r\n\r\n")?;
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let mut lines = head.lines();
    let status = lines.next()?.split(' ').nth(1)?.parse().unwrap();
    let headers = lines.filter_map(|line| line.split_once(": "));
    let headers: Vec<_> = headers.map(|(name, value)| (name.to_lowercase(), value.to_owned())).collect();
    let cookies = headers.iter().filter(|(name, _)| name == "set-cookie");
    let cookies = cookies.map(|(_, cookie)| cookie.split(';').next().unwrap().to_owned()).collect();
    Some(Answer { status, headers: headers.into_iter().collect(), cookies, body: answer.split_off(end + 4) })
}

/// An address of this machine that is not loopback, so that requests to it come from elsewhere.
pub fn elsewhere() -> Option<IpAddr> {
    let interfaces = nix::ifaddrs::getifaddrs().unwrap();
    let addresses = interfaces.filter_map(|interface| Some(IpAddr::V4(interface.address?.as_sockaddr_in()?.ip())));
    addresses.into_iter().find(|address| !address.is_loopback())
}
