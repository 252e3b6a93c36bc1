//! The console of a service over HTTP, with a service that speaks the contract of the control socket.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    collections::VecDeque,
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{IpAddr, SocketAddr, TcpStream},
    os::{
        fd::OwnedFd,
        unix::{
            fs::PermissionsExt as _,
            net::{UnixListener, UnixStream},
        },
    },
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
    thread,
    time::Duration,
};

use common::{
    PATIENCE, eventually, memory_kb, packet,
    service::{Answer, Console, elsewhere, in_time, send},
    skip,
};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

const SETTINGS: &str = "# The head in the hall.\n[camera]\nfps = 30 # enough\n\n[[link]]\nkind = \"udp\"\n";
const JSON: &str = "Content-Type: application/json\r\n";

/// A console, and an address from which requests come from elsewhere; or `None` with a note if this machine has none.
fn from_elsewhere() -> Option<(Console, IpAddr)> {
    let address = elsewhere();
    if address.is_none() {
        skip("this machine has no address but loopback");
    }
    Some((Console::start(SETTINGS), address?))
}

fn hash_of(console: &Console) -> Value {
    console.get("settings").json()["hash"].clone()
}

#[test]
fn the_status_shows_the_service_with_its_metrics_as_numbers() {
    let console = Console::start(SETTINGS);
    let status = console.get("status").json();
    assert_eq!(
        (&status["running"], &status["trouble"], &status["refused"]),
        (&true.into(), &Value::Null, &Value::Null)
    );
    assert_eq!(status["service"]["metrics"]["facewire_frames_total{result=\"faces\"}"], 100.0);
    assert!(status["free_bytes"].as_u64() > Some(0) && status["board"]["load"].is_number(), "{status}");
    assert_eq!(console.get("wearers").json()["in_use"], "anna");
    assert_eq!(console.get("devices").json()["cameras"][0]["path"], "/dev/video0");
    assert_eq!(console.get("nothing").status, 404);
}

#[test]
fn without_the_service_the_console_says_so_and_mends_the_settings() {
    let console = Console::start("[camera]\nfps = \"bad\"\n");
    fs::remove_file(&console.service.socket).unwrap();
    let status = console.get("status").json();
    assert_eq!(status["running"], false);
    assert!(status["trouble"].as_str().unwrap().contains("the service does not run: start it"), "{status}");
    assert!(status["refused"].as_str().unwrap().starts_with("line 2: camera.fps = "), "{status}");
    let fault = &console.get("settings").json()["faults"][0];
    assert_eq!((&fault["line"], &fault["key"]), (&2.into(), &"camera.fps".into()));
    let kept = console.post("settings/keep", &json!({"text": "[camera]\nfps = 30\n", "base": hash_of(&console)}));
    assert!(kept.json()["done"].as_str().unwrap().contains("for the next start"), "{kept:?}");
    assert_eq!(console.get("status").json()["refused"], Value::Null);
    assert!(console.post("wearers/use", &json!({"name": "anna"})).text().contains("does not run"));
}

#[test]
fn the_stream_has_the_face_and_the_status_and_the_service_is_watched_only_while_it_is_open() {
    let console = Console::start(SETTINGS);
    console.get("status");
    assert!(console.service.seen.lock().unwrap().requests.iter().all(|request| request["do"] != "watch"));
    let mut events = console.viewer.events();
    assert_eq!(events.next()["hint"], Value::Null);
    let face = events.until(|event| event["packet"].is_object());
    assert_eq!(face["packet"]["from"], "the service");
    assert!((face["packet"]["coefficients"][17].as_f64().unwrap() - 0.5).abs() < 1e-3, "{face}");
    let status = events.until(|event| event["running"] == true);
    assert_eq!(status["operator"], Value::Null);
    // The calibration comes to all pages.
    console.post("calibration/begin", &json!({"wearer": "anna"}));
    events.until(|event| event["calibrated"].is_object());
}

#[test]
fn an_edit_keeps_comments_and_what_is_kept_is_whole_checked_versioned_and_restored() {
    let console = Console::start(SETTINGS);
    let settings = console.get("settings").json();
    assert_eq!((&settings["text"], &settings["values"]["camera"]["fps"]), (&SETTINGS.into(), &30.into()));
    assert_eq!(settings["schema"]["type"], "object");
    let edited = console.post("settings/edit", &json!({"text": SETTINGS, "changes": {"camera.fps": 60}})).json();
    let text = SETTINGS.replace("30", "60");
    assert_eq!(edited["text"], text);
    let checked = console.post("settings/check", &json!({"text": text})).json();
    assert_eq!((&checked["faults"], &checked["changed"]), (&json!([]), &json!(["camera.fps"])));
    let kept = console.post("settings/keep", &json!({"text": text, "base": settings["hash"]}));
    assert_eq!((kept.status, &kept.json()["done"]), (200, &"it is done".into()));
    assert_eq!(console.settings(), text);
    assert_eq!(console.service.changes(), [json!({"do": "reload"})]);
    // Somebody who has not seen this change does not undo it.
    let late = console.post("settings/keep", &json!({"text": SETTINGS, "base": settings["hash"]}));
    assert!(late.status == 409 && late.text().contains("Somebody else has changed"), "{late:?}");
    let bad = console.post("settings/keep", &json!({"text": text.replace("60", "\"bad\""), "base": hash_of(&console)}));
    assert!(bad.status == 422 && bad.json()["faults"][0]["line"] == 2, "{bad:?}");
    assert_eq!(console.settings(), text);
    let version = console.get("settings").json()["versions"][0].clone();
    assert_eq!(version["summary"], "camera.fps");
    let id = version["id"].as_str().unwrap();
    assert_eq!(console.get(&format!("settings?version={id}")).json()["text"], SETTINGS);
    assert_eq!(console.post("settings/restore", &json!({"id": id})).json()["text"], SETTINGS);
    assert_eq!(console.settings(), SETTINGS);
}

