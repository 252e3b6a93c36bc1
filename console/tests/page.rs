//! The page in a real browser: Chromium without a screen.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{fs, thread};

use common::{
    Sending, Viewer,
    browser::{Browser, Screenshot, element},
    packet, skip,
};
use facewire_packet::{BLENDSHAPES, Packet, Reason, State, Visibility};

/// A page of this size in CSS pixels that is open in a browser and receives these packets, or `None` with a note if there
/// is no browser.
fn open(width: u32, height: u32, first: Packet) -> Option<(Viewer, Sending, Browser)> {
    if !Browser::is_installed() {
        skip("there is no chromium; scripts/setup tests installs it");
        return None;
    }
    let viewer = Viewer::start();
    let sending = Sending::to(viewer.packets_to(), first);
    let mut browser = Browser::with_face(width, height);
    browser.open(&viewer.url);
    browser.wait_until("document.querySelector('.bar')");
    Some((viewer, sending, browser))
}

/// Waits until the page shows a coefficient.
fn wait_for(browser: &mut Browser, name: &str, value: &str) {
    browser.wait_until(&format!("document.querySelector('[data-name={name}] b').textContent === '{value}'"));
}

/// The rectangle of an element: left, top, width, height.
fn rectangle(browser: &mut Browser, selector: &str) -> [usize; 4] {
    let rectangle = browser.value(&format!(
        "(({{x, y, width, height}}) => [x, y, width, height].map(Math.round))(document.querySelector('{selector}').getBoundingClientRect())"
    ));
    serde_json::from_value(rectangle).unwrap()
}

/// A coefficient that is seen in a bar alone. It tells when a pose has arrived, and it fades with the face.
const MARK: (&str, f32) = ("cheekPuff", 0.01);

/// Takes a picture of a face with the mark while the page is paused. A busy machine may send nothing for a while, and then a face
/// that is not paused fades: begins again if it did so before the pause.
fn paused(browser: &mut Browser, name: &str) -> Screenshot {
    loop {
        wait_for(browser, MARK.0, "0.01");
        browser.click_on(&element("#pause"));
        browser.wait_until("document.getElementById('pause').ariaPressed === 'true'");
        let is_whole = browser.value("document.querySelector('[data-name=cheekPuff] b').textContent === '0.01'");
        let picture = browser.screenshot(name);
        browser.click_on(&element("#pause"));
        browser.wait_until("document.getElementById('pause').ariaPressed === 'false'");
        if is_whole == true {
            return picture;
        }
    }
}

fn about(axis: usize, degrees: f32) -> [f32; 4] {
    let half = degrees.to_radians() / 2.0;
    let mut rotation = [0.0, 0.0, 0.0, half.cos()];
    rotation[axis] = half.sin();
    rotation
}

#[test]
fn the_page_shows_what_was_sent_without_errors_or_requests_elsewhere() {
    let coefficients: Vec<f32> = (0..52_u8).map(|index| f32::from(index) / 52.0).collect();
    let first = Packet { coefficients: coefficients.clone().try_into().unwrap(), ..packet(&[]) };
    let Some((viewer, sending, mut browser)) = open(1280, 900, first) else { return };
    wait_for(&mut browser, "tongueOut", "0.98");
    // All at the same moment: a busy machine may send nothing for a while, in which the face fades.
    let is_shown = |(name, value): (&&str, f32)| {
        format!("document.querySelector('[data-name={name}] b').textContent === '{value:.2}'")
    };
    let are_shown: Vec<String> = BLENDSHAPES.iter().zip(coefficients).map(is_shown).collect();
    browser.wait_until(&are_shown.join(" && "));
    browser.wait_until("document.getElementById('state').textContent === 'live'");
    sending.show(Packet { state: State::Hold, reason: Reason::NoFace, ..first });
    browser.wait_until("document.getElementById('state').textContent === 'hold: no face'");
    let facts = browser.value("document.getElementById('facts').innerText");
    for fact in ["age of the pose", "rate", "lost", "neutral face\nmean", "refused\n0", "127.0.0.1:"] {
        assert!(facts.as_str().unwrap().contains(fact), "{fact}: {facts}");
    }
    assert_eq!(browser.errors(), Vec::<serde_json::Value>::new());
    let requests = browser.requests();
    assert!(requests.len() > 10 && requests.iter().all(|url| url.starts_with(&viewer.url)), "{requests:?}");
}

