//! The pages of a console in a real browser, with a service that speaks the contract of the control socket.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    net::IpAddr,
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};

use common::{
    browser::{Browser, control, element, labelled, or_arm},
    eventually, packet,
    service::{Console, Seen, elsewhere},
    skip,
};
use facewire_packet::control::{Refusal, Take};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

const SETTINGS: &str = "# My head\n[camera]\nfps = 60 # fast\n\n[[link]]\nkind = \"maestro\"\n\n[[link.channel]]\nchannel = 0\n\
                        sources = { jawOpen = 1.0 }\npulse_at_0_us = 1100 # jaw shut\npulse_at_1_us = 1900\n\n\
                        [[link.channel]]\nchannel = 3\n";
const PAGES: [&str; 7] = ["live", "start", "servos", "wearer", "links", "health", "recordings"];
/// Pictures within which a page scrolls to where its focus is.
const PICTURES_TO_SCROLL: u32 = 10;
/// How often the Tab key goes around a page whose controls come late.
const MOST_ROUNDS: u32 = 5;
const PHONE: (u32, u32) = (360, 740);
const DESK: (u32, u32) = (1280, 900);
const SLIDER: &str = "[aria-label='Move channel 0']";

/// A console with a page that is open in a browser, or `None` with a note if there is no browser.
fn open(page: &str, size: (u32, u32)) -> Option<(Console, Browser)> {
    open_in(Browser::start, SETTINGS, page, size)
}

/// As [`open`], in the browser that `start` starts, with these settings.
fn open_in(
    start: fn(u32, u32) -> Browser,
    settings: &str,
    page: &str,
    (width, height): (u32, u32),
) -> Option<(Console, Browser)> {
    if !Browser::is_installed() {
        skip("there is no chromium; scripts/setup tests installs it");
        return None;
    }
    let console = Console::start(settings);
    let mut browser = start(width, height);
    browser.open(&url(&console, [127, 0, 0, 1].into(), page));
    browser.wait_until("document.getElementById('stop')?.disabled === false");
    Some((console, browser))
}

fn url(console: &Console, address: IpAddr, page: &str) -> String {
    format!("http://{address}:{}/#{page}", console.port())
}

/// Waits for the number of requests of this kind that the service has seen.
fn until_asked(console: &Console, request: &Value) {
    console.service.until(|seen| seen.requests.contains(request));
}

/// Whether all drives have ended.
fn have_ended(seen: &Seen) -> bool {
    seen.ended.len() == seen.requests.iter().filter(|request| request["do"] == "drive").count()
}

/// Presses STOP until it succeeds. A busy machine may delay the answer of the service for longer than the console waits for it.
fn stop(browser: &mut Browser) {
    eventually("a STOP that succeeds", || {
        let answers = browser.answers("servos/release");
        browser.click("STOP");
        browser.await_answers("servos/release", answers + 1);
        browser.value("document.body.innerText.includes('not released')") == false
    });
}

/// Presses a button of an armed page until the service has seen the effect. The page may have disarmed meanwhile.
fn press_armed(console: &Console, browser: &mut Browser, button: &str, fits: impl Fn(&Seen) -> bool) {
    eventually(button, || {
        browser.click_on(&or_arm(button));
        browser.wait_for_picture();
        fits(&console.service.seen.lock().unwrap())
    });
}

/// Drags a slider to a value until the service has seen the effect. The page may have disarmed before it sent the last position.
fn drive_until(console: &Console, browser: &mut Browser, slider: &str, value: f64, fits: impl Fn(&Seen) -> bool) {
    eventually(slider, || {
        browser.drive(slider, value);
        browser.await_statuses(browser.statuses() + 2);
        fits(&console.service.seen.lock().unwrap())
    });
}

/// Drags the slider of channel 0 to a value and sets an end or the rest there, until the draft has this line. The page may have
/// disarmed meanwhile, and then sets nothing.
fn set_here(browser: &mut Browser, value: f64, button: &str, line: &str) {
    let is_set = format!("import('./draft.js').then(({{ draft }}) => draft.text.includes({line:?}))");
    eventually(line, || {
        browser.drive(&element(SLIDER), value);
        browser.click_on(&or_arm(button));
        browser.settle();
        browser.value(&is_set) == true
    });
}

/// The reader of pages for people who cannot see them: finds what they could not use.
fn axe() -> Option<String> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(Path::new(&std::env::var_os("HOME")?).join(".cache")))?;
    std::fs::read_to_string(cache.join("facewire/axe/node_modules/axe-core/axe.min.js")).ok()
}

/// Opens a page, and waits until it shows what it has asked of the console.
fn turn_to(browser: &mut Browser, page: &str) {
    browser.turn_to(page);
    // Every page but the first waits for an answer of the console.
    browser.wait_until("document.querySelector('main > section:not([hidden])').innerText.length > 60");
    browser.wait_until("document.getElementById('state').textContent === 'live'");
    if page == "health" {
        // The plots come with an answer of their own.
        browser.wait_for_text("Stage");
    }
}

/// Opens every page at this size. Each fits, has STOP in sight, and is open to everybody.
fn look_at_every_page(size: (u32, u32), device: &str) {
    let Some((console, mut browser)) = open_in(Browser::with_face, SETTINGS, "live", size) else { return };
    let axe = axe();
    if axe.is_none() {
        skip("there is no axe-core; scripts/setup tests installs it");
    }
    let home = url(&console, [127, 0, 0, 1].into(), "");
    for page in PAGES {
        turn_to(&mut browser, page);
        browser.screenshot(&format!("{page} on a {device}"));
        let excess =
            browser.value("(({ scrollWidth, clientWidth }) => scrollWidth - clientWidth)(document.documentElement)");
        assert_eq!(excess, 0, "{page} on a {device}");
        let stop = browser.value(
            "document.elementFromPoint(...(({ x, y, width, height }) => \
            [x + width / 2, y + height / 2])(document.getElementById('stop').getBoundingClientRect())).id",
        );
        assert_eq!(stop, "stop", "{page} on a {device}");
        let cut = "[...document.querySelectorAll('dd, dt')].filter((it) => it.checkVisibility() && it.scrollWidth > it.clientWidth).map((it) => it.innerText)";
        assert_eq!(browser.value(cut), json!([]), "tiles that are cut: {page} on a {device}");
        if let Some(axe) = &axe {
            browser.value(&format!("{axe}; 0"));
            let found = browser.value(
                "axe.run({ resultTypes: ['violations'] }).then(({ violations }) => violations.map(({ id, nodes }) => \
                 [id, ...nodes.map(({ target, failureSummary }) => `${target}: ${failureSummary}`)]))",
            );
            assert_eq!(found, json!([]), "{page} on a {device}");
        }
    }
    assert_eq!(browser.errors(), Vec::<Value>::new());
    let requests = browser.requests();
    let home = home.trim_end_matches('#');
    assert!(requests.iter().all(|url| url.starts_with(home) || url.starts_with("blob:")), "{requests:?}");
}

#[test]
fn every_page_fits_a_phone_and_is_open_to_everybody() {
    look_at_every_page(PHONE, "phone");
}

#[test]
fn every_page_fits_a_desk_and_is_open_to_everybody() {
    look_at_every_page(DESK, "desk");
}

#[test]
fn the_pages_take_at_most_200_kb_compressed() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
    let count = "find . -type f -print0 | sort -z | xargs -0 cat | gzip -9 | wc -c";
    let output = Command::new("sh").args(["-c", count]).current_dir(page).output().unwrap();
    let bytes: u32 = String::from_utf8(output.stdout).unwrap().trim().parse().unwrap();
    assert!((20_000..200_000).contains(&bytes), "{bytes} bytes");
}