#[test]
fn five_hundred_random_edits_leave_a_file_that_loads_and_keep_its_comments() {
    let console = Console::start(SETTINGS);
    let mut random = fastrand::Rng::with_seed(24);
    let keys = [
        "camera.fps",
        "camera.device",
        "link.0.rate_hz",
        "link.1.kind",
        "adjust.mirror",
        "link.0",
        "wearer.name",
        "a.b.c",
    ];
    let (mut kept, mut refused) = (0, 0);
    for _ in 0..500 {
        let key = keys[random.usize(0..keys.len())];
        let value =
            [json!(7), json!("bad"), json!("x"), json!(null), json!(true), json!({"a": 1})][random.usize(0..6)].clone();
        let before = console.settings();
        let edited = console.post("settings/edit", &json!({"text": before, "changes": {key: value}}));
        if edited.status != 200 {
            assert!(edited.status == 400 && edited.text().starts_with(key), "{edited:?}");
            continue;
        }
        let text = edited.json()["text"].clone();
        let outcome = console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)}));
        let now = console.settings();
        if outcome.status == 200 {
            kept += 1;
            assert_eq!(now, text);
        } else {
            refused += 1;
            assert!(outcome.json()["error"].as_str().unwrap().contains("give a whole number"), "{outcome:?}");
            assert_eq!(now, before);
        }
        assert!(now.starts_with("# The head in the hall.\n") && !now.contains("bad"), "{now}");
    }
    assert!(kept > 100 && refused > 20, "{kept} kept, {refused} refused");
    assert_eq!(console.get("settings").json()["versions"].as_array().unwrap().len(), 10);
}

#[test]
fn a_kill_at_any_step_of_keeping_leaves_the_old_settings_or_the_new_ones() {
    let folder = Console::start(SETTINGS);
    let text = SETTINGS.replace("30", "60");
    let (mut kills, mut kept) = (0, 0);
    for call in ["openat", "write", "fsync", "fchmod", "rename", "unlink"] {
        let mut count = 1;
        loop {
            fs::write(folder.folder.path().join("facewire.toml"), SETTINGS).unwrap();
            let console = folder.again();
            let body = json!({"text": text, "base": hash_of(&console)});
            let fault = format!("{call}:signal=KILL:when={count}");
            let Some(mut tracer) = inject(console.viewer.pid(), call, &fault) else { return };
            let request = "POST /api/1/settings/keep";
            let answer = console.ask([127, 0, 0, 1].into(), request, JSON, &body.to_string());
            let now = folder.settings();
            assert!(now == SETTINGS || now == text, "{call} {count}: {now:?}");
            drop(console);
            tracer.wait().unwrap();
            if let Some(answer) = answer {
                assert_eq!(answer.status, 200, "{call} {count}: {answer:?}");
                break;
            }
            (kills, kept, count) = (kills + 1, kept + u32::from(now == text), count + 1);
            // What a killed program leaves does not keep the next one from its work.
            let console = folder.again();
            let body = json!({"text": text, "base": hash_of(&console)});
            assert_eq!(console.post("settings/keep", &body).status, 200, "{call} {count}");
        }
    }
    assert!(kills > 12 && kept > 1 && kept < kills, "{kills} kills, after {kept} of which the new settings were there");
}

/// Attaches strace to all threads of a process, also to those that it starts later but not to the programs that it starts, and
/// injects a fault into a system call from now on. Returns `None` with a note where that is not possible.
fn inject(pid: u32, call: &str, fault: &str) -> Option<Child> {
    let (trace, inject) = (format!("trace={call}"), format!("inject={fault}"));
    let mut tracer = Command::new("strace");
    if tracer.arg("-V").stdout(Stdio::null()).status().is_err() {
        skip("there is no strace; scripts/setup tests installs it");
        return None;
    }
    tracer = Command::new("strace");
    tracer.args(["-f", "--detach-on=execve", "-o", "/dev/null", "-e", &trace, "-e", &inject, "-p", &pid.to_string()]);
    let mut tracer = tracer.stderr(Stdio::piped()).spawn().unwrap();
    // strace goes on writing there.
    let mut line = String::new();
    BufReader::new(tracer.stderr.as_mut().unwrap()).read_line(&mut line).unwrap();
    if line.contains("attached") {
        return Some(tracer);
    }
    let _ = tracer.kill();
    tracer.wait().unwrap();
    skip(&format!("strace may not attach to a process: {line:?}"));
    None
}

