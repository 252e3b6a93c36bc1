//! Chromium without a screen, driven by its `DevTools` protocol through a pipe. What a person does with keys, a mouse or a
//! thumb, tests do in the same way and at the same pace. Scripts in the page only look.
//! Source: <https://chromedevtools.github.io/devtools-protocol/>

use std::{
    io::{BufRead as _, BufReader, Write as _},
    ops::RangeInclusive,
    path::Path,
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::PATIENCE;

/// Longest time until Chromium answers, which draws by the processor, on a machine that is busy.
const ANSWER_PATIENCE: Duration = Duration::from_mins(5);
/// Chromium reads commands from descriptor 3 and writes answers to descriptor 4.
const START: &str = r#"exec chromium "$@" 3<&0 4>&1 1>&2 0</dev/null"#;
/// The tests draw without a graphics card. A sandbox is neither possible as root nor needed for a page of our own.
const ARGUMENTS: [&str; 7] = [
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-gpu-compositing",
    "--remote-debugging-pipe",
];
/// To draw the face by the processor takes more time than all else on the page.
const WITH_FACE: [&str; 2] = ["--enable-unsafe-swiftshader", "--use-angle=swiftshader"];
const WITHOUT_FACE: [&str; 1] = ["--disable-3d-apis"];
/// The folder to keep screenshots in, for people who want to look at them.
const SCREENSHOTS: &str = "FACEWIRE_SCREENSHOTS";

/// The time that a person takes from one key to the next, or for one step of a drag.
const PACE_MS: RangeInclusive<u64> = 60..=200;
const STEPS_OF_A_DRAG: u32 = 5;
/// The time from one look at the page to the next. To look at each picture would take a third of a processor for each page.
const LOOK_MS: u64 = 50;
/// How often a test looks whether a page has come before it clicks its link again.
const LOOKS_AT_A_PAGE: u32 = 30;
/// The width of a slider's thumb in Chromium. The middle of the thumb stays half this width away from both ends.
const THUMB_PX: f64 = 16.0;

/// Finds the middle of a control, scrolls to it if it is out of sight or covered, and waits until it stays in place.
const PLACE: &str = "new Promise((done) => {
    const end = performance.now() + PATIENCE_MS;
    let last;
    const place = () => {
        const control = FIND;
        if (!control?.checkVisibility()) return 'is not there';
        const [box] = control.getClientRects();
        const middle = [box.x + box.width / 2, box.y + box.height / 2];
        const top = document.elementFromPoint(...middle);
        if (control.contains(top)) return middle;
        control.scrollIntoView({ block: 'center', behavior: 'instant' });
        return `lies below ${top?.outerHTML.slice(0, 200)}`;
    };
    const look = () => {
        const now = place();
        if (Array.isArray(now) && String(now) === String(last)) return done(now);
        if (performance.now() > end) return done(`${now}`);
        last = now;
        setTimeout(look, LOOK_MS);
    };
    look();
})";

/// Records whether the hand comes down on a control, and whether its next click reaches it.
const WATCH_HAND: &str = "(() => {
    const watch = (kind) => addEventListener(kind, ({ target }) => { hand[kind] = hand.control.contains(target); }, true);
    window.hand ??= (['pointerdown', 'click'].forEach(watch), {});
    Object.assign(hand, { control: FIND, pointerdown: undefined, click: undefined });
})()";

/// Returns an expression for the first element that a selector matches.
pub fn element(selector: &str) -> String {
    format!("document.querySelector({selector:?})")
}

/// Returns an expression for the first visible and enabled control that has this text, or else whose text begins so.
pub fn control(text: &str) -> String {
    format!(
        "((fits) => fits.find((control) => control.textContent.trim() === {text:?}) ?? fits[0])\
         ([...document.querySelectorAll('button:enabled, a, summary')]\
         .filter((control) => control.textContent.trim().startsWith({text:?}) && control.checkVisibility()))"
    )
}

/// Returns an expression for a button that is there only while the page is armed, or else for the button that arms it. A busy machine may
/// delay the heartbeat of the page, which then disarms.
pub fn or_arm(text: &str) -> String {
    format!("({} ?? {})", control(text), control("Arm"))
}