#[test]
fn stop_releases_all_servos_by_click_and_by_key_until_they_may_move_again() {
    let Some((console, mut browser)) = open("health", PHONE) else { return };
    let (release, resume) = (json!({"do": "release", "on": true}), json!({"do": "release", "on": false}));
    browser.click("STOP");
    until_asked(&console, &release);
    browser.wait_for_text("All servos are released");
    browser.screenshot("released");
    browser.click("Let servos move again");
    until_asked(&console, &resume);
    browser.wait_until("!document.querySelector('.released')");
    // On another page, and by the keys.
    let count = |seen: &Seen| seen.requests.iter().filter(|request| **request == release).count();
    for (page, empty, key) in [("servos", "#page-servos h2", "Escape"), ("live", "figcaption", " ")] {
        browser.turn_to(page);
        // The link to the page has the focus, and the space bar would act on it. So put the focus elsewhere.
        browser.click_on(&element(empty));
        let before = count(&console.service.seen.lock().unwrap());
        browser.press(key);
        console.service.until(|seen| count(seen) == before + 1);
        browser.click("Let servos move again");
        browser.wait_until("!document.querySelector('.released')");
        assert_eq!(count(&console.service.seen.lock().unwrap()), before + 1, "one release for each key");
    }
}

#[test]
fn stop_does_not_wait_for_answers_that_do_not_come() {
    let Some((console, mut browser)) = open("health", PHONE) else { return };
    browser.value(
        "const real = fetch; window.fetch = async (url, options) => { const answer = await real(url, options); \
         if (url.includes('release')) window.waited = window.settled; return answer; }",
    );
    // A browser has six requests at a time under way. These begin when the hand goes down on the button. The console ends
    // requests that the service does not answer after 3 s. On a busy machine, the hand may be lifted later than that.
    eventually("a STOP that has waited for no answer", || {
        console.service.seen.lock().unwrap().is_stuck = true;
        browser.value(
            "window.settled = 0; window.waited = undefined; import('./store.js').then(({ get }) => { \
             const ask = () => { for (let n = 0; n < 12; n += 1) \
             get('landmarks?' + n).catch(() => 0).finally(() => { settled += 1; }); }; \
             addEventListener('pointerdown', ask, { capture: true, once: true }); })",
        );
        browser.click("STOP");
        until_asked(&console, &json!({"do": "release", "on": true}));
        browser.wait_until("window.waited !== undefined");
        // They are asked again behind it.
        console.service.seen.lock().unwrap().is_stuck = false;
        browser.wait_until("window.settled === 12");
        browser.value("window.waited") == 0
    });
}

/// A console with the page of an operator who has logged in from elsewhere, or `None` with a note.
fn log_in_from_elsewhere(page: &str) -> Option<(Console, Browser, IpAddr)> {
    let Some(address) = elsewhere() else {
        skip("this machine has no address besides loopback");
        return None;
    };
    let (console, mut browser) = open(page, PHONE)?;
    console.post("password", &json!({"new": "a good password"}));
    browser.open(&url(&console, address, page));
    log_in(&mut browser, "a good password");
    Some((console, browser, address))
}

fn log_in(browser: &mut Browser, password: &str) {
    browser.fill(&element("input"), password);
    browser.click("Log in");
    browser.wait_until("document.getElementById('stop')?.disabled === false");
}

#[test]
fn a_page_whose_session_ends_says_before_it_is_pressed_that_stop_does_not_work() {
    let Some((console, mut browser, address)) = log_in_from_elsewhere("health") else { return };
    let token = console.post("tokens/look", &json!({})).json()["token"].clone();
    assert_eq!(browser.value("document.body.innerText.includes('STOP does not work')"), false);
    console.post("password", &json!({"new": "another password"}));
    browser.wait_for_text(
        "STOP does not work here: this page is logged out. To stop servos, log in, or switch their supply off.",
    );
    browser.screenshot("logged out");
    log_in(&mut browser, "another password");
    browser.wait_until("!document.body.innerText.includes('STOP does not work')");
    browser.click("STOP");
    until_asked(&console, &json!({"do": "release", "on": true}));
    // Somebody opens a link to look in another tab, which changes the cookie of this page.
    let body = json!({"token": token}).to_string();
    let headers = "Content-Type: application/json\r\n";
    let looker = console.ask(address, "POST /api/1/login", headers, &body).unwrap().cookie();
    let value = looker.trim().rsplit_once('=').unwrap().1;
    let page = url(&console, address, "");
    browser.call("Network.setCookie", &json!({"name": "facewire-console", "value": value, "url": page}));
    browser.wait_for_text("STOP does not work here: this browser may only look now");
}

#[test]
fn a_new_password_is_set_with_the_old_one_and_the_page_goes_on() {
    let Some((console, mut browser, address)) = log_in_from_elsewhere("links") else { return };
    let [old, new, again] =
        ["Old password", "New password", "The same again"].map(|label| labelled("#page-links", label));
    browser.fill(&old, "a wrong password");
    browser.fill(&new, "another password");
    browser.fill(&again, "an other password");
    browser.click("Change the password");
    browser.wait_for_text("The two passwords differ");
    browser.fill(&again, "another password");
    browser.click("Change the password");
    browser.wait_for_text("The password or the token is wrong.");
    browser.fill(&old, "a good password");
    browser.click("Change the password");
    browser.wait_for_text("The password is changed.");
    browser.click("STOP");
    until_asked(&console, &json!({"do": "release", "on": true}));
    let body = json!({"password": "another password"}).to_string();
    let headers = "Content-Type: application/json\r\n";
    assert_eq!(console.ask(address, "POST /api/1/login", headers, &body).unwrap().status, 200);
    // On the board it takes no old one.
    browser.open("about:blank");
    browser.open(&url(&console, [127, 0, 0, 1].into(), "links"));
    browser.wait_for_text("New password");
    assert_eq!(browser.value(&format!("Boolean({old})")), false);
}

#[test]
fn a_stop_that_has_failed_is_told_until_one_succeeds_on_the_login_form_too() {
    let Some((console, mut browser, _)) = log_in_from_elsewhere("health") else { return };
    console.service.seen.lock().unwrap().refusal = Some(("release", "the line is cut."));
    browser.click("STOP");
    let told = "The servos were not released: the line is cut. Switch their supply off.";
    browser.wait_for_text(told);
    browser.turn_to("wearer");
    browser.wait_for_text(told);
    console.post("password", &json!({"new": "another password"}));
    browser.wait_until("document.querySelector('.login')");
    browser.wait_for_text(told);
    browser.screenshot("stop failed");
    log_in(&mut browser, "another password");
    browser.wait_for_text(told);
    console.service.seen.lock().unwrap().refusal = None;
    stop(&mut browser);
}

#[test]
fn a_console_that_falls_silent_is_told_and_so_is_a_stop_that_it_does_not_answer() {
    let Some((console, mut browser)) = open("health", PHONE) else { return };
    browser.wait_until("document.getElementById('state').textContent === 'live'");
    let pid = Pid::from_raw(console.viewer.pid().try_into().unwrap()).unwrap();
    kill_process(pid, Signal::STOP).unwrap();
    browser.wait_for_text("STOP does not work here: the console is silent. To stop servos, switch their supply off.");
    browser.click("STOP");
    browser.wait_for_text("The servos were not released: The console does not answer.");
    browser.screenshot("silent");
    kill_process(pid, Signal::CONT).unwrap();
    browser.wait_until("!document.body.innerText.includes('STOP does not work')");
    stop(&mut browser);
}

/// Reaches every control of every page at this size by the Tab key.
fn tab_through_every_page(size: (u32, u32)) {
    let Some((_console, mut browser)) = open("live", size) else { return };
    for page in PAGES {
        turn_to(&mut browser, page);
        // Tab reaches one radio button of each group.
        browser.value(
            "window.controls = () => [...document.querySelectorAll('a, button:enabled, input:enabled, select:enabled, \
             textarea, summary, [tabindex=\"0\"]')].filter((control) => control.checkVisibility()); \
             window.reached = new Set(); \
             window.missed = () => controls().filter((control) => !reached.has(control) && control.type !== 'radio'); 0",
        );
        // Controls that come while the others are gone through are reached in the next round.
        for _ in 0..MOST_ROUNDS {
            tab_once_around(&mut browser, &format!("{page} at {size:?}"));
            if browser.value("missed().length") == 0 {
                break;
            }
        }
        let missed = browser.value("missed().map((control) => control.outerHTML.slice(0, 120))");
        assert_eq!(missed, json!([]), "{page} at {size:?}");
    }
}