#[test]
fn from_elsewhere_the_first_password_opens_and_wrong_ones_have_to_wait() {
    let Some((console, address)) = from_elsewhere() else { return };
    let ask =
        |request: &str, headers: &str, body: Value| console.ask(address, request, headers, &body.to_string()).unwrap();
    let session = ask("GET /api/1/session", "", json!({})).json();
    assert_eq!(session, json!({"role": null, "needs_password": true, "secure": false, "local": false}));
    for path in ["status", "settings", "events", "report", "picture", "recordings/x"] {
        assert_eq!(ask(&format!("GET /api/1/{path}"), "", json!({})).status, 401, "{path}");
    }
    let short = ask("POST /api/1/password", JSON, json!({"new": "short"}));
    assert!(short.status == 400 && short.text().contains("8 to 128"), "{short:?}");
    let first = ask("POST /api/1/password", JSON, json!({"new": "a good password"}));
    assert!(first.status == 200 && first.headers["set-cookie"].contains("HttpOnly; SameSite=Strict"), "{first:?}");
    assert_eq!(ask("GET /api/1/session", &first.cookie(), json!({})).json()["role"], "operate");
    // From now on it takes the password to set another one.
    assert_eq!(ask("POST /api/1/password", JSON, json!({"new": "another password"})).status, 401);
    let kept = fs::read_to_string(console.folder.path().join("state/access.json")).unwrap();
    assert!(kept.contains("$argon2id$") && !kept.contains("good"), "{kept}");
    let mode = fs::metadata(console.folder.path().join("state/access.json")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let log_in = |password: &str| ask("POST /api/1/login", JSON, json!({"password": password}));
    let session = log_in("a good password");
    let cookie = session.cookie();
    assert_eq!(ask("GET /api/1/status", &cookie, json!({})).status, 200);
    let out = ask("POST /api/1/logout", &format!("{JSON}{cookie}"), json!({}));
    assert!(out.headers["set-cookie"].contains("Max-Age=0"), "{out:?}");
    assert_eq!(ask("GET /api/1/status", &cookie, json!({})).status, 401);
    for _ in 0..5 {
        assert_eq!(log_in("a wrong password").status, 403);
    }
    // Even the right one has to wait now, and loopback has not.
    let late = log_in("a good password");
    assert!(late.status == 429 && late.text().contains("Try again in"), "{late:?}");
    assert_eq!(console.get("status").status, 200);
    // A session that began before goes on.
    assert_eq!(ask("GET /api/1/status", &first.cookie(), json!({})).status, 200);
}

#[test]
fn behind_a_proxy_that_encrypts_everybody_logs_in_under_a_name_of_the_settings() {
    let console = Console::start(SETTINGS);
    let loopback = SocketAddr::from(([127, 0, 0, 1], console.port()));
    // What a proxy on this machine passes on for a browser at this address.
    let ask = |request: &str, more: &str, body: Value| {
        let (body, proxy) = (body.to_string(), "X-Forwarded-For: 192.168.1.77\r\nX-Forwarded-Proto: https\r\n");
        let head = format!("{request} HTTP/1.1\r\nHost: Head.lan\r\nOrigin: https://Head.lan\r\nConnection: close\r\n");
        let length = body.len();
        let bytes = format!("{head}{proxy}{JSON}{more}Content-Length: {length}\r\n\r\n{body}");
        send(loopback, bytes.as_bytes(), PATIENCE).unwrap()
    };
    let unknown = ask("GET /api/1/session", "", json!({}));
    assert!(unknown.status == 421 && unknown.text().contains("add this name"), "{unknown:?}");
    let text = format!("{SETTINGS}[console]\nnames = \"head.fritz.box head.lan\"\n");
    console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)}));
    eventually("the name", || ask("GET /api/1/session", "", json!({})).status == 200);
    let session = ask("GET /api/1/session", "", json!({})).json();
    assert_eq!(session, json!({"role": null, "needs_password": true, "secure": true, "local": false}));
    assert_eq!(ask("POST /api/1/servos/release", "", json!({"on": true})).status, 401);
    let first = ask("POST /api/1/password", "", json!({"new": "a good password"}));
    assert!(first.headers["set-cookie"].ends_with("; Secure"), "{first:?}");
    let stop = in_time(|| ask("POST /api/1/servos/release", &first.cookie(), json!({"on": true})));
    assert_eq!(stop.status, 200);
    // Whoever guesses there makes nobody else wait.
    for status in [403, 403, 403, 403, 403, 429] {
        assert_eq!(ask("POST /api/1/login", "", json!({"password": "a wrong password"})).status, status);
    }
    let another = "X-Forwarded-For: 192.168.1.78\r\n";
    assert_eq!(ask("POST /api/1/login", another, json!({"password": "a good password"})).status, 200);
}

#[test]
fn a_new_password_needs_the_old_one_except_on_the_board() {
    let Some((console, address)) = from_elsewhere() else { return };
    let operator = console.post("password", &json!({"new": "a good password"})).cookie();
    let replace = |body: Value| {
        let headers = format!("{JSON}{operator}");
        console.ask(address, "POST /api/1/password", &headers, &body.to_string()).unwrap()
    };
    let without = replace(json!({"new": "another password"}));
    assert!(without.status == 403 && without.text().contains("Give the old password"), "{without:?}");
    let wrong = replace(json!({"new": "another password", "old": "a wrong password"}));
    assert!(wrong.status == 403 && wrong.text().contains("is wrong"), "{wrong:?}");
    assert_eq!(console.ask(address, "GET /api/1/status", &operator, "").unwrap().status, 200);
    let right = replace(json!({"new": "another password", "old": "a good password"}));
    assert_eq!(right.status, 200, "{right:?}");
    assert_eq!(console.ask(address, "GET /api/1/status", &operator, "").unwrap().status, 401);
    // Whoever has forgotten it sets another one with the shell of the board.
    assert_eq!(console.post("password", &json!({"new": "a third password"})).status, 200);
    let body = json!({"password": "a third password"}).to_string();
    assert_eq!(console.ask(address, "POST /api/1/login", JSON, &body).unwrap().status, 200);
}

#[test]
fn a_stolen_look_token_sees_and_changes_nothing() {
    let Some((console, address)) = from_elsewhere() else { return };
    let token = console.post("tokens/look", &json!({})).json()["token"].clone();
    let ask =
        |request: &str, headers: &str, body: Value| console.ask(address, request, headers, &body.to_string()).unwrap();
    let cookie = ask("POST /api/1/login", JSON, json!({"token": token})).cookie();
    assert_eq!(ask("GET /api/1/status", &cookie, json!({})).status, 200);
    for (path, body) in posts() {
        let answer = ask(&format!("POST /api/1/{path}"), &format!("{JSON}{cookie}"), body);
        assert!(answer.status == 403 && answer.text().contains("may look"), "{path}: {answer:?}");
    }
    assert_eq!((console.service.changes(), console.settings().as_str()), (Vec::new(), SETTINGS));
    // A new token ends what the stolen one has begun.
    console.post("tokens/look", &json!({}));
    assert_eq!(ask("GET /api/1/status", &cookie, json!({})).status, 401);
    assert_eq!(ask("POST /api/1/login", JSON, json!({"token": token})).status, 403);
}