#[test]
fn the_state_names_what_is_covered_and_keeps_its_colour() {
    let Some((_viewer, sending, mut browser)) = open(1280, 900, packet(&[])) else { return };
    let whole = Visibility::WHOLE;
    for (visibility, text) in [
        (Visibility { left_eye: 0.2, right_eye: 0.4, brows: 0.6, ..whole }, "live, eyes covered"),
        (Visibility { right_eye: 0.0, mouth: 0.0, face: 0.3, ..whole }, "live, right eye covered, mouth covered"),
        (Visibility { face: 0.4, ..whole }, "live, face covered"),
        (whole, "live"),
    ] {
        sending.show(Packet { visibility, ..packet(&[]) });
        browser.wait_until(&format!("document.getElementById('state').textContent === '{text}'"));
        assert_eq!(browser.value("document.getElementById('state').dataset.state"), "live");
    }
}

#[test]
fn the_face_moves_its_jaw_its_lids_and_its_head_and_nothing_else() {
    let Some((_viewer, sending, mut browser)) = open(1280, 900, packet(&[MARK])) else { return };
    let neutral = paused(&mut browser, "neutral");
    let again = paused(&mut browser, "neutral again");
    let [left, top, width, height] = rectangle(&mut browser, "#face");
    let forehead = [left + width * 2 / 5, top + height / 5, width / 5, height / 10];
    let face = [left + width / 4, top + height / 8, width / 2, height * 3 / 4];
    assert!(neutral.difference(&again, face) < 1e-6, "a face at rest moves");
    for (name, pose, least) in [
        ("jaw open", packet(&[("jawOpen", 1.0)]), 0.02),
        ("blink", packet(&[("eyeBlinkLeft", 1.0), ("eyeBlinkRight", 1.0)]), 0.004),
        ("smile", packet(&[("mouthSmileLeft", 1.0), ("mouthSmileRight", 1.0)]), 0.01),
        ("brows up", packet(&[("browInnerUp", 1.0), ("browOuterUpLeft", 1.0), ("browOuterUpRight", 1.0)]), 0.004),
        ("head turned", Packet { rotation: about(1, 30.0), ..packet(&[]) }, 0.1),
    ] {
        let mut marked = pose;
        marked.coefficients[46] = MARK.1;
        sending.show(marked);
        let picture = paused(&mut browser, name);
        let changed = picture.difference(&neutral, face);
        assert!(changed > least && changed < 0.9, "{name}: {changed}");
        if name == "jaw open" {
            assert!(picture.difference(&neutral, forehead) < 0.01, "the jaw moves the forehead");
        }
        sending.show(packet(&[]));
        wait_for(&mut browser, "cheekPuff", "0.00");
    }
    assert_eq!(browser.errors(), Vec::<serde_json::Value>::new());
}

#[test]
fn every_coefficient_moves_the_face() {
    let Some((_viewer, _sending, mut browser)) = open(900, 900, packet(&[])) else { return };
    // Draws a small face in each of the 52 poses, and counts the pixels that differ from neutral.
    let counts = browser.value(
        "(async () => {
            const { Face } = await import('./face/face.js');
            const canvas = document.createElement('canvas');
            canvas.style.cssText = 'position: fixed; width: 300px; height: 330px';
            document.body.append(canvas);
            const face = new Face(canvas);
            const pixels = (name) => {
                face.draw({ weight: (known) => (known === name ? 1 : 0), rotation: [0, 0, 0, 1], position: [0, 0, 0], isLive: true });
                const bytes = new Uint8Array(4 * canvas.width * canvas.height);
                face.gl.readPixels(0, 0, canvas.width, canvas.height, face.gl.RGBA, face.gl.UNSIGNED_BYTE, bytes);
                return bytes;
            };
            const neutral = pixels('');
            const names = [...document.querySelectorAll('.bar')].map((bar) => bar.dataset.name);
            return names.map((name) => [name, pixels(name).filter((byte, k) => Math.abs(byte - neutral[k]) > 8).length]);
        })()",
    );
    let counts: Vec<(String, usize)> = serde_json::from_value(counts).unwrap();
    assert_eq!(counts.len(), 52);
    for (name, changed) in counts {
        assert!(changed > 60, "{name} changes {changed} values of pixels");
    }
}