/// Presses the Tab key for each control, and some more times. Whoever tabs sees where the focus is: it has an outline, and
/// neither bar lies over it.
fn tab_once_around(browser: &mut Browser, place: &str) {
    let look = "(() => { const at = document.activeElement; if (at === document.body) return ''; \
        reached.add(at); const { outlineStyle } = getComputedStyle(at); \
        const { x, y, width, height } = at.getBoundingClientRect(); \
        const top = document.elementFromPoint(x + width / 2, y + Math.min(height, innerHeight) / 2); \
        const isSeen = outlineStyle !== 'none' && (at.contains(top) || top?.contains(at)); \
        return isSeen ? '' : `${at.outerHTML.slice(0, 100)} has the outline ${outlineStyle} and lies below ${top?.outerHTML.slice(0, 60)}`; })()";
    let most = browser.value("controls().length").as_u64().unwrap() + 20;
    for _ in 0..most {
        browser.press("Tab");
        let mut fault = browser.value(look);
        // A page that has just grown scrolls to the focus with its next pictures.
        for _ in 0..PICTURES_TO_SCROLL {
            if fault == "" {
                break;
            }
            browser.wait_for_picture();
            fault = browser.value(look);
        }
        assert_eq!(fault, "", "{place}");
    }
}

#[test]
fn every_control_of_every_page_is_reached_and_seen_by_the_tab_key_alone_on_a_phone() {
    tab_through_every_page(PHONE);
}

#[test]
fn every_control_of_every_page_is_reached_and_seen_by_the_tab_key_alone_on_a_desk() {
    tab_through_every_page(DESK);
}

#[test]
fn keys_that_type_or_work_a_control_do_not_stop() {
    let Some((console, mut browser)) = open("wearer", DESK) else { return };
    browser.click_on(&element("#page-wearer input"));
    browser.press(" ");
    browser.press("Escape");
    browser.turn_to("wearer");
    browser.press(" ");
    browser.press("Tab");
    browser.press("Enter");
    browser.wait_until("location.hash === '#links'");
    assert_eq!(console.service.changes(), Vec::<Value>::new());
}

#[test]
fn a_slider_moves_a_servo_only_while_armed_and_a_page_that_is_closed_lets_go() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    browser.wait_until(&format!("document.querySelector(\"{SLIDER}\")?.disabled"));
    assert!(!browser.drag(&element(SLIDER), 0.9), "a slider moves before arming");
    assert_eq!(console.service.changes(), Vec::<Value>::new());
    let moved = json!({"link": 0, "channel": 0, "position": 0.25});
    drive_until(&console, &mut browser, &element(SLIDER), 0.25, |seen| {
        seen.lines.iter().any(|(_, line)| *line == moved)
    });
    browser.wait_until("document.querySelector('.numbers').innerText.includes('0.25')");
    browser.screenshot("armed");
    // The arrow keys move it, too.
    let has_stepped = |seen: &Seen| {
        seen.lines.iter().any(|(_, line)| (0.254..0.256).contains(&line["position"].as_f64().unwrap_or(0.0)))
    };
    eventually("a step by a key", || {
        browser.drive(&element(SLIDER), 0.0);
        browser.drive(&element(SLIDER), 0.25);
        if browser.tab_to(&element(SLIDER)) {
            browser.press("ArrowRight");
        }
        browser.await_statuses(browser.statuses() + 2);
        has_stepped(&console.service.seen.lock().unwrap())
    });
    // The heartbeat goes on while nothing moves. It is counted anew after a busy machine has ended the drive.
    let counts = || {
        let seen = console.service.seen.lock().unwrap();
        let drives = seen.requests.iter().filter(|request| request["do"] == "drive").count();
        (drives, seen.lines.len())
    };
    let mut begun = counts();
    eventually("the heartbeat", || {
        browser.arm();
        let now = counts();
        if now.0 != begun.0 {
            begun = now;
        }
        now.1 > begun.1 + 5
    });
    drop(browser);
    console.service.until(have_ended);
    let lines = &console.service.seen.lock().unwrap().lines;
    assert!(lines.iter().all(|(_, line)| line["position"].as_f64() < Some(0.51)), "moved before arming: {lines:?}");
}

#[test]
fn a_servo_is_moved_by_hand_while_all_are_released_before_the_face_ever_moves_it_and_stop_ends_that() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    browser.click("STOP");
    browser.wait_for_text("All servos are released");
    eventually("one servo has pulses", || {
        browser.drive(&element(SLIDER), 0.25);
        browser.await_statuses(browser.statuses() + 2);
        browser.value("[...document.querySelectorAll('.numbers')].map(({ innerText }) => /pulse (.*)/s.exec(innerText)[1].trim()).join()")
            == "1300 µs,none: no pulses"
    });
    browser.screenshot("a released servo in the hand");
    eventually("a servo that is moved by hand", || {
        browser.drive(&element(SLIDER), 0.5);
        browser.await_statuses(browser.statuses() + 2);
        let sentences =
            ["A slider moves its servo, and all others stay as STOP has left them.", "a servo is moved by hand"];
        let shown = browser.value("document.body.innerText");
        sentences.iter().all(|sentence| shown.as_str().unwrap().contains(sentence))
    });
    browser.click("STOP");
    console.service.until(have_ended);
    browser.wait_until(&format!("{}.disabled", element(SLIDER)));
    browser.wait_until("!document.body.innerText.includes('a servo is moved by hand')");
    browser.wait_for_text("All servos are released");
    let changes = console.service.changes();
    assert!(changes.iter().all(|change| change["do"] == "drive" || change["on"] == true), "{changes:?}");
}

#[test]
fn a_bus_servo_shows_where_it_is_measured_its_volts_its_temperature_and_its_load_and_others_what_is_computed() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    let numbers = "[...document.querySelectorAll('.numbers')].map(({ innerText }) => innerText.split(/\\s+/).join(' ')).join('|')";
    browser.wait_until(&format!(
        "{numbers} === 'wanted 0.50 computed 0.50 pulse 1500 µs|wanted 0.50 computed 0.50 pulse 1500 µs'"
    ));
    console.service.seen.lock().unwrap().health = json!({"measured": 0.42, "volts": 7.4, "celsius": 31.0, "load": 0.0});
    browser.wait_until(&format!(
        "{numbers} === 'wanted 0.50 computed 0.50 pulse 1500 µs|wanted 0.50 is 0.42 pulse 1420 µs|7.4 V 31 °C 0 % load'"
    ));
    for (width, height) in [PHONE, DESK] {
        browser.resize(width, height);
        browser.value("document.querySelector('[aria-label=\"Channel 3\"]').scrollIntoView({ block: 'center' })");
        browser.screenshot(&format!("a measured servo at {width}"));
    }
}

#[test]
fn a_servo_is_named_in_its_card_and_every_control_of_the_card_calls_it_so() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    browser.click("Ends, speed and more");
    let name = |card: &str| labelled(&format!("[aria-label='{card}']"), "Name");
    browser.select_all(&name("Channel 0"));
    browser.type_through_statuses("left brow");
    browser.press("Enter");
    browser.wait_for_text("Channel 0 (left brow)");
    let labels = "[...document.querySelectorAll('[aria-label=\"Channel 0 (left brow)\"] [aria-label]')].map((it) => it.ariaLabel)";
    assert_eq!(
        browser.value(&format!("{labels}.filter((label) => !label.endsWith('channel 0 (left brow)'))")),
        json!([])
    );
    browser.screenshot("a named servo");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let named = SETTINGS.replace("pulse_at_1_us = 1900\n", "pulse_at_1_us = 1900\nname = \"left brow\"\n");
    assert_eq!(console.settings(), named);
    browser.select_all(&name("Channel 0 (left brow)"));
    browser.press("Backspace");
    browser.press("Tab");
    browser.wait_for_text("1 setting is changed");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings(), SETTINGS);
}