#[test]
fn streams_and_downloads_end_with_the_session_that_began_them() {
    let Some((console, address)) = from_elsewhere() else { return };
    let recordings = console.folder.path().join("state/recordings");
    fs::create_dir_all(&recordings).unwrap();
    let file = fs::File::create(recordings.join("1.fwrec")).unwrap();
    file.set_len(64_000_000).unwrap();
    let operator = console.post("password", &json!({"new": "a good password"})).cookie();
    let ask = |path: &str, headers: &str, body: Value| {
        console.ask(address, &format!("POST /api/1/{path}"), &format!("{JSON}{headers}"), &body.to_string()).unwrap()
    };
    let open = |path: &str, cookie: &str| {
        let address = SocketAddr::new(address, console.port());
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let close = "Connection: close\r\n";
        write!(stream, "GET /api/1/{path} HTTP/1.1\r\n{close}Host: {address}\r\n{cookie}\r\n").unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).unwrap();
        assert_eq!(&status, b"HTTP/1.1 200", "{path}");
        BufReader::new(stream)
    };
    // What is on its way arrives, nothing that comes to pass from now on, and then the connection ends.
    let ends = |streams: Vec<BufReader<TcpStream>>, why: &str, mark: f32| {
        *console.service.pose.lock().unwrap() = packet(&[("jawOpen", mark)]);
        for line in streams.into_iter().flat_map(|stream| stream.lines().map_while(Result::ok)) {
            let event = line.strip_prefix("data: ").map(|data| serde_json::from_str::<Value>(data).unwrap());
            let jaw = event.and_then(|event| event["packet"]["coefficients"][17].as_f64()).unwrap_or_default();
            assert!((jaw - f64::from(mark)).abs() > 1e-3, "the stream goes on after {why}");
        }
    };
    let look = || {
        let token = console.post("tokens/look", &json!({})).json()["token"].clone();
        ask("login", "", json!({"token": token})).cookie()
    };
    let cookie = look();
    let (events, mut download) = (open("events", &cookie), open("recordings/1.fwrec", &cookie));
    let operators = open("events", &operator);
    let cookie = look();
    ends(vec![events], "a new link to look", 0.9);
    let mut rest = Vec::new();
    let _ = download.read_to_end(&mut rest);
    assert!(rest.len() < 64_000_000, "the download goes on");
    let again = ask("login", "", json!({"password": "a good password"})).cookie();
    let (events, others) = (open("events", &cookie), open("events", &again));
    ask("logout", &again, json!({}));
    ends(vec![others], "a logout", 0.8);
    console.post("password", &json!({"new": "another password"}));
    ends(vec![operators, events], "a new password", 0.7);
}

#[test]
fn a_request_that_was_begun_with_rights_is_not_done_without_them() {
    let Some((console, address)) = from_elsewhere() else { return };
    let operator = console.post("password", &json!({"new": "a good password"})).cookie();
    let address = SocketAddr::new(address, console.port());
    let body = json!({"on": false}).to_string();
    let mut slow = TcpStream::connect(address).unwrap();
    slow.set_read_timeout(Some(PATIENCE)).unwrap();
    // The program asks for the body when it has found that the operator may do this.
    let length = body.len();
    let head = format!("Host: {address}\r\nExpect: 100-continue\r\nContent-Length: {length}\r\n{JSON}{operator}");
    write!(slow, "POST /api/1/servos/release HTTP/1.1\r\n{head}\r\n").unwrap();
    let mut line = [0; 25];
    slow.read_exact(&mut line).unwrap();
    assert_eq!(&line, b"HTTP/1.1 100 Continue\r\n\r\n");
    console.post("password", &json!({"new": "another password"}));
    write!(slow, "{body}").unwrap();
    slow.read_exact(&mut line[..12]).unwrap();
    assert_eq!(&line[..12], b"HTTP/1.1 401");
    assert_eq!(console.service.changes(), Vec::<Value>::new());
}

/// All requests that change something.
fn posts() -> Vec<(&'static str, Value)> {
    vec![
        ("settings/keep", json!({"text": "[camera]\nfps = 5\n", "base": "0"})),
        ("settings/restore", json!({"id": "1"})),
        ("settings/reload", json!({})),
        ("settings/edit", json!({"text": "", "changes": {"camera.fps": 5}})),
        ("settings/check", json!({"text": ""})),
        ("wearers/use", json!({"name": "anna"})),
        ("wearers/delete", json!({"name": "anna"})),
        ("calibration/begin", json!({"wearer": "anna"})),
        ("calibration/cancel", json!({})),
        ("servos/release", json!({"on": true})),
        ("servos/arm", json!({})),
        ("servos/drive", json!({"drive": "0", "link": 0, "channel": 1, "position": 1.0})),
        ("servos/disarm", json!({"drive": "0"})),
        ("recordings/begin", json!({})),
        ("recordings/end", json!({})),
        ("recordings/delete", json!({"name": "a.fwrec"})),
        ("recordings/play", json!({"name": "a.fwrec"})),
        ("tokens/look", json!({})),
        ("check", json!({})),
        ("service", json!({"do": "stop"})),
    ]
}

#[test]
fn posts_of_other_pages_and_hosts_change_nothing() {
    let console = Console::start(SETTINGS);
    let host = format!("127.0.0.1:{}", console.port());
    for (path, body) in posts() {
        for (headers, want) in [
            (format!("{JSON}Origin: http://evil.example\r\n"), 403),
            (format!("{JSON}Origin: null\r\n"), 403),
            (format!("{JSON}Origin: https://{host}\r\n"), 403),
            (format!("{JSON}Sec-Fetch-Site: cross-site\r\n"), 403),
            (format!("{JSON}Sec-Fetch-Site: same-site\r\n"), 403),
            // Forms, which need not ask first, send these.
            ("Content-Type: text/plain\r\n".to_owned(), 415),
            ("Content-Type: application/x-www-form-urlencoded\r\n".to_owned(), 415),
            (String::new(), 415),
        ] {
            let answer = console.post_with(path, &headers, &body);
            assert_eq!(answer.status, want, "{path} {headers}: {answer:?}");
        }
        // A name that somebody has pointed to this machine.
        let bytes = format!(
            "POST /api/1/{path} HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n{JSON}Content-Length: 2\r\n\r\n{{}}"
        );
        let rebound = send(SocketAddr::from(([127, 0, 0, 1], console.port())), bytes.as_bytes(), PATIENCE).unwrap();
        assert_eq!(rebound.status, 421, "{path}");
        // Nor does a link.
        assert_eq!(console.get(path).status, 404, "{path}");
    }
    assert_eq!((console.service.changes(), console.settings().as_str()), (Vec::new(), SETTINGS));
}