/// Returns an expression for the field of a label that begins so, within what a selector matches.
pub fn labelled(within: &str, label: &str) -> String {
    let labels = format!("{within} label");
    format!(
        "[...document.querySelectorAll({labels:?})].find((it) => it.innerText.trim().startsWith({label:?}))\
         ?.querySelector('input, select')"
    )
}

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
    random: fastrand::Rng,
    /// Whether tests touch the page, as on a phone, instead of using a mouse.
    has_thumb: bool,
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

    /// Starts the browser with an empty page of this size in CSS pixels. It cannot draw the face, and the page says so.
    pub fn start(width: u32, height: u32) -> Self {
        Self::start_with(&WITHOUT_FACE, width, height)
    }

    /// As [`Self::start`], but the browser can draw the face.
    pub fn with_face(width: u32, height: u32) -> Self {
        Self::start_with(&WITH_FACE, width, height)
    }

    fn start_with(graphics: &[&str], width: u32, height: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", START, "sh"]).args(ARGUMENTS).args(graphics);
        command.arg(format!("--user-data-dir={}", folder.path().join("profile").display()));
        // It leaves files in the folder for temporary files.
        command.env("TMPDIR", folder.path());
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
            random: fastrand::Rng::with_seed(52),
            has_thumb: false,
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

    /// Gives the page another size. A narrow page counts as that of a phone, and is touched.
    pub fn resize(&mut self, width: u32, height: u32) {
        self.has_thumb = width < 600;
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": self.has_thumb});
        self.call("Emulation.setDeviceMetricsOverride", &metrics);
        self.call("Emulation.setTouchEmulationEnabled", &json!({"enabled": self.has_thumb}));
        self.wait_for_picture();
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

    fn take_message(&mut self) {
        let message = self.next_message();
        self.events.push(message);
    }

    fn next_message(&self) -> Value {
        self.messages.recv_timeout(ANSWER_PATIENCE).expect("the browser does not answer")
    }

    /// The parameters of all events of this kind so far.
    pub fn events(&self, method: &str) -> Vec<Value> {
        self.events.iter().filter(|event| event["method"] == method).map(|event| event["params"].clone()).collect()
    }

    /// Waits for an event that fits.
    pub fn await_event(&mut self, method: &str, fits: impl Fn(&Value) -> bool) {
        while !self.events(method).iter().any(&fits) {
            self.take_message();
        }
    }

    /// Returns the value of an expression in the page. A promise is awaited.
    pub fn value(&mut self, expression: &str) -> Value {
        let answer = self
            .call("Runtime.evaluate", &json!({"expression": expression, "awaitPromise": true, "returnByValue": true}));
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression in the page is true. An expression that fails,
    /// as while the page is built, is not true yet.
    pub fn wait_until(&mut self, condition: &str) {
        let patience_ms = self.patience.as_millis();
        let look = format!(
            "new Promise((done) => {{ const end = performance.now() + {patience_ms}; \
             const holds = () => {{ try {{ return {condition}; }} catch {{ return false; }} }}; \
             const look = () => holds() ? done(true) : performance.now() > end ? done(false) : setTimeout(look, {LOOK_MS}); \
             look(); }})"
        );
        if self.value(&look) != true {
            panic!("{condition} is not true of the page: {}", self.value("document.body.innerText"));
        }
    }

    /// Presses a key, which has the name that `key` of a keyboard event gives it.
    pub fn press(&mut self, key: &str) {
        let text = if key == "Enter" { "\r" } else { key };
        let text = if text.chars().count() == 1 { text } else { "" };
        self.send_key(&json!({"key": key, "code": if key == " " { "Space" } else { key }, "text": text}));
    }

    fn send_key(&mut self, key: &Value) {
        for kind in ["keyDown", "keyUp"] {
            let mut event = key.clone();
            event["type"] = kind.into();
            event["windowsVirtualKeyCode"] = virtual_key(key["key"].as_str().unwrap()).into();
            if kind == "keyUp" {
                event["text"] = "".into();
            }
            self.call("Input.dispatchKeyEvent", &event);
        }
    }

    /// Lets as much time pass as a person takes from one key to the next.
    fn pause(&mut self) {
        let end = Instant::now() + Duration::from_millis(self.random.u64(PACE_MS));
        while let Ok(message) = self.messages.recv_timeout(end.saturating_duration_since(Instant::now())) {
            self.events.push(message);
        }
    }

    /// Lets as much time pass as a person takes to think about the next word.
    pub fn think(&mut self) {
        for _ in 0..5 {
            self.pause();
        }
    }

    /// Types a text key by key.
    pub fn type_text(&mut self, text: &str) {
        for letter in text.chars() {
            self.pause();
            let key = if letter == '\n' { "Enter".to_owned() } else { letter.to_string() };
            self.press(&key);
        }
    }

    /// Like [`Self::type_text`], but waits before the last key until two statuses have come and the page is drawn with them.
    pub fn type_through_statuses(&mut self, text: &str) {
        let before = self.statuses();
        let (last, _) = text.char_indices().next_back().unwrap();
        self.type_text(&text[..last]);
        self.await_statuses(before + 2);
        self.type_text(&text[last..]);
    }

    /// How many statuses the page has got so far.
    pub fn statuses(&self) -> usize {
        let events = self.events.iter().filter(|event| event["method"] == "Network.eventSourceMessageReceived");
        events.filter(|event| event["params"]["eventName"] == "status").count() + self.answers("status")
    }

    /// How long the last request for this path that was answered has waited for its answer.
    pub fn waited(&self, path: &str) -> Option<Duration> {
        let path = format!("/api/1/{path}");
        let mut asked = self.events("Network.requestWillBeSent");
        asked.retain(|event| event["request"]["url"].as_str().unwrap().ends_with(&path));
        let answers = self.events("Network.responseReceived");
        asked.iter().rev().find_map(|request| {
            let answer = answers.iter().find(|answer| answer["requestId"] == request["requestId"])?;
            let [begun, ended] = [request, answer].map(|event| event["timestamp"].as_f64().unwrap());
            Some(Duration::from_secs_f64(ended - begun))
        })
    }

    /// How many answers to requests for this path the page has got so far.
    pub fn answers(&self, path: &str) -> usize {
        let path = format!("/api/1/{path}");
        let events = self.events.iter().filter(|event| event["method"] == "Network.responseReceived");
        events.filter(|event| event["params"]["response"]["url"].as_str().unwrap().ends_with(&path)).count()
    }

    /// Waits until the page has got so many answers to requests for this path and is drawn with them.
    pub fn await_answers(&mut self, path: &str, count: usize) {
        let end = Instant::now() + self.patience;
        while self.answers(path) < count {
            assert!(Instant::now() < end, "waited in vain for an answer of {path}");
            self.take_message();
        }
        self.wait_for_picture();
    }

    /// Waits until the page has got so many statuses and is drawn with them.
    pub fn await_statuses(&mut self, count: usize) {
        let end = Instant::now() + self.patience;
        while self.statuses() < count {
            assert!(Instant::now() < end, "waited in vain for a status");
            self.take_message();
        }
        self.wait_for_picture();
    }

    /// Replaces the text of a field. The focus stays in the field.
    pub fn fill(&mut self, field: &str, text: &str) {
        self.select_all(field);
        self.type_text(text);
    }

    /// Puts the focus into a field and selects its text.
    pub fn select_all(&mut self, field: &str) {
        self.click_on(field);
        self.wait_until(&format!("document.activeElement === {field}"));
        // The modifier 2 is Ctrl.
        self.send_key(&json!({"key": "a", "code": "KeyA", "modifiers": 2, "commands": ["selectAll"]}));
    }

    /// Returns the middle of a control, where nothing lies over it.
    fn place(&mut self, find: &str) -> [f64; 2] {
        let patience_ms = self.patience.as_millis().to_string();
        let place = self.value(
            &PLACE.replace("FIND", find).replace("PATIENCE_MS", &patience_ms).replace("LOOK_MS", &LOOK_MS.to_string()),
        );
        if let Ok(middle) = serde_json::from_value(place.clone()) {
            return middle;
        }
        self.screenshot("a control that cannot be reached");
        panic!("{find} {place}: {}", self.value("document.body.innerText"))
    }

    /// Puts the mouse button or the thumb down, moves it while it is down, lifts it, or lifts it elsewhere, which clicks nothing.
    fn touch(&mut self, what: Touch, [x, y]: [f64; 2]) {
        if what == Touch::Away && !self.has_thumb {
            self.touch(Touch::Move, [0.0, 0.0]);
            return self.touch(Touch::Up, [0.0, 0.0]);
        }
        let (thumb, mouse) = match what {
            Touch::Down => ("touchStart", "mousePressed"),
            Touch::Move => ("touchMove", "mouseMoved"),
            Touch::Up => ("touchEnd", "mouseReleased"),
            Touch::Away => ("touchCancel", "mouseReleased"),
        };
        if self.has_thumb {
            let is_up = matches!(what, Touch::Up | Touch::Away);
            let points = if is_up { json!([]) } else { json!([{"x": x, "y": y}]) };
            self.call("Input.dispatchTouchEvent", &json!({"type": thumb, "touchPoints": points}));
        } else {
            let buttons = u8::from(what != Touch::Up);
            let event = json!({"type": mouse, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1});
            self.call("Input.dispatchMouseEvent", &event);
        }
    }

    /// Clicks the first control whose text begins so, once it is there and enabled.
    pub fn click(&mut self, text: &str) {
        self.click_on(&control(text));
    }

    /// Clicks what an expression finds, or taps it, once it is there, enabled, at rest, and not covered. If it has moved away before
    /// the hand came down, the hand leaves what it came down on without a click, and tries again. If it has moved away before the
    /// hand was lifted, which may have clicked a link to another page, the browser goes back first.
    pub fn click_on(&mut self, find: &str) {
        let end = Instant::now() + self.patience;
        let page = self.value("location.hash");
        loop {
            self.wait_until(&format!("{find} && !{find}.disabled"));
            let place = self.place(find);
            self.value(&WATCH_HAND.replace("FIND", find));
            self.touch(Touch::Down, place);
            if self.value("hand.pointerdown") == false {
                self.touch(Touch::Away, place);
            } else {
                self.touch(Touch::Up, place);
                self.wait_until("hand.click !== undefined || hand.control.disabled || !hand.control.isConnected");
                if self.value("hand.click") == true {
                    return;
                }
                if self.value("location.hash") != page {
                    self.go_back();
                    self.wait_until(&format!("location.hash === {page}"));
                }
            }
            assert!(Instant::now() < end, "{find} moves away");
        }
    }

    /// Chooses an option of a list by the arrow keys.
    pub fn choose(&mut self, list: &str, value: &str) {
        self.wait_until(&format!("[...{list}.options].some((option) => option.value === {value:?})"));
        self.open_list(list);
        let steps = self.value(&format!(
            "[...{list}.options].findIndex((option) => option.value === {value:?}) - {list}.selectedIndex"
        ));
        let steps = steps.as_i64().unwrap();
        for _ in 0..steps.abs() {
            self.press(if steps > 0 { "ArrowDown" } else { "ArrowUp" });
        }
        self.pause();
        self.press("Enter");
        self.wait_until(&format!("!{list}.matches(':open')"));
    }

    /// Clicks a list until it is open. It closes by itself when the page moves it.
    fn open_list(&mut self, list: &str) {
        let end = Instant::now() + self.patience;
        loop {
            self.click_on(list);
            for _ in 0..LOOKS_AT_A_PAGE {
                if self.value(&format!("{list}?.matches(':open')")) == true {
                    return;
                }
                self.pause();
            }
            assert!(Instant::now() < end, "{list} does not open");
        }
    }

    /// Takes hold of a slider and drags it to a value, without letting go. Returns the place for [`Self::let_go`].
    pub fn hold(&mut self, slider: &str, value: f64) -> [f64; 2] {
        let [_, y] = self.place(slider);
        let now = self.value(&format!(
            "(({{ x, width }}, {{ min, max, value }}) => [x, width, min, max, value].map(Number))\
             ({slider}.getBoundingClientRect(), {slider})"
        ));
        let [left, width, min, max, now]: [f64; 5] = serde_json::from_value(now).unwrap();
        let at = |value: f64| left + THUMB_PX / 2.0 + (value - min) / (max - min) * (width - THUMB_PX);
        self.touch(Touch::Down, [at(now), y]);
        for step in 1..=STEPS_OF_A_DRAG {
            self.pause();
            let part = f64::from(step) / f64::from(STEPS_OF_A_DRAG);
            self.touch(Touch::Move, [at(now + part * (value - now)), y]);
        }
        [at(value), y]
    }

    /// Lets go of what was dragged.
    pub fn let_go(&mut self, place: [f64; 2]) {
        self.touch(Touch::Up, place);
    }

    /// Drags a slider to a value. Returns whether it arrived there. A disabled slider does not.
    #[must_use]
    pub fn drag(&mut self, slider: &str, value: f64) -> bool {
        let place = self.hold(slider, value);
        self.wait_for_picture();
        let has_come = self.value(&format!("{slider}.valueAsNumber === {value}")) == true;
        self.let_go(place);
        has_come
    }

    /// Taps a slider in its middle.
    pub fn tap_middle(&mut self, slider: &str) {
        let place = self.place(slider);
        self.touch(Touch::Down, place);
        self.pause();
        self.touch(Touch::Up, place);
    }

    /// Scrolls the page with a thumb that touches an element first.
    pub fn swipe_up(&mut self, find: &str) {
        let [x, y] = self.place(find);
        self.touch(Touch::Down, [x, y]);
        for step in 1..=STEPS_OF_A_DRAG {
            self.pause();
            self.touch(Touch::Move, [x, y - 30.0 * f64::from(step)]);
        }
        self.touch(Touch::Up, [x, y]);
    }

    /// Arms the page unless it is armed, and drags a slider. Begins again if the page has disarmed, because a busy machine has
    /// delayed its heartbeat.
    pub fn drive(&mut self, slider: &str, value: f64) {
        let end = Instant::now() + self.patience;
        self.arm();
        while !self.drag(slider, value) {
            assert!(Instant::now() < end, "{slider} does not come to {value}");
            self.arm();
        }
    }

    /// Arms the page unless it is armed, on the page Servos.
    pub fn arm(&mut self) {
        if self.value("location.hash") != "#servos" {
            self.turn_to("servos");
        }
        while !self.is_armed() {
            let answers = self.answers("servos/arm");
            self.click("Arm");
            self.await_answers("servos/arm", answers + 1);
        }
    }

    pub fn is_armed(&mut self) -> bool {
        self.value(&format!("{} !== undefined", control("Disarm"))) == true
    }

    /// Moves the focus to a control with the Tab key. Returns whether it arrives there. It never arrives at a disabled control.
    #[must_use]
    pub fn tab_to(&mut self, find: &str) -> bool {
        (0..200).any(|_| {
            self.press("Tab");
            self.value(&format!("document.activeElement === {find}")) == true
        })
    }

    /// Turns to another page by its link, and waits until its heading is there. A page that is still being built may lose a click.
    pub fn turn_to(&mut self, page: &str) {
        let heading = if page == "live" {
            "!document.getElementById('stage').hidden".to_owned()
        } else {
            format!("document.querySelector('#page-{page} h2')?.checkVisibility()")
        };
        let is_there = format!(
            "Boolean(location.hash === '#{page}' && document.querySelector('nav [aria-current]')?.hash === '#{page}' && {heading})"
        );
        let end = Instant::now() + self.patience;
        loop {
            self.click_on(&element(&format!("nav a[href='#{page}']")));
            for _ in 0..LOOKS_AT_A_PAGE {
                if self.value(&is_there) == true {
                    return;
                }
                self.pause();
            }
            assert!(Instant::now() < end, "the page {page} does not come: {}", self.value("document.body.innerText"));
        }
    }

    /// Goes back to what the browser showed before.
    pub fn go_back(&mut self) {
        let history = self.call("Page.getNavigationHistory", &json!({}));
        let current = history["currentIndex"].as_u64().unwrap();
        let entry = history["entries"][usize::try_from(current).unwrap() - 1]["id"].clone();
        self.call("Page.navigateToHistoryEntry", &json!({"entryId": entry}));
    }

    /// Waits until all changes of the settings' draft so far are made: changes are made in order, and it waits for an empty one.
    pub fn settle(&mut self) {
        self.value("import('./draft.js').then(({ change }) => change({})).then(() => 1)");
        self.wait_for_picture();
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

    /// The errors of the page: exceptions, and what went to its console as an error. A busy machine may delay a page's heartbeat
    /// so long that the console ends its drive and refuses the next line. The page reports that to the user; it is no error.
    pub fn errors(&self) -> Vec<Value> {
        let mut errors = self.events("Runtime.exceptionThrown");
        errors.extend(self.events("Runtime.consoleAPICalled").into_iter().filter(|call| call["type"] == "error"));
        errors.extend(self.events("Log.entryAdded").into_iter().filter(|entry| entry["entry"]["level"] == "error"));
        let ends_a_drive = |error: &Value| {
            let [url, text] = ["url", "text"].map(|key| error["entry"][key].as_str().unwrap_or_default());
            url.ends_with("/servos/drive") && text.contains("409")
        };
        errors.retain(|error| !ends_a_drive(error));
        errors
    }

    /// The addresses of all requests.
    pub fn requests(&self) -> Vec<String> {
        let requests = self.events("Network.requestWillBeSent");
        requests.iter().map(|event| event["request"]["url"].as_str().unwrap().to_owned()).collect()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Touch {
    Down,
    Move,
    Up,
    Away,
}

/// The number by which browsers tell keys apart that give no text.
fn virtual_key(key: &str) -> u32 {
    match key {
        "Backspace" => 8,
        "Tab" => 9,
        "Enter" => 13,
        "Escape" => 27,
        " " => 32,
        "ArrowLeft" => 37,
        "ArrowUp" => 38,
        "ArrowRight" => 39,
        "ArrowDown" => 40,
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