#[test]
fn other_boards_follow_the_face_while_one_is_armed_only_if_that_is_ticked() {
    let boards = [SETTINGS, "\n[[link]]\nkind = \"pca9685\"\n"].concat();
    let Some((console, mut browser)) = open_in(Browser::start, &boards, "servos", PHONE) else { return };
    browser.arm();
    until_asked(&console, &json!({"do": "drive"}));
    eventually("the end of the drive", || {
        if browser.is_armed() {
            browser.click_on(&or_arm("Disarm"));
        }
        !browser.is_armed()
    });
    console.service.until(have_ended);
    browser.click_on("document.querySelector('#others input')");
    browser.screenshot("two boards");
    browser.arm();
    until_asked(&console, &json!({"do": "drive", "others_follow": true}));
}

#[test]
fn another_page_and_the_disarm_button_end_a_drive() {
    let Some((console, mut browser)) = open("servos", DESK) else { return };
    browser.arm();
    browser.click_on(&or_arm("Disarm"));
    eventually("the end of the drive", || {
        if browser.is_armed() {
            browser.click_on(&or_arm("Disarm"));
        }
        have_ended(&console.service.seen.lock().unwrap())
    });
    browser.arm();
    browser.turn_to("health");
    console.service.until(have_ended);
}

#[test]
fn the_puppet_and_its_plays_move_coefficients_and_the_head() {
    let Some((console, mut browser)) = open("servos", DESK) else { return };
    press_armed(&console, &mut browser, "Blink", |seen| {
        seen.lines.iter().any(|(_, line)| line["coefficients"]["eyeBlinkLeft"].as_f64() > Some(0.7))
    });
    browser.wait_until("document.querySelector('#puppet [role=status]').textContent === ''");
    drive_until(&console, &mut browser, &element("#puppet input"), 20.0, |seen| {
        seen.lines.iter().any(|(_, line)| line["head_deg"] == json!([20.0, 0.0, 0.0]))
    });
    let question = "document.querySelector('[role=alertdialog]') !== null";
    let ends = |seen: &Seen, number: u32| {
        seen.lines.iter().any(|(_, line)| line["channel"] == number && line["position"].as_f64() > Some(0.9))
    };
    // A sweep takes 6.5 s for each channel, in which a busy machine may end the drive. So its steps come at five times their
    // pace.
    browser.value(
        "const waits = setTimeout; \
         window.hastened = 0; \
         const hasten = (ms) => { \
             if (ms !== 50) return ms; \
             hastened += 1; \
             return 10; \
         }; \
         window.setTimeout = (call, ms, ...more) => waits(call, hasten(ms), ...more); 0",
    );
    eventually("a sweep", || {
        browser.click_on(&or_arm("Sweep each channel"));
        browser.wait_for_picture();
        if browser.value(question) == true {
            browser.screenshot("the question before a sweep");
            browser.click_on(&or_arm("Sweep now"));
            browser.wait_until("document.querySelector('#puppet [role=status]')?.textContent === ''");
        }
        let seen = console.service.seen.lock().unwrap();
        [0, 3].into_iter().all(|number| ends(&seen, number))
    });
    assert!(browser.value("hastened").as_u64() > Some(100), "the steps of a sweep have another length");
}

#[test]
fn a_sweep_asks_first_and_whoever_leaves_it_moves_nothing() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    eventually("the question", || {
        browser.click_on(&or_arm("Sweep each channel"));
        browser.wait_for_picture();
        browser.value("document.querySelector('[role=alertdialog]') !== null") == true
    });
    browser.screenshot("the question before a sweep on a phone");
    browser.click_on(&or_arm("Leave it"));
    browser.await_statuses(browser.statuses() + 2);
    let seen = console.service.seen.lock().unwrap();
    assert!(seen.lines.iter().all(|(_, line)| line["position"].is_null()), "{:?}", seen.lines);
}

#[test]
fn ends_and_rest_are_set_where_the_servo_is_and_kept_with_the_comments() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    set_here(&mut browser, 0.25, "Set end 0 here", "pulse_at_0_us = 1300");
    browser.wait_for_text("1 setting is changed and not kept yet");
    browser.click("Difference");
    browser.wait_for_text("Pulse at end 0: 1300");
    browser.wait_for_text("+ pulse_at_0_us = 1300 # jaw shut");
    browser.screenshot("difference");
    // The service does not know the new end yet, and moves between those of the file.
    set_here(&mut browser, 0.75, "Set end 1 here", "pulse_at_1_us = 1700");
    set_here(&mut browser, 0.375, "Set rest here", "neutral = 0.25");
    browser.wait_for_text("3 settings are changed");
    assert_eq!(console.settings(), SETTINGS);
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let kept = SETTINGS.replace("1100", "1300").replace("1900\n", "1700\nneutral = 0.25\n");
    assert_eq!(console.settings(), kept);
    until_asked(&console, &json!({"do": "reload"}));
}

/// The value that a field shows.
fn shown(browser: &mut Browser, field: &str) -> Value {
    browser.value(&format!("{field}.value"))
}

#[test]
fn a_setting_keeps_what_is_typed_key_by_key_while_statuses_come() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    let camera = "/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920-video-index0";
    let device = element("[id='field-camera.device']");
    let fps = element("[id='field-camera.fps']");
    browser.click("Camera");
    browser.select_all(&device);
    browser.type_through_statuses(camera);
    assert_eq!(shown(&mut browser, &device), camera);
    browser.press("Tab");
    browser.wait_for_text("1 setting is changed and not kept yet");
    browser.select_all(&fps);
    browser.type_through_statuses("120");
    browser.press("Enter");
    browser.wait_for_text("2 settings are changed and not kept yet");
    // Escape discards what was typed, and does not release the servos.
    browser.fill(&fps, "7");
    browser.press("Escape");
    assert_eq!(shown(&mut browser, &fps), "120");
    // A number out of bounds, or a text that is no number, stays until it is corrected, and the page says what is wrong.
    for (wrong, kept) in [("999", "999"), ("-", "")] {
        browser.fill(&fps, wrong);
        browser.press("Tab");
        browser.wait_for_text("Give a whole number from 1 to 240.");
        browser.await_statuses(browser.statuses() + 2);
        assert_eq!(shown(&mut browser, &fps), kept);
        assert_eq!(browser.value(&format!("{fps}.getAttribute('aria-invalid')")), "true");
    }
    browser.screenshot("no such number");
    browser.fill(&fps, "24");
    browser.press("Tab");
    browser.wait_until("!document.body.innerText.includes('Give a whole number')");
    let format = element("[id='field-camera.format']");
    browser.choose(&format, "mjpeg");
    browser.wait_for_text("3 settings are changed and not kept yet");
    let mirror = element("[id='field-adjust.mirror']");
    browser.click("Adjustments");
    browser.click_on(&mirror);
    browser.wait_for_text("4 settings are changed and not kept yet");
    browser.await_statuses(browser.statuses() + 1);
    assert_eq!(browser.value(&format!("[{format}.value, {mirror}.checked]")), json!(["mjpeg", true]));
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(
        console.settings(),
        SETTINGS.replace("60", "24").replace("# fast", &format!("# fast\ndevice = \"{camera}\"\nformat = \"mjpeg\""))
            + "\n[adjust]\nmirror = true\n"
    );
    let asked = console.service.changes();
    assert!(asked.iter().all(|request| request["do"] == "reload"), "{asked:?}");
}

#[test]
fn a_camera_is_chosen_by_a_tap_and_by_the_arrow_keys() {
    let Some((console, mut browser)) = open("start", PHONE) else { return };
    let [first, webcam] = [0, 1].map(|index| format!("document.querySelectorAll('.choice input')[{index}]"));
    browser.click_on(&webcam);
    browser.wait_for_text("1 setting is changed and not kept yet");
    browser.press("ArrowUp");
    browser.press("ArrowDown");
    browser.settle();
    browser.await_statuses(browser.statuses() + 1);
    assert_eq!(browser.value(&format!("[{first}.checked, {webcam}.checked]")), json!([false, true]));
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert!(console.settings().contains("device = \"/dev/video0\""), "{}", console.settings());
}