#[test]
fn neither_two_hundred_slow_clients_nor_a_stolen_look_token_keep_an_operator_from_stop() {
    let Some((console, address)) = from_elsewhere() else { return };
    let operator = console.post("password", &json!({"new": "a good password"})).cookie();
    let token = console.post("tokens/look", &json!({})).json()["token"].clone();
    let ask =
        |request: &str, headers: &str, body: Value| console.ask(address, request, headers, &body.to_string()).unwrap();
    let looker = ask("POST /api/1/login", JSON, json!({"token": token})).cookie();
    let address = SocketAddr::new(address, console.port());
    let open = |rest: String| {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "{rest}").unwrap();
        stream
    };
    // Whoever looks takes all the streams and connections that there are.
    let request = |path: &str| format!("GET /api/1/{path} HTTP/1.1\r\nHost: {address}\r\n{looker}\r\n");
    let mut lookers: Vec<TcpStream> = (0..90).map(|_| open(request("events"))).collect();
    lookers.extend((0..90).map(|_| open(request("session"))));
    // The answers tell that each connection belongs to a looker by now.
    for stream in &mut lookers {
        let _ = stream.read(&mut [0]);
    }
    let mut events = open(format!("GET /api/1/events HTTP/1.1\r\nHost: {address}\r\n{operator}\r\n"));
    let mut status = [0; 12];
    events.read_exact(&mut status).unwrap();
    assert_eq!(&status, b"HTTP/1.1 200");
    let head =
        format!("POST /api/1/settings/check HTTP/1.1\r\nHost: {address}\r\n{JSON}Content-Length: 100000\r\n\r\n");
    let slow: Vec<TcpStream> = (0..200).map(|_| open(head.clone())).collect();
    // The operator's connection is not refused, and the stream goes on.
    let stop = || ask("POST /api/1/servos/release", &format!("{JSON}{operator}"), json!({"on": true}));
    assert_eq!(in_time(stop).status, 200);
    let mut lines = BufReader::new(events).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"released\":true")), "the operator's stream has ended");
    assert!(memory_kb(console.viewer.pid(), "VmHWM") < 24_000);
    drop((lookers, slow));
}

#[test]
fn a_hundred_logins_with_a_stolen_look_token_leave_an_operator_the_stop() {
    let Some((console, address)) = from_elsewhere() else { return };
    let operator = console.post("password", &json!({"new": "a good password"})).cookie();
    let token = console.post("tokens/look", &json!({})).json()["token"].clone();
    let ask =
        |request: &str, headers: &str, body: Value| console.ask(address, request, headers, &body.to_string()).unwrap();
    for _ in 0..100 {
        assert_eq!(ask("POST /api/1/login", JSON, json!({"token": token})).status, 200);
    }
    let stop = || ask("POST /api/1/servos/release", &format!("{JSON}{operator}"), json!({"on": true}));
    assert_eq!(in_time(stop).status, 200);
}

/// Sets a flag in the end, so that threads that go on until then end with a test that fails, too.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn sixty_clients_that_ask_for_settings_do_not_hold_up_stop() {
    // It takes some time to read these settings.
    let settings = (0..500).fold(SETTINGS.to_owned(), |text, n| format!("{text}[a.b{n}]\nkey = [1, 2, 3] # {n}\n"));
    let console = Console::start(&settings);
    let [answered, ended, waiting] = [(); 3].map(|()| AtomicUsize::new(0));
    let is_over = AtomicBool::new(false);
    let ask = || {
        while !is_over.load(Ordering::Relaxed) {
            waiting.fetch_add(1, Ordering::Relaxed);
            let answer = console.ask([127, 0, 0, 1].into(), "GET /api/1/settings", "", "");
            answered.fetch_add(usize::from(answer.is_some_and(|answer| answer.status == 200)), Ordering::Relaxed);
            ended.fetch_add(1, Ordering::Relaxed);
            waiting.fetch_sub(1, Ordering::Relaxed);
        }
    };
    let stop_twenty_times = || {
        for _ in 0..20 {
            assert_eq!(in_time(|| console.post("servos/release", &json!({"on": true}))).status, 200);
        }
    };
    thread::scope(|scope| {
        let _over = Over(&is_over);
        (0..60).for_each(|_| drop(scope.spawn(ask)));
        eventually("answers", || answered.load(Ordering::Relaxed) > 10);
        stop_twenty_times();
        // The program judges nothing before this file goes away, so that nobody gets the new settings.
        let judging = console.folder.path().join("judging");
        fs::write(&judging, "").unwrap();
        fs::write(console.folder.path().join("facewire.toml"), settings + "# new\n").unwrap();
        eventually("STOP while all others wait", || {
            let before = ended.load(Ordering::Relaxed);
            stop_twenty_times();
            (waiting.load(Ordering::Relaxed), ended.load(Ordering::Relaxed)) == (60, before)
        });
        let before = answered.load(Ordering::Relaxed);
        fs::remove_file(judging).unwrap();
        eventually("answers to the others", || answered.load(Ordering::Relaxed) >= before + 60);
    });
}

/// Lets a process that stands still go on in the end, so that nothing waits for it for ever if a test fails.
struct GoesOn(Pid);

impl Drop for GoesOn {
    fn drop(&mut self) {
        let _ = kill_process(self.0, Signal::CONT);
    }
}

