//! Chromium without a screen, driven by its `DevTools` protocol through a pipe.
//! Source: <https://chromedevtools.github.io/devtools-protocol/>

use std::{
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::PATIENCE;

/// Chromium reads commands from descriptor 3 and writes answers to descriptor 4.
const START: &str = r#"exec chromium "$@" 3<&0 4>&1 1>&2 0</dev/null"#;
/// The tests draw without a graphics card. A sandbox is neither possible as root nor needed for a page of our own.
const ARGUMENTS: [&str; 8] = [
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--remote-debugging-pipe",
];
/// The folder to keep screenshots in, for people who want to look at them.
const SCREENSHOTS: &str = "FACEWIRE_SCREENSHOTS";

/// A browser with one page.
pub struct Browser {
    child: Child,
    commands: ChildStdin,
    messages: mpsc::Receiver<Value>,
    events: Vec<Value>,
    session: Option<String>,
    commands_sent: u64,
    folder: TempDir,
    patience: Duration,
}

/// A picture of the page, 4 bytes for each pixel.
pub struct Screenshot {
    pub width: usize,
    pub pixels: Vec<[u8; 4]>,
}

impl Browser {
    /// Whether the browser is installed.
    pub fn is_installed() -> bool {
        Command::new("sh").args(["-c", "command -v chromium"]).stdout(Stdio::null()).status().unwrap().success()
    }

    /// Starts the browser with an empty page of this size in CSS pixels.
    pub fn start(width: u32, height: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", START, "sh"]).args(ARGUMENTS);
        command.arg(format!("--user-data-dir={}", folder.path().join("profile").display()));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let (sender, messages) = mpsc::channel();
        let answers = BufReader::new(child.stdout.take().unwrap());
        thread::spawn(move || {
            for message in answers.split(0).map_while(Result::ok) {
                if sender.send(serde_json::from_slice(&message).unwrap()).is_err() {
                    return;
                }
            }
        });
        let commands = child.stdin.take().unwrap();
        let mut browser = Self {
            child,
            commands,
            messages,
            events: Vec::new(),
            session: None,
            commands_sent: 0,
            folder,
            patience: PATIENCE,
        };
        browser.prepare(width, height);
        browser
    }

    fn prepare(&mut self, width: u32, height: u32) {
        let downloads = self.downloads().to_str().unwrap().to_owned();
        self.call(
            "Browser.setDownloadBehavior",
            &json!({"behavior": "allow", "downloadPath": downloads, "eventsEnabled": true}),
        );
        let target = self.call("Target.createTarget", &json!({"url": "about:blank"}))["targetId"].clone();
        let session = self.call("Target.attachToTarget", &json!({"targetId": target, "flatten": true}));
        self.session = Some(session["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page", "Runtime", "Log", "Network"] {
            self.call(&format!("{domain}.enable"), &json!({}));
        }
        self.resize(width, height);
    }

    /// Waits longer for what must come, of a slow machine.
    pub fn set_patience(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// Gives the page another size. A narrow page is that of a phone.
    pub fn resize(&mut self, width: u32, height: u32) {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600});
        self.call("Emulation.setDeviceMetricsOverride", &metrics);
    }

    /// The folder of downloads.
    pub fn downloads(&self) -> std::path::PathBuf {
        self.folder.path().to_owned()
    }

    /// Opens the only address of this page, and waits until it has loaded.
    pub fn open(&mut self, url: &str) {
        let answer = self.call("Page.navigate", &json!({"url": url}));
        assert!(answer.get("errorText").is_none(), "{answer}");
        self.await_event("Page.loadEventFired", |_| true);
    }

    /// Sends a command and returns its result.
    pub fn call(&mut self, method: &str, params: &Value) -> Value {
        self.commands_sent += 1;
        let id = self.commands_sent;
        let mut command = json!({"id": id, "method": method, "params": params});
        if let Some(session) = &self.session {
            command["sessionId"] = session.as_str().into();
        }
        self.commands.write_all(format!("{command}\0").as_bytes()).unwrap();
        loop {
            let message = self.next_message();
            if message["id"] == id {
                assert!(message.get("error").is_none(), "{method}: {message}");
                return message["result"].clone();
            }
            self.events.push(message);
        }
    }

    fn next_message(&self) -> Value {
        self.messages.recv_timeout(self.patience).expect("the browser does not answer")
    }

    /// The parameters of all events of this kind so far.
    pub fn events(&self, method: &str) -> Vec<Value> {
        self.events.iter().filter(|event| event["method"] == method).map(|event| event["params"].clone()).collect()
    }

    /// Waits for an event that fits.
    pub fn await_event(&mut self, method: &str, fits: impl Fn(&Value) -> bool) {
        while !self.events(method).iter().any(&fits) {
            let message = self.next_message();
            self.events.push(message);
        }
    }

    /// Returns the value of an expression in the page. A promise is awaited.
    pub fn value(&mut self, expression: &str) -> Value {
        let answer = self
            .call("Runtime.evaluate", &json!({"expression": expression, "awaitPromise": true, "returnByValue": true}));
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression in the page is true. The page looks at it before each picture. An expression that fails,
    /// as while the page is built, is not true yet.
    pub fn wait_until(&mut self, condition: &str) {
        let patience_ms = self.patience.as_millis();
        let look = format!(
            "new Promise((done) => {{ const end = performance.now() + {patience_ms}; \
             const holds = () => {{ try {{ return {condition}; }} catch {{ return false; }} }}; \
             const look = () => holds() ? done(true) : performance.now() > end ? done(false) : requestAnimationFrame(look); \
             look(); }})"
        );
        if self.value(&look) != true {
            panic!("{condition} is not true of the page: {}", self.value("document.body.innerText"));
        }
    }

    /// Presses a key, as `key` and `code` of an event name it.
    pub fn press(&mut self, key: &str, code: &str) {
        let text = if key == "Enter" { "\r" } else { key };
        for kind in ["keyDown", "keyUp"] {
            let mut event = json!({"type": kind, "key": key, "code": code, "windowsVirtualKeyCode": virtual_key(code)});
            if kind == "keyDown" && (text.chars().count() == 1) {
                event["text"] = text.into();
            }
            self.call("Input.dispatchKeyEvent", &event);
        }
    }

    /// Clicks the first control whose text begins so, once it is there and enabled.
    pub fn click(&mut self, text: &str) {
        let find = format!(
            "[...document.querySelectorAll('button:enabled, a, summary')].find((control) => control.textContent.trim().startsWith({text:?}) && control.checkVisibility())"
        );
        self.wait_until(&find);
        self.value(&format!("{find}.click()"));
    }

    /// Sets a field or a slider to a value, as a person does.
    pub fn set(&mut self, selector: &str, value: &str) {
        self.wait_until(&format!("document.querySelector({selector:?})"));
        self.value(&format!(
            "(() => {{ const field = document.querySelector({selector:?}); field.value = {value:?}; \
             for (const kind of ['input', 'change']) field.dispatchEvent(new Event(kind, {{ bubbles: true }})); }})()"
        ));
    }

    /// Waits until a text is on the page.
    pub fn wait_for_text(&mut self, text: &str) {
        self.wait_until(&format!("document.body.innerText.includes({text:?})"));
    }

    /// Waits until the page has drawn what it knows.
    pub fn wait_for_picture(&mut self) {
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))).then(() => 1)");
    }

    /// Takes a picture of what is visible.
    pub fn screenshot(&mut self, name: &str) -> Screenshot {
        self.wait_for_picture();
        let picture = self.call("Page.captureScreenshot", &json!({"format": "png"}));
        let bytes = BASE64_STANDARD.decode(picture["data"].as_str().unwrap()).unwrap();
        if let Some(folder) = std::env::var_os(SCREENSHOTS) {
            std::fs::write(Path::new(&folder).join(name).with_extension("png"), &bytes).unwrap();
        }
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8() | png::Transformations::ALPHA);
        let mut reader = decoder.read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        let (pixels, _) = pixels.as_chunks::<4>();
        Screenshot { width: info.width as usize, pixels: pixels.to_vec() }
    }

    /// The errors of the page: exceptions, and what went to its console as an error.
    pub fn errors(&self) -> Vec<Value> {
        let mut errors = self.events("Runtime.exceptionThrown");
        errors.extend(self.events("Runtime.consoleAPICalled").into_iter().filter(|call| call["type"] == "error"));
        errors.extend(self.events("Log.entryAdded").into_iter().filter(|entry| entry["entry"]["level"] == "error"));
        errors
    }

    /// The addresses of all requests.
    pub fn requests(&self) -> Vec<String> {
        let requests = self.events("Network.requestWillBeSent");
        requests.iter().map(|event| event["request"]["url"].as_str().unwrap().to_owned()).collect()
    }
}

/// The number by which browsers tell keys apart that give no text.
fn virtual_key(code: &str) -> u32 {
    match code {
        "Tab" => 9,
        "Enter" => 13,
        "Escape" => 27,
        "Space" => 32,
        "ArrowRight" => 39,
        _ => 0,
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Screenshot {
    /// The share of the pixels in a rectangle (left, top, width, height) that differ visibly from another picture.
    pub fn difference(&self, other: &Self, [left, top, width, height]: [usize; 4]) -> f64 {
        let rows = (top..top + height).map(|y| y * self.width + left);
        let differs = |at: usize| {
            let channels = self.pixels[at].iter().zip(&other.pixels[at]);
            channels.map(|(a, b)| a.abs_diff(*b)).max() > Some(24)
        };
        let changed = rows.flat_map(|row| row..row + width).filter(|at| differs(*at)).count();
        changed as f64 / (width * height) as f64
    }
}