#[test]
fn the_address_of_a_receiver_is_typed_and_sent_to() {
    let Some((console, mut browser)) = open("start", PHONE) else { return };
    browser.click("Next");
    browser.click("Next");
    browser.click("VRChat");
    browser.click_on(&labelled("details[open]", "Its address"));
    browser.type_through_statuses("192.168.1.20");
    browser.click_on(&element("[aria-label='Send there, to VRChat']"));
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let link = "\n[[link]]\naddress = \"192.168.1.20:9000\"\nkind = \"vrchat\"\n";
    assert_eq!(console.settings(), format!("{SETTINGS}{link}"));
}

#[test]
fn what_cannot_be_kept_stays_in_its_field_and_says_why() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    let fps = element("[id='field-camera.fps']");
    browser.click("Camera");
    drop(console);
    browser.wait_for_text("The connection is lost");
    browser.fill(&fps, "50");
    browser.press("Enter");
    browser.wait_for_text("The console does not answer.");
    assert_eq!(shown(&mut browser, &fps), "50");
    browser.press("Escape");
    browser.wait_until("!document.body.innerText.includes('The console does not answer.')");
    assert_eq!(shown(&mut browser, &fps), "60");
}

#[test]
fn what_was_typed_is_there_when_its_page_was_left_and_comes_back() {
    let Some((_console, mut browser)) = open("links", PHONE) else { return };
    let fps = element("[id='field-camera.fps']");
    browser.turn_to("health");
    browser.turn_to("links");
    browser.click("Camera");
    // The link takes the focus from the field. Going back, below, removes the field itself.
    browser.fill(&fps, "50");
    browser.turn_to("servos");
    browser.go_back();
    browser.click("Camera");
    browser.wait_until(&format!("{fps}.value === '50'"));
    browser.fill(&fps, "40");
    browser.go_back();
    browser.wait_until("location.hash === '#health'");
    browser.turn_to("links");
    browser.click("Camera");
    browser.wait_until(&format!("{fps}.value === '40'"));
    browser.screenshot("came back");
}

#[test]
fn the_numbers_and_lists_of_a_servo_keep_what_a_hand_puts_in_and_show_what_changes_elsewhere() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    let card = "[aria-label='Channel 0']";
    let [end_0, end_1] = ["Pulse at end 0", "Pulse at end 1"].map(|label| labelled(card, label));
    browser.click("Ends, speed and more");
    browser.select_all(&end_0);
    browser.type_through_statuses("1250");
    assert_eq!(shown(&mut browser, &end_0), "1250");
    browser.press("Enter");
    browser.wait_for_text("1 setting is changed");
    let loss = labelled(card, "Without a face");
    browser.choose(&loss, "release");
    browser.await_statuses(browser.statuses() + 2);
    assert_eq!(shown(&mut browser, &loss), "release");
    // An end that the slider sets shows up in its field, unless somebody types there.
    set_here(&mut browser, 0.75, "Set end 1 here", "pulse_at_1_us = 1700");
    browser.wait_for_text("3 settings are changed");
    assert_eq!(shown(&mut browser, &end_1), "1700");
    let factor = labelled(card, "jawOpen times");
    browser.select_all(&factor);
    browser.type_through_statuses("0.75");
    browser.screenshot("a servo in the hand");
    browser.press("Tab");
    browser.wait_for_text("4 settings are changed");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let kept = SETTINGS.replace("1100", "1250").replace("1900\n", "1700\nloss = \"release\"\n").replace("1.0", "0.75");
    assert_eq!(console.settings(), kept);
}

#[test]
fn a_new_channel_of_every_board_begins_close_to_its_middle_and_slowly_and_is_widened_by_hand() {
    let pulses = ["pulse_at_0_us = 1450\npulse_at_1_us = 1550\n"; 4];
    let kinds = ["kind = \"maestro\"", "kind = \"pca9685\"", "kind = \"sacn\"", "kind = \"artnet\""];
    let bus = |family, unit| format!("kind = \"bus-servo\"\nfamily = \"{family}\"\nunit = \"{unit}\"");
    let [steps, degrees] = [bus("feetech-scs", "steps"), bus("dynamixel-x", "degrees")];
    let boards: Vec<(&str, &str)> = kinds
        .into_iter()
        .zip(pulses)
        .chain([
            (&*steps, "position_at_0 = 497\nposition_at_1 = 527\n"),
            (&*degrees, "position_at_0 = 175\nposition_at_1 = 185\n"),
        ])
        .collect();
    let links: String = boards.iter().map(|(board, _)| format!("[[link]]\n{board}\n\n")).collect();
    let Some((console, mut browser)) = open_in(Browser::start, &links, "servos", PHONE) else { return };
    let board = |index: usize| format!("document.querySelectorAll('.board')[{index}]");
    browser.wait_until(&board(5));
    for index in 0..boards.len() {
        browser.click_on(&format!("[...{}.querySelectorAll('button')].at(-1)", board(index)));
        browser.wait_until(&format!("{}.querySelector('.channel')", board(index)));
    }
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let numbers = [0, 0, 1, 1, 1, 1];
    let link = |((board, ends), number): (&(&str, &str), u32)| {
        format!("[[link]]\n{board}\n\n[[link.channel]]\nchannel = {number}\n{ends}sources = {{}}\nspeed_per_s = 0.5\n")
    };
    let kept: Vec<String> = boards.iter().zip(numbers).map(link).collect();
    assert_eq!(
        console.settings().split_whitespace().collect::<Vec<_>>(),
        kept.concat().split_whitespace().collect::<Vec<_>>()
    );
    browser.click("Ends, speed and more");
    let card = "[aria-label='Channel 0']";
    let [end, speed] = ["Pulse at end 1", "Highest speed"].map(|label| labelled(card, label));
    assert_eq!([shown(&mut browser, &end), shown(&mut browser, &speed)], ["1550", "0.5"]);
    browser.screenshot("a new servo");
    browser.select_all(&end);
    browser.type_through_statuses("1800");
    browser.press("Enter");
    browser.wait_for_text("1 setting is changed");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert!(console.settings().contains("pulse_at_1_us = 1800"), "{}", console.settings());
}

#[test]
fn keys_that_go_through_the_list_of_sources_add_none_until_it_is_added() {
    let Some((console, mut browser)) = open("servos", DESK) else { return };
    let list = labelled("[aria-label='Channel 3']", "Add from the list");
    browser.click_on(&list);
    browser.press("Escape");
    browser.wait_until(&format!("!{list}.matches(':open')"));
    for key in ["b", "ArrowDown", "ArrowDown"] {
        browser.press(key);
        browser.await_statuses(browser.statuses() + 2);
    }
    assert_eq!(shown(&mut browser, &list), "browInnerUp");
    assert_eq!(browser.value("document.getElementById('draft')"), Value::Null);
    browser.click_on(&element("[aria-label='Add browInnerUp to channel 3']"));
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings(), SETTINGS.replace("channel = 3\n", "channel = 3\nsources = { browInnerUp = 1 }\n"));
}

#[test]
fn a_slider_stays_in_the_hand_while_its_servo_moves() {
    let Some((console, mut browser)) = open("servos", DESK) else { return };
    let slider = element(SLIDER);
    let is_shown = |value: f64| format!("{slider}.valueAsNumber === {value}");
    let turn = |position: f64| {
        let line = json!({"channel": 0, "position": position});
        console.service.seen.lock().unwrap().lines.push((Instant::now(), line));
    };
    loop {
        turn(0.5);
        browser.arm();
        browser.wait_until(&is_shown(0.5));
        let place = browser.hold(&slider, 0.5);
        turn(0.9);
        browser.wait_for_text("computed 0.90");
        let now = browser.value(&format!("[!{slider}.disabled, {}]", is_shown(0.5)));
        browser.let_go(place);
        browser.wait_until(&is_shown(0.9));
        // A busy machine may delay the heartbeat of the page, which then disarms.
        if now[0] == true {
            assert_eq!(now[1], true, "it slips out of the hand");
            break;
        }
    }
    // A slider that is disabled while it is held shows the position of its servo again.
    browser.drive(&slider, 0.25);
    let place = browser.hold(&slider, 0.75);
    browser.press("Escape");
    browser.wait_until(&format!("{slider}.disabled"));
    browser.let_go(place);
    console.service.until(have_ended);
    turn(0.1);
    browser.wait_until(&is_shown(0.1));
    // Nobody can take hold of it until the page is armed again.
    assert!(!browser.drag(&slider, 0.75), "it is disabled and moves");
    turn(0.2);
    browser.wait_until(&is_shown(0.2));
}