#[test]
fn a_flood_of_connections_cuts_no_login_off() {
    let Some((console, address)) = from_elsewhere() else { return };
    console.post("password", &json!({"new": "a good password"}));
    let address = SocketAddr::new(address, console.port());
    let (connected, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
    let flood = || {
        let mut open = VecDeque::new();
        while !is_over.load(Ordering::Relaxed) {
            let stream = TcpStream::connect(address).ok();
            connected.fetch_add(usize::from(stream.is_some()), Ordering::Relaxed);
            open.extend(stream);
            open.drain(..open.len().saturating_sub(100));
        }
    };
    // The console stands still until the login has come, and more connections behind it than there are places.
    let process = Pid::from_raw(console.viewer.pid().try_into().unwrap()).unwrap();
    kill_process(process, Signal::STOP).unwrap();
    let goes_on = GoesOn(process);
    let body = json!({"password": "a good password"}).to_string();
    let length = body.len();
    let head = format!("Host: {address}\r\nConnection: close\r\nContent-Length: {length}\r\n{JSON}");
    let mut login = TcpStream::connect(address).unwrap();
    login.set_read_timeout(Some(PATIENCE)).unwrap();
    write!(login, "POST /api/1/login HTTP/1.1\r\n{head}\r\n{body}").unwrap();
    thread::scope(|scope| {
        let _over = Over(&is_over);
        (0..2).for_each(|_| drop(scope.spawn(flood)));
        eventually("the flood", || connected.load(Ordering::Relaxed) > 200);
        drop(goes_on);
        let mut status = [0; 12];
        login.read_exact(&mut status).unwrap();
        assert_eq!(&status, b"HTTP/1.1 200");
    });
}

#[test]
fn a_disk_that_takes_its_time_holds_up_no_release() {
    let console = Console::start(SETTINGS);
    let body = json!({"text": SETTINGS.replace("30", "60"), "base": hash_of(&console)});
    let Some(mut tracer) = inject(console.viewer.pid(), "fsync", "fsync:delay_enter=5000000:when=1") else { return };
    thread::scope(|scope| {
        let kept = scope.spawn(|| console.post("settings/keep", &body));
        let temporary = console.folder.path().join("state/settings");
        let is_there = || fs::read_dir(&temporary).is_ok_and(|mut files| files.next().is_some());
        eventually("a file that is being written", || kept.is_finished() || is_there());
        assert_eq!(in_time(|| console.post("servos/release", &json!({"on": true}))).status, 200);
        console.service.until(|seen| seen.requests.iter().any(|request| request["do"] == "release"));
        assert_eq!(console.settings(), SETTINGS, "the disk was not slow");
        assert_eq!(kept.join().unwrap().status, 200);
    });
    drop(console);
    tracer.wait().unwrap();
}

#[test]
fn servos_that_are_new_are_released_before_their_settings_are_used() {
    let console = Console::start(SETTINGS);
    let (board, channel) = ("\n[[link]]\nkind = \"maestro\"\n", "\n[[link.channel]]\nchannel = 2\n");
    let (release, reload) = (json!({"do": "release", "on": true}), json!({"do": "reload"}));
    let keep = |text: &str| {
        let kept = console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)}));
        assert_eq!(kept.status, 200, "{kept:?}");
        kept.text()
    };
    let text = format!("{SETTINGS}{board}{channel}");
    assert!(keep(&text).contains("all servos are released until you let them move again"));
    assert_eq!(console.service.changes(), [release, reload.clone()]);
    let text = text + "neutral = 0.2\n";
    keep(&text);
    assert_eq!(console.service.changes()[2..], [reload]);
    // Where they are not released, nothing is kept.
    console.service.seen.lock().unwrap().refusal = Some(("release", "the service ends"));
    let body = json!({"text": format!("{text}{channel}").replacen("= 2", "= 4", 1), "base": hash_of(&console)});
    let kept = console.post("settings/keep", &body);
    assert!(kept.status == 409 && kept.text().contains("nothing is kept: the service ends"), "{kept:?}");
    assert_eq!(console.settings(), text);
    // A board that is not plugged in yet is released as soon as it is.
    console.service.seen.lock().unwrap().refusal = Some(("release", "not reached: maestro /dev/away"));
    let kept = console.post("settings/keep", &body);
    assert!(kept.status == 200 && kept.text().contains("all servos that are reached are released"), "{kept:?}");
}

#[test]
fn no_request_changes_which_library_the_service_loads() {
    let console = Console::start(SETTINGS);
    for networks in ["engine = \"onnxruntime\"", "folder = \"/tmp/networks\""] {
        let text = format!("{SETTINGS}\n[networks]\n{networks}\n");
        let kept = console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)}));
        assert!(kept.status == 403 && kept.text().contains("which library the service loads"), "{kept:?}");
        assert_eq!(console.settings(), SETTINGS);
    }
    let text = format!("{SETTINGS}\n[networks]\nthreads = 2\n");
    assert_eq!(console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)})).status, 200);
}

#[test]
fn settings_that_the_service_does_not_use_are_told_until_it_does() {
    let console = Console::start(SETTINGS);
    let refuse = |refusal| console.service.seen.lock().unwrap().refusal = refusal;
    let refused = || {
        console.get("settings").json()["versions"]
            .as_array()
            .unwrap()
            .iter()
            .map(|it| it["refused"] == true)
            .collect::<Vec<_>>()
    };
    let shown = || console.get("status").json()["service"]["settings_refused"].clone();
    let keep = |fps: &str| {
        let text = SETTINGS.replace("30", fps);
        let kept = console.post("settings/keep", &json!({"text": text, "base": hash_of(&console)}));
        assert_eq!((kept.status, console.settings()), (200, text));
        kept.json()["done"].as_str().unwrap().to_owned()
    };
    refuse(Some(("reload", "the model is missing")));
    for fps in ["50", "60", "70"] {
        assert!(keep(fps).contains("goes on with the former ones"));
        assert_eq!(shown(), "the model is missing");
    }
    // The way back leads past those that were refused.
    assert_eq!(refused(), [true, true, false]);
    assert_eq!(console.post("settings/reload", &json!({})).status, 409);
    refuse(None);
    assert_eq!(console.post("settings/reload", &json!({})).status, 200);
    assert_eq!(shown(), Value::Null);
    keep("80");
    assert_eq!(refused(), [false, true, true, false]);
}

/// Arms the servos and returns the session.
fn arm(console: &Console) -> Value {
    let answer = console.post("servos/arm", &json!({}));
    assert_eq!(answer.status, 200, "{answer:?}");
    answer.json()["drive"].clone()
}

fn jog(console: &Console, drive: &Value) -> Answer {
    console.post("servos/drive", &json!({"drive": drive, "link": 0, "channel": 3, "position": 0.4}))
}