#[test]
fn a_phone_shows_the_page_without_scrolling_sideways() {
    let Some((_viewer, _sending, mut browser)) = open(360, 740, packet(&[("jawOpen", 0.6)])) else { return };
    wait_for(&mut browser, "jawOpen", "0.60");
    browser.wait_until("document.getElementById('facts').children.length > 0");
    browser.screenshot("phone");
    assert_eq!(browser.value("document.documentElement.scrollWidth"), 360);
    let cut = "[...document.querySelectorAll('.bar span')].filter((label) => label.scrollWidth > label.clientWidth).map((label) => label.textContent)";
    assert_eq!(browser.value(cut), serde_json::json!([]), "names of bars are cut off");
}

#[test]
fn a_recording_has_the_columns_of_track_and_a_row_for_each_packet() {
    let Some((_viewer, sending, mut browser)) = open(1280, 900, packet(&[])) else { return };
    browser.wait_until("document.getElementById('state').textContent === 'live'");
    browser.click_on(&element("#record"));
    sending.show(Packet { rotation: about(1, 30.0), position_mm: [10.0, -20.0, 500.0], ..packet(&[("jawOpen", 0.5)]) });
    wait_for(&mut browser, "jawOpen", "0.50");
    browser.wait_until("parseInt(document.getElementById('recorded').textContent) > 60");
    browser.click_on(&element("#record"));
    browser.await_event("Browser.downloadProgress", |progress| progress["state"] == "completed");

    let files: Vec<_> = fs::read_dir(browser.downloads()).unwrap().map(|entry| entry.unwrap().path()).collect();
    let file = files.iter().find(|path| path.extension().is_some_and(|extension| extension == "csv")).unwrap();
    let text = fs::read_to_string(file).unwrap();
    let head = ["frame", "time_s", "state"].into_iter().chain(BLENDSHAPES).chain([
        "head_yaw_deg",
        "head_pitch_deg",
        "head_roll_deg",
        "head_x_mm",
        "head_y_mm",
        "head_z_mm",
        "visibility_left_eye",
        "visibility_right_eye",
        "visibility_brows",
        "visibility_mouth",
        "visibility_cheeks",
        "visibility_face",
    ]);
    let head: Vec<&str> = head.collect();
    assert_eq!(text.lines().next().unwrap(), head.join(","));
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert!(rows.len() > 60 && rows.iter().all(|row| row.len() == head.len()), "{text}");
    assert_eq!(rows[0][..3], ["0", "0.000000", "live"]);
    let last = rows.last().unwrap();
    let column = |name: &str| last[head.iter().position(|column| *column == name).unwrap()].parse::<f64>().unwrap();
    for (name, want) in [("jawOpen", 0.5), ("head_yaw_deg", 30.0), ("head_y_mm", -20.0), ("head_z_mm", 500.0)] {
        assert!((column(name) - want).abs() < 0.01, "{name} {last:?}");
    }
    assert!(rows.is_sorted_by(|a, b| a[0].parse::<u32>().unwrap() < b[0].parse::<u32>().unwrap()));
}

#[test]
fn pause_freezes_the_picture_and_keys_work() {
    let Some((_viewer, sending, mut browser)) = open(1280, 900, packet(&[("jawOpen", 0.3)])) else { return };
    wait_for(&mut browser, "jawOpen", "0.30");
    while browser.value("document.activeElement.id") != "pause" {
        browser.press("Tab");
    }
    browser.press(" ");
    browser.wait_until("document.getElementById('state').textContent === 'paused'");
    sending.show(packet(&[("jawOpen", 0.9)]));
    // The stream goes on: two events later, the new pose would have been shown.
    browser.value("new Promise((done) => { const s = new EventSource('api/1/events'); let n = 0; s.addEventListener('face', (e) => { if (JSON.parse(e.data).packet.coefficients[17] > 0.8 && (n += 1) > 5) { s.close(); done(1); } }); })");
    browser.wait_for_picture();
    assert_eq!(browser.value("document.querySelector('[data-name=jawOpen] b').textContent"), "0.30");
    browser.click_on(&element("#pause"));
    wait_for(&mut browser, "jawOpen", "0.90");
}