#[test]
fn a_thumb_that_scrolls_the_page_over_a_slider_moves_no_servo() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    let positions =
        |seen: &Seen| -> Vec<f64> { seen.lines.iter().filter_map(|(_, line)| line["position"].as_f64()).collect() };
    let is_at = |at: f64| move |seen: &Seen| positions(seen).last() == Some(&at);
    drive_until(&console, &mut browser, &element(SLIDER), 0.25, is_at(0.25));
    let before = positions(&console.service.seen.lock().unwrap()).len();
    let height = browser.value("scrollY");
    eventually("a page that scrolls", || {
        browser.swipe_up(&element(SLIDER));
        browser.wait_for_picture();
        browser.value(&format!("scrollY > {height}")) == true
    });
    drive_until(&console, &mut browser, &element(SLIDER), 0.0, is_at(0.0));
    let moved = positions(&console.service.seen.lock().unwrap());
    assert!(moved[before..].iter().all(|position| *position <= 0.25), "{moved:?}");
    // A tap moves the servo.
    eventually("a tap that moves", || {
        browser.arm();
        browser.tap_middle(&element(SLIDER));
        browser.await_statuses(browser.statuses() + 2);
        is_at(0.5)(&console.service.seen.lock().unwrap())
    });
}

#[test]
fn letters_that_are_typed_while_a_text_is_judged_stay() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    let judging = console.folder.path().join("judging");
    browser.click("Text");
    let text = element("textarea");
    browser.select_all(&text);
    // The program judges no text before this file goes away.
    std::fs::write(&judging, "").unwrap();
    for word in ["# one", " two", " three"] {
        browser.type_text(word);
        browser.think();
    }
    browser.type_text(" fo");
    std::fs::remove_file(&judging).unwrap();
    browser.type_text("ur");
    browser.wait_for_text("not kept yet");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings(), "# one two three four");
}

#[test]
fn a_source_is_learned_from_the_movement_that_is_made() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    // What is high all the time does not count, only what moves.
    browser.wait_until("document.getElementById('state').textContent === 'live'");
    let learn = element("[aria-label='Learn it for channel 3']");
    let is_offered = format!("{} !== undefined", control("browInnerUp (0.60)"));
    eventually("the source that is moved", || {
        browser.click_on(&learn);
        *console.service.pose.lock().unwrap() = packet(&[("jawOpen", 0.55), ("browInnerUp", 0.6)]);
        browser.wait_for_picture();
        browser.wait_until(&format!("!{learn}.disabled"));
        if browser.value(&is_offered) == true {
            return true;
        }
        // A busy machine has shown the movement too late. It is made again from rest, in which it lasts a second.
        *console.service.pose.lock().unwrap() = packet(&[("jawOpen", 0.5)]);
        browser.await_statuses(browser.statuses() + 8);
        false
    });
    browser.click("browInnerUp (0.60)");
    browser.wait_for_text("not kept yet");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert!(console.settings().contains("browInnerUp = 1"), "{}", console.settings());
}

#[test]
fn a_fault_stands_beside_its_line_and_cannot_be_kept() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    browser.click("Text");
    browser.fill(&element("textarea"), "[camera]\nfps = \"bad\"\n");
    browser.wait_until("document.querySelector('.editor .bad')?.textContent.trim() === '2'");
    browser.wait_for_text("give a whole number from 1 to 240");
    browser.screenshot("fault");
    assert_eq!(browser.value("document.querySelector('#draft .primary').disabled"), true);
    browser.click("Discard");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings(), SETTINGS);
}

#[test]
fn settings_that_cannot_be_read_for_a_moment_come_back_by_themselves() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    browser.click("Text");
    browser.fill(&element("textarea"), "# changed");
    browser.wait_for_text("not kept yet");
    let [file, away] = ["facewire.toml", "away"].map(|name| console.folder.path().join(name));
    std::fs::rename(&file, &away).unwrap();
    std::fs::create_dir(&file).unwrap();
    browser.click("Discard");
    browser.turn_to("servos");
    browser.wait_until("!document.querySelector('.channel') && document.querySelector('.notice.bad')");
    std::fs::remove_dir(&file).unwrap();
    std::fs::rename(&away, &file).unwrap();
    browser.wait_until("document.querySelector('.channel') && !document.querySelector('.notice.bad')");
}

#[test]
fn a_form_changes_a_setting_and_resets_it_and_an_earlier_version_comes_back() {
    let Some((console, mut browser)) = open("links", PHONE) else { return };
    browser.click("Camera");
    browser.fill(&element("[id='field-camera.fps']"), "50");
    browser.press("Enter");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings(), SETTINGS.replace("60", "50"));
    browser.screenshot("form");
    // The default also replaces a value that was refused.
    browser.fill(&element("[id='field-camera.fps']"), "999");
    browser.press("Tab");
    browser.wait_for_text("Give a whole number");
    browser.click("Default: 30");
    browser.wait_for_text("not kept yet");
    browser.wait_until("document.getElementById('field-camera.fps').value === '30'");
    browser.wait_until("!document.body.innerText.includes('Give a whole number')");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert!(!console.settings().contains("fps"), "{}", console.settings());
    browser.click("Versions");
    browser.click("Difference to now");
    browser.wait_for_text("fps = 50 # fast");
    browser.screenshot("versions");
    let headings =
        browser.value("[...document.querySelectorAll('#page-links h2')].map((heading) => heading.textContent)");
    assert_eq!(headings, json!(["Links", "Settings", "Access"]));
    browser.click("Go back to it");
    eventually("the earlier version", || console.settings().contains("fps = 50"));
}

#[test]
fn a_calibration_shows_the_pose_and_why_it_waits_and_ends() {
    let Some((console, mut browser)) = open("wearer", PHONE) else { return };
    browser.fill(&element("#page-wearer input"), "carla");
    browser.click("Begin");
    until_asked(&console, &json!({"do": "calibrate", "wearer": "carla"}));
    for text in ["Pose 6 of 11", "Smile as widely as you can.", "The head is turned", "hold it a little longer"] {
        browser.wait_for_text(text);
    }
    browser.screenshot("calibration");
    browser.click("Cancel");
    browser.wait_for_text("The calibration has ended: the calibration was cancelled");
    browser.fill(&element("#page-wearer input"), "anna");
    browser.click("Begin");
    browser.wait_for_text("The profile of anna is made and in use");
    browser.wait_for_text("Pucker your lips, as if for a kiss. No such movement is seen");
    browser.click("Delete");
    browser.click("Delete anna for ever");
    browser.wait_for_text("there is no profile of this wearer");
}

#[test]
fn a_recording_begins_ends_is_listed_and_is_deleted_after_a_second_click() {
    let Some((console, mut browser)) = open("recordings", PHONE) else { return };
    browser.click("Begin a recording");
    browser.wait_until("document.querySelector('#page-recordings .state-bad')?.textContent === 'Recording'");
    browser.wait_until("/[0-9]+:[0-9]{2} min, [0-9]+ kB/.test(document.getElementById('page-recordings').innerText)");
    browser.screenshot("recording");
    browser.click("End");
    browser.click("Delete");
    assert_eq!(console.get("recordings").json()["list"].as_array().unwrap().len(), 1);
    browser.screenshot("recorded");
    browser.click("Delete for ever");
    browser.wait_for_text("There is no recording yet.");
    assert_eq!(console.get("recordings").json()["list"], json!([]));
}