/// Moves a servo all the time in a drive of the browser with this cookie, and asks the console something meanwhile. Returns the
/// drive and what was found once a drive has lasted until everything was asked. A busy machine may end a drive, and then it is
/// asked again in the next one.
fn while_driving<T>(console: &Console, cookie: &str, ask: impl Fn() -> T) -> (Value, T) {
    let mut lasted = None;
    eventually("a drive that lasts", || {
        let answer = console.post_with("servos/arm", &format!("{JSON}{cookie}"), &json!({}));
        if answer.status != 200 {
            // Once the last drive had ended, somebody else may have armed.
            return false;
        }
        let drive = answer.json()["drive"].clone();
        let is_over = AtomicBool::new(false);
        let found = thread::scope(|scope| {
            let _over = Over(&is_over);
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    jog(console, &drive);
                    thread::sleep(Duration::from_millis(20));
                }
            });
            ask()
        });
        if jog(console, &drive).status == 200 {
            lasted = Some((drive, found));
        } else {
            console.post("servos/disarm", &json!({"drive": drive}));
        }
        lasted.is_some()
    });
    lasted.unwrap()
}

#[test]
fn one_operator_moves_servos_and_the_second_sees_who() {
    let Some((console, address)) = from_elsewhere() else { return };
    let password = "a good password";
    console.post("password", &json!({"new": password}));
    let first = console.name();
    let ask = |request: &str, headers: &str, body: Value| {
        console.ask(address, request, &format!("{JSON}{headers}"), &body.to_string()).unwrap()
    };
    let open = ["settings/check", "settings/edit", "servos/release", "servos/drive", "servos/disarm"];
    let (drive, (cookie, second, shown, seen, changes, stranger, resumed)) = while_driving(&console, &first, || {
        // If the last drive has ended too early, the second has set the password, and the session is over.
        let cookie = ask("POST /api/1/login", "", json!({"password": password})).cookie();
        let second = ask("POST /api/1/servos/arm", &cookie, json!({}));
        let shown = console.get_with("status", &first).json();
        let seen = ask("GET /api/1/status", &cookie, json!({})).json();
        let changes = posts().into_iter().chain([("password", json!({"new": password}))]);
        let changes = changes.filter(|(path, _)| !open.contains(path));
        let changes: Vec<_> =
            changes.map(|(path, body)| (path, ask(&format!("POST /api/1/{path}"), &cookie, body))).collect();
        let stranger = ask("POST /api/1/password", "", json!({"new": "a third password"}));
        let resumed = ask("POST /api/1/servos/release", &cookie, json!({"on": false}));
        (cookie, second, shown, seen, changes, stranger, resumed)
    });
    console
        .service
        .until(|seen| seen.lines.iter().any(|(_, line)| *line == json!({"link": 0, "channel": 3, "position": 0.4})));
    assert!(second.status == 409 && second.text().contains("127.0.0.1 moves the servos"), "{second:?}");
    assert_eq!(shown["operator"], json!({"name": "127.0.0.1", "me": true}));
    assert_eq!(seen["operator"], json!({"name": "127.0.0.1", "me": false}));
    // Until the first lets go, the second changes nothing.
    for (path, answer) in changes {
        assert!(answer.status == 409 && answer.text().contains("moves the servos"), "{path}: {answer:?}");
    }
    assert!(stranger.status == 401 && !stranger.text().contains("127.0.0.1"), "{stranger:?}");
    assert_eq!(resumed.status, 409);
    // The name of a session that is not there moves nothing, and neither does what is no movement.
    assert_eq!(jog(&console, &json!("0")).status, 409);
    for line in [json!({"drive": drive, "do": "release", "on": false}), json!({"drive": drive, "position": "1"})] {
        assert_eq!(console.post("servos/drive", &line).status, 400, "{line}");
    }
    // Anybody who operates may let go of all servos.
    let stop = in_time(|| ask("POST /api/1/servos/release", &cookie, json!({"on": true})));
    assert_eq!(stop.status, 200);
    console.post("servos/disarm", &json!({"drive": drive}));
    console.service.until(|seen| {
        let drives = seen.requests.iter().filter(|request| request["do"] == "drive").count();
        seen.ended.len() == drives
    });
    assert_eq!(jog(&console, &drive).status, 409);
    arm(&console);
}

#[test]
fn two_operators_on_this_machine_or_through_one_tunnel_are_told_apart() {
    let console = Console::start(SETTINGS);
    let [first, second] = [(); 2].map(|()| console.name());
    assert_ne!(first, second);
    assert!(!console.get_with("session", &first).headers.contains_key("set-cookie"), "the name changes");
    let me = |name: &str| console.get_with("status", name).json()["operator"]["me"].clone();
    let body = json!({"text": SETTINGS.replace("30", "60"), "base": hash_of(&console)});
    let keep = |name: &str| console.post_with("settings/keep", &format!("{JSON}{name}"), &body);
    let (_, (shown, refused, settings, kept)) = while_driving(&console, &first, || {
        // Somebody may have kept others since the last drive has ended.
        fs::write(console.folder.path().join("facewire.toml"), SETTINGS).unwrap();
        let shown = [me(&first), me(&second), me("")];
        (shown, [keep(&second), keep("")], console.settings(), keep(&first))
    });
    assert_eq!(shown, [json!(true), json!(false), json!(false)]);
    for answer in refused {
        assert!(answer.status == 409 && answer.text().contains("moves the servos"), "{answer:?}");
    }
    assert_eq!(settings, SETTINGS);
    assert_eq!(kept.status, 200);
}

#[test]
fn a_page_that_is_silent_and_a_console_that_is_killed_end_a_drive() {
    let console = Console::start(SETTINGS);
    let drive = arm(&console);
    jog(&console, &drive);
    console.service.until(|seen| seen.ended.len() == 1);
    eventually("that nobody operates", || console.get("status").json()["operator"].is_null());
    assert_eq!(jog(&console, &drive).status, 409);
    arm(&console);
    kill_process(Pid::from_raw(console.viewer.pid().try_into().unwrap()).unwrap(), Signal::KILL).unwrap();
    console.service.until(|seen| seen.ended.len() == 2);
}