#[test]
fn without_packets_the_page_says_what_to_do_and_in_silence_the_face_goes_neutral() {
    if !Browser::is_installed() {
        return skip("there is no chromium; scripts/setup tests installs it");
    }
    let viewer = Viewer::start();
    let mut browser = Browser::start(1280, 900);
    browser.open(&viewer.url);
    browser.wait_until("!document.getElementById('help').hidden");
    let help = browser.value("document.getElementById('help').innerText");
    let lines = format!("[[link]]\nkind = \"udp\"\naddress = \"{}\"", viewer.packets_to());
    assert!(help.as_str().unwrap().contains(&lines), "{help}");
    browser.screenshot("help");

    let sending = Sending::to(viewer.packets_to(), packet(&[("jawOpen", 0.8)]));
    wait_for(&mut browser, "jawOpen", "0.80");
    browser.wait_until("document.getElementById('help').hidden");
    drop(sending);
    wait_for(&mut browser, "jawOpen", "0.00");
    browser.wait_until("document.getElementById('state').textContent.startsWith('silent')");
    let ended = thread::spawn(move || drop(viewer));
    browser.wait_until("document.getElementById('state').textContent === 'no connection to the console'");
    ended.join().unwrap();
}

#[test]
fn a_page_too_many_says_so_and_goes_on_once_another_is_closed() {
    if !Browser::is_installed() {
        return skip("there is no chromium; scripts/setup tests installs it");
    }
    let viewer = Viewer::start();
    let mut others: Vec<_> = (0..16).map(|_| viewer.events()).collect();
    for events in &mut others {
        assert!(events.status().starts_with("HTTP/1.1 200"));
    }
    let mut browser = Browser::start(1280, 900);
    browser.open(&viewer.url);
    browser.wait_until("document.getElementById('state').textContent.startsWith('As many pages as')");
    drop(others);
    browser.wait_until("document.getElementById('state').textContent === 'waiting for packets'");
}

#[test]
fn a_page_with_the_token_of_an_earlier_start_says_so() {
    if !Browser::is_installed() {
        return skip("there is no chromium; scripts/setup tests installs it");
    }
    let viewer = Viewer::with(&["--listen", "0.0.0.0:0", "--udp", "127.0.0.1:0"]);
    let (_, port) = viewer.host().rsplit_once(':').unwrap();
    let (port, path) = (port.to_owned(), viewer.path(""));
    let mut browser = Browser::start(1280, 900);
    browser.open(&format!("http://127.0.0.1:{port}{path}"));
    browser.wait_until("document.getElementById('state').textContent === 'waiting for packets'");
    drop(viewer);
    let _again = Viewer::again(&["--listen", &format!("0.0.0.0:{port}"), "--udp", "127.0.0.1:0"]);
    browser.wait_until("document.getElementById('state').textContent.includes('lacks the token')");
}

#[test]
fn the_plot_begins_anew_when_the_program_starts_again() {
    // What the plot shows between its lines at 0 and 1 in the colour of jawOpen.
    const DRAWN: &str = "(() => { const c = document.getElementById('plot'); const { data } = c.getContext('2d') \
        .getImageData(0, c.height * 0.15, c.width, c.height * 0.7); let n = 0; for (let i = 0; i < data.length; i += 4) \
        n += data[i] < 90 && data[i + 1] > 120 && data[i + 2] > 140 && data[i + 3] > 100; return n; })()";
    let Some((viewer, sending, mut browser)) = open(1280, 900, packet(&[("jawOpen", 0.5)])) else { return };
    browser.wait_until(&format!("{DRAWN} > 100"));
    let (host, udp) = (viewer.host().to_owned(), viewer.packets_to().to_string());
    drop(viewer);
    // A coefficient that is not in the plot tells that the packets are new: in silence the face fades to neutral as well.
    sending.show(packet(&[("noseSneerLeft", 0.5)]));
    let _again = Viewer::again(&["--listen", &host, "--udp", &udp]);
    wait_for(&mut browser, "noseSneerLeft", "0.50");
    browser.wait_for_picture();
    assert_eq!(browser.value(DRAWN), 0, "samples of the earlier start are still drawn");
}