#[test]
fn the_picture_is_asked_for_again_when_it_is_drawn_and_not_while_the_page_shows_something_else() {
    let Some((console, mut browser)) = open("live", DESK) else { return };
    let asked =
        || console.service.seen.lock().unwrap().requests.iter().filter(|request| request["do"] == "picture").count();
    assert_eq!(asked(), 0);
    browser.click("Camera");
    // Landmarks do, until the settings allow the picture.
    until_asked(&console, &json!({"do": "landmarks"}));
    browser.wait_until("document.querySelector('.camera canvas').width === 640");
    assert_eq!(asked(), 0);
    browser.screenshot("landmarks");
    browser.click("Allow the picture");
    browser.wait_for_text("The camera's picture can be seen here.");
    browser.screenshot("a folded notice");
    assert!(console.settings().contains("[console]\npicture = true"), "{}", console.settings());
    console.service.until(|seen| seen.requests.iter().filter(|request| request["do"] == "picture").count() > 3);
    browser.wait_until("document.querySelector('.camera canvas').width === 1280");
    browser.turn_to("health");
    browser.wait_until("!document.querySelector('.camera')");
    // The picture that was under way is the last one.
    browser.value("fetch('api/1/status').then(() => fetch('api/1/status')).then(() => 1)");
    let last = asked();
    browser.value("(async () => { for (let n = 0; n < 20; n += 1) await fetch('api/1/status'); })().then(() => 1)");
    assert!(asked() <= last + 1, "{} pictures, {last} before", asked());
}

#[test]
fn whoever_comes_from_elsewhere_sets_the_password_and_a_link_to_look_changes_nothing() {
    let Some(address) = elsewhere() else { return skip("this machine has no address besides loopback") };
    let Some((console, mut browser)) = open("links", PHONE) else { return };
    browser.open(&url(&console, address, "servos"));
    browser.wait_for_text("Nobody has set a password yet");
    browser.screenshot("first password");
    browser.fill(&element("[name=password]"), "right horse");
    browser.fill(&element("[name=again]"), "wrong horse");
    browser.click("Set the password");
    browser.wait_for_text("The two passwords differ");
    browser.click_on(&element("[aria-label='Show: The same again']"));
    browser.wait_until("document.querySelector('[name=again]').type === 'text'");
    browser.fill(&element("[name=again]"), "right horse");
    browser.screenshot("first password, shown");
    browser.click("Set the password");
    browser.wait_until("document.getElementById('stop')?.disabled === false");
    let token = console.post("tokens/look", &json!({})).json()["token"].as_str().unwrap().to_owned();
    // Without its cookie, the same browser is somebody else.
    browser.call("Network.clearBrowserCookies", &json!({}));
    browser.open("about:blank");
    browser.open(&url(&console, address, ""));
    browser.wait_for_text("Log in");
    browser.fill(&element("input"), "wrong horse");
    browser.click("Log in");
    browser.wait_for_text("The password or the token is wrong.");
    browser.screenshot("login");
    browser.open("about:blank");
    browser.open(&url(&console, address, &format!("token={token}")));
    browser.wait_for_text("You may look, but not operate.");
    assert_eq!(browser.value("document.getElementById('stop').disabled"), true);
    assert_eq!(browser.value("location.href.includes('token')"), false);
}

#[test]
fn the_pages_know_each_pose_refusal_and_impairment_of_the_service() {
    let Some((_console, mut browser)) = open("live", DESK) else { return };
    let (takes, refusals) = (Take::ALL.map(Take::name), Refusal::ALL.map(Refusal::name));
    let impairments = facewire_board::Impairment::ALL.map(facewire_board::Impairment::name);
    let known = browser.value(
        "Promise.all([import('./poses.js'), import('./impaired.js')]).then(([{ TAKES, REFUSALS }, { SENTENCES }]) => \
         [TAKES, REFUSALS, SENTENCES].map(Object.keys))",
    );
    assert_eq!(known, json!([takes, refusals, impairments]));
}

/// What a page says, in what is folded away, too.
const TEXT: &str =
    "[...document.querySelectorAll('header, #banners, main, aside')].map((part) => part.textContent).join(' ')";

#[test]
fn a_link_says_only_what_is_known_of_its_receiver_and_waiting_is_no_fault() {
    let Some((console, mut browser)) = open("links", PHONE) else { return };
    let link = |kind: &str, receiver: &str, open: bool, trouble: Option<&str>| json!({"name": format!("{kind} {receiver}"), "kind": kind, "open": open, "sent": 5, "dropped": 0, "trouble": trouble});
    let more = |mut link: Value, key: &str, value: Value| {
        link[key] = value;
        link
    };
    let vrchat = |answers: bool, elsewhere: &[&str]| {
        more(link("vrchat", "10.0.0.2:9000", true, None), "vrchat", json!({"answers": answers, "elsewhere": elsewhere}))
    };
    let nobody = "pc:11111: nobody listens on port 11111 of pc; start the receiver there";
    let refused = "10.0.0.2:9000: the system refuses to send; check the network";
    let unheard = "10.0.0.2:9000: nobody listens on port 9000 of 10.0.0.2; start the receiver there";
    let waits = "auto: waits for a microcontroller board; none of a known maker is plugged in";
    let fault =
        "/dev/ttyUSB0: another program has it open; end that program (the service: `sudo systemctl stop facewire`)";
    console.service.seen.lock().unwrap().more_links = vec![
        link("udp", "127.0.0.1:5252", true, None),
        link("vrchat", "head.local:9000", false, Some("head.local:9000: the host does not resolve")),
        link("serial", "auto", false, Some(waits)),
        link("bus-servo", "/dev/ttyUSB0", false, Some(fault)),
        more(link("live-link", "pc:11111", true, Some(nobody)), "unheard", json!(true)),
        more(link("vmc", "pc:39540", true, None), "answered_s_ago", json!(3)),
        more(link("json", "pc:5000", true, None), "answered_s_ago", json!(130)),
        vrchat(true, &[]),
        vrchat(false, &["10.0.0.3:9000", "10.0.0.2:9010"]),
        vrchat(false, &[]),
        more(vrchat(true, &[]), "trouble", json!(refused)),
        more(vrchat(false, &["10.0.0.3:9000"]), "trouble", json!(refused)),
        more(more(vrchat(true, &[]), "trouble", json!(unheard)), "unheard", json!(true)),
        more(more(vrchat(false, &["10.0.0.3:9000"]), "trouble", json!(unheard)), "unheard", json!(true)),
        more(vrchat(false, &["10.0.0.3:9000"]), "answered_s_ago", json!(3)),
        more(vrchat(false, &["10.0.0.3:9000"]), "answered_s_ago", json!(10)),
    ];
    browser.wait_for_text("Bus servos /dev/ttyUSB0");
    let articles = "[...document.querySelectorAll('#page-links article')].map(({ innerText }) => innerText.split('\\n').filter((line) => line && !/^(rate|sent|dropped) /.test(line)).join('|'))";
    assert_eq!(
        browser.value(articles),
        json!([
            "Pololu Maestro /dev/ttyACM0 connected",
            "facewire packets by UDP sending to 127.0.0.1:5252",
            "VRChat head.local:9000 not sending|The host does not resolve.",
            "Microcontroller waiting|Waits for a microcontroller board; none of a known maker is plugged in.",
            "Bus servos /dev/ttyUSB0 not connected|Another program has it open; end that program.",
            "Unreal (Live Link) pc:11111 nobody listens|Nobody listens on port 11111 of pc; start the receiver there.",
            "VMC pc:39540 answers",
            "Lines of JSON sending to pc:5000, which answered 2 min ago",
            "VRChat 10.0.0.2:9000 answers",
            "VRChat 10.0.0.2:9000 VRChat answers elsewhere|VRChat answers at 10.0.0.3:9000, 10.0.0.2:9010; set this link's address to match.",
            "VRChat 10.0.0.2:9000 no answer|Is OSC switched on in VRChat, at Options > OSC > Enabled? A firewall that blocks mDNS can also be the cause.",
            "VRChat sending to 10.0.0.2:9000|The system refuses to send; check the network.",
            "VRChat sending to 10.0.0.2:9000|The system refuses to send; check the network.",
            "VRChat 10.0.0.2:9000 nobody listens|Nobody listens on port 9000 of 10.0.0.2; start the receiver there.",
            "VRChat 10.0.0.2:9000 nobody listens|Nobody listens on port 9000 of 10.0.0.2; start the receiver there.",
            "VRChat 10.0.0.2:9000 answers",
            "VRChat 10.0.0.2:9000 VRChat answers elsewhere|VRChat answers at 10.0.0.3:9000; set this link's address to match.",
        ])
    );
    let red = "[...document.querySelectorAll('#page-links article')].map((it) => it.querySelector('.state-bad, .trouble') !== null)";
    let is_red: Vec<bool> = (0..17).map(|article| [2, 4, 11, 12].contains(&article)).collect();
    assert_eq!(browser.value(red), json!(is_red));
    browser.screenshot("links on a phone");
    browser.turn_to("health");
    browser.wait_until("document.querySelector('#banners')?.innerText.includes('head.local')");
    assert_eq!(browser.value("/waits|auto/i.test(document.getElementById('banners').textContent)"), false);
    browser.click_on(&element("#banners summary"));
    browser.wait_until("document.querySelector('#banners li')?.checkVisibility()");
    browser.screenshot("unfolded notices");
}