#[test]
fn a_raw_picture_comes_as_a_small_jpeg_image_after_its_description() {
    let console = Console::start(SETTINGS);
    let answer = console.get("picture");
    let end = answer.body.iter().position(|byte| *byte == b'\n').unwrap();
    let head: Value = serde_json::from_slice(&answer.body[..end]).unwrap();
    let image = &answer.body[end + 1..];
    assert_eq!((&head["format"], &head["bytes"]), (&"jpeg".into(), &image.len().into()));
    assert!(image.starts_with(&[0xff, 0xd8]) && image.ends_with(&[0xff, 0xd9]));
}

#[test]
fn a_recording_is_made_listed_loaded_played_and_deleted() {
    let console = Console::start(SETTINGS);
    let name = console.post("recordings/begin", &json!({})).json()["name"].clone();
    let name = name.as_str().unwrap();
    assert_eq!(console.post("recordings/begin", &json!({})).status, 409);
    assert_eq!(console.get("status").json()["recording"]["recording"]["name"], name);
    let listed = || console.get("recordings").json()["list"].clone();
    while listed()[0]["bytes"] != 6 {}
    assert_eq!(console.post("recordings/delete", &json!({"name": name})).status, 409);
    console.post("recordings/end", &json!({}));
    while !console.get("status").json()["recording"]["recording"].is_null() {}
    let file = console.get(&format!("recordings/{name}"));
    assert_eq!(file.text(), "frames");
    assert!(file.headers["content-disposition"].contains(name));
    for outside in
        ["recordings/../access.json", "recordings/%2e%2e/access.json", "recordings//etc/passwd", "recordings/"]
    {
        assert_eq!(console.get(outside).status, 404, "{outside}");
    }
    // A second lies between two rows, in which the drive goes on.
    let me = format!("{JSON}{}", console.name());
    assert_eq!(console.post_with("recordings/play", &me, &json!({"name": name})).status, 200);
    assert_eq!(console.get("status").json()["operator"]["name"], "127.0.0.1");
    console.service.until(|seen| seen.lines.iter().any(|(_, line)| line["coefficients"].is_null()));
    assert_eq!(console.post_with("recordings/end", &me, &json!({})).status, 200);
    console.service.until(|seen| seen.ended.len() == 1);
    while !console.get("status").json()["recording"]["playing"].is_null() {}
    assert_eq!(console.post("recordings/delete", &json!({"name": name})).status, 200);
    assert_eq!(listed(), json!([]));
}

#[test]
fn check_and_report_say_what_is_wrong_without_names_and_addresses() {
    let settings = "[wearer]\nname = \"anna\"\n[[link]]\nkind = \"udp\"\naddress = \"10.1.2.3:5\"\n";
    let console = Console::start(settings);
    let lines = console.post("check", &json!({})).json()["lines"].clone();
    let levels: Vec<&str> = lines.as_array().unwrap().iter().map(|line| line["level"].as_str().unwrap()).collect();
    assert_eq!(levels, ["ok", "warning", "failure"]);
    let report = console.get("report").text();
    for part in ["facewire 0.1.0", "== settings", "kind = \"udp\"", "facewire_frames_total", "== log"] {
        assert!(report.contains(part), "{part}: {report}");
    }
    assert!(!report.contains("anna") && !report.contains("10.1.2.3"), "{report}");
}

/// Plays the service manager: starts the helper for each connection, with programs that only say what they are asked.
fn serve_helper(folder: &Path) -> PathBuf {
    for (name, code) in [("systemctl", "echo systemctl $* >&2"), ("systemd-run", "echo $*")] {
        let path = folder.join("bin").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, format!("#!/bin/sh\n{code}\n")).unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let (socket, programs) = (folder.join("helper"), folder.join("bin"));
    let listener = UnixListener::bind(&socket).unwrap();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let stream = OwnedFd::from(stream.unwrap());
            let mut helper = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../systemd/facewire-helper"));
            helper.env("PATH", format!("{}:/usr/bin:/bin", programs.display()));
            helper.stdin(stream.try_clone().unwrap()).stdout(stream).stderr(Stdio::null()).status().unwrap();
        }
    });
    socket
}

#[test]
fn the_helper_starts_and_stops_the_service_and_does_nothing_that_it_does_not_know() {
    let first = Console::start(SETTINGS);
    assert!(first.post("service", &json!({"do": "start"})).text().contains("its helper is not installed"));
    let socket = serve_helper(first.folder.path());
    let console = first.again_with(&["--helper", socket.to_str().unwrap()]);
    let started = console.post("service", &json!({"do": "start"}));
    assert_eq!(started.json()["done"], "the service runs, and starts with the system", "{started:?}");
    assert_eq!(console.post("service", &json!({"do": "stop"})).status, 200);
    assert_eq!(console.post("service", &json!({"do": "start; reboot"})).status, 400);
    let lines = console.post("check", &json!({})).json()["lines"].clone();
    let asked = lines[0]["text"].as_str().unwrap();
    assert!(asked.ends_with("/usr/bin/facewire check --config /etc/facewire/facewire.toml"), "{asked}");
    let mut stream = UnixStream::connect(socket).unwrap();
    stream.write_all(b"reboot\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert_eq!(answer, "the request is not known\n");
}

#[test]
fn a_console_with_a_page_a_password_and_pictures_takes_little_memory() {
    let console = Console::start(SETTINGS);
    let mut events = console.viewer.events();
    console.post("password", &json!({"new": "a good password"}));
    for _ in 0..20 {
        assert_eq!(console.get("picture").status, 200);
        console.get("settings");
        events.until(|event| event["packet"].is_object());
    }
    let [peak, now] = ["VmHWM", "VmRSS"].map(|key| memory_kb(console.viewer.pid(), key));
    println!("peak memory {:.1} MB, now {:.1} MB", peak as f64 / 1e3, now as f64 / 1e3);
    assert!(peak < 20_000, "{peak} KB");
}