#[test]
fn no_page_shows_marks_of_code_or_commands_that_a_page_cannot_run() {
    let Some((console, mut browser)) = open("links", DESK) else { return };
    let trouble = "/dev/i2c-1: another program moves servos there; end that program, or stop the service with `systemctl stop facewire`";
    console.service.seen.lock().unwrap().more_links =
        vec![json!({"name": "pca9685 I2C bus 1, address 0x40", "kind": "pca9685",
        "open": false, "sent": 0, "dropped": 0, "trouble": trouble})];
    for page in PAGES {
        turn_to(&mut browser, page);
        if page == "health" {
            browser.click("Check now");
            browser.wait_until("document.querySelectorAll('.check-lines li').length > 2");
        }
        let shown = browser.value(TEXT).as_str().unwrap().to_owned();
        let found: Vec<_> = ["`", "sudo ", "systemctl"].into_iter().filter(|word| shown.contains(word)).collect();
        assert!(found.is_empty(), "{page} shows {found:?}: {shown}");
    }
    assert!(browser.value("document.querySelector('nav')").is_object());
}

#[test]
fn a_link_that_is_removed_is_one_change_and_named_in_the_list() {
    let settings = ["[[link]]\naddress = \"10.0.0.2:5252\"\n\n", SETTINGS].concat();
    let Some((console, mut browser)) = open_in(Browser::start, &settings, "links", PHONE) else { return };
    browser.click("Link 1: facewire packets by UDP");
    browser.click("Remove this link");
    browser.wait_for_text("1 setting is changed and not kept yet");
    browser.click("Difference");
    browser.wait_for_text("Link 1, facewire packets by UDP: removed");
    browser.screenshot("a link that is removed");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    assert_eq!(console.settings().matches("[[link]]").count(), 1);
}

#[test]
fn the_first_link_says_that_the_usual_ones_end_and_keeps_them_if_that_is_wanted() {
    let Some((console, mut browser)) = open_in(Browser::start, "[camera]\nfps = 30\n", "links", PHONE) else { return };
    browser.choose("document.querySelector('option[value=maestro]')?.parentElement", "maestro");
    browser.click("Add");
    browser.wait_for_text("facewire no longer sends to this machine (127.0.0.1:5252) or a microcontroller on USB");
    browser.click("Difference");
    browser.wait_for_text("The usual link to a microcontroller on USB: removed");
    browser.screenshot("the usual links end");
    browser.click("Keep sending there too");
    browser.wait_until("!document.body.innerText.includes('no longer sends')");
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let kept = console.settings();
    for line in ["address = \"127.0.0.1:5252\"", "device = \"auto\"\nkind = \"serial\""] {
        assert!(kept.contains(line), "{line}: {kept}");
    }
}

#[test]
fn a_new_board_has_a_name_of_its_own_and_settings_lead_to_its_servos() {
    let Some((_console, mut browser)) = open("links", PHONE) else { return };
    let list = "document.querySelector('option[value=maestro]')?.parentElement";
    for count in [2, 3] {
        browser.choose(list, "maestro");
        browser.click("Add");
        browser.wait_until(&format!("document.querySelectorAll('details.link').length === {count}"));
    }
    browser.wait_for_text("A servo board has no channel yet");
    browser.wait_for_text("This board has no servo yet.");
    browser.screenshot("a new board");
    browser.click("Set up its servos");
    browser.wait_until("document.querySelectorAll('.board').length === 3");
    let names = "[...document.querySelectorAll('.board')].map((board) => board.ariaLabel)";
    assert_eq!(browser.value(names), json!(["maestro /dev/ttyACM0", "maestro (link 2)", "maestro (link 3)"]));
    let titles = "[...document.querySelectorAll('.board h3')].map(({ innerText }) => innerText.trim())";
    assert_eq!(browser.value(titles)[2], "Pololu Maestro (link 3, new)");
}

#[test]
fn the_servos_of_a_head_are_added_by_one_click_and_seen_in_one_view() {
    let Some((console, mut browser)) = open_in(Browser::start, "[[link]]\nkind = \"maestro\"\n", "servos", PHONE)
    else {
        return;
    };
    browser.click("Jaw");
    browser.wait_for_text("Channel 0 (jaw)");
    browser.click("Whole head");
    browser.wait_until("document.querySelectorAll('.channel').length === 8");
    let shown = "(({ top, bottom }) => bottom - top)(document.querySelector('.overview').getBoundingClientRect())";
    assert!(browser.value(shown).as_f64() < Some(400.0), "they do not fit into one view");
    let names = "[...document.querySelectorAll('.overview span')].map(({ innerText }) => innerText).join()";
    let all = "jaw,eyes sideways,eyes up and down,left upper lid,right upper lid,neck turn,neck left,neck right";
    assert_eq!(browser.value(names), all);
    for (width, height) in [PHONE, DESK] {
        browser.resize(width, height);
        browser.value("document.querySelector('.board').scrollIntoView()");
        browser.screenshot(&format!("a head at {width}"));
    }
    browser.click("neck right");
    browser.wait_until(
        "document.querySelector('[aria-label=\"Channel 7 (neck right)\"]').getBoundingClientRect().top < 900",
    );
    browser.click("Keep");
    browser.wait_until("!document.getElementById('draft')");
    let kept = console.settings();
    assert_eq!((kept.matches("[[link.channel]]").count(), kept.matches("speed_per_s = 0.5").count()), (8, 8), "{kept}");
}

#[test]
fn the_latency_has_three_curves_and_what_no_sensor_measures_has_no_chart() {
    let Some((console, mut browser)) = open("health", PHONE) else { return };
    browser.wait_until("document.querySelector('.charts .legend')");
    let charts = "[...document.querySelectorAll('.charts figure')].map((it) => [it.querySelector('figcaption').innerText, \
                  it.querySelectorAll('.legend li').length])";
    let charts: Vec<(String, usize)> = serde_json::from_value(browser.value(charts)).unwrap();
    let of = |title: &str| charts.iter().find(|(name, _)| name.starts_with(title)).map(|(_, curves)| *curves);
    assert_eq!(of("Latency"), Some(3), "{charts:?}");
    let is_measured = console.get("status").json()["board"]["temperature_c"].is_number();
    assert_eq!(of("Temperature").is_some(), is_measured, "{charts:?}");
    for (width, height) in [PHONE, DESK] {
        browser.resize(width, height);
        browser.value("document.querySelector('.charts').scrollIntoView()");
        browser.screenshot(&format!("charts at {width}"));
    }
}

#[test]
fn servos_are_let_move_again_where_they_are_armed() {
    let Some((console, mut browser)) = open("servos", PHONE) else { return };
    browser.click("STOP");
    browser.wait_for_text("All servos are released");
    browser.screenshot("released, on Servos");
    browser.click_on(
        "[...document.querySelectorAll('#arming button')].find(({ innerText }) => innerText.startsWith('Let servos'))",
    );
    until_asked(&console, &json!({"do": "release", "on": false}));
    browser.wait_until("!document.querySelector('.released')");
}
