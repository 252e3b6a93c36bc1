//! A head is set up by clicks alone, on a machine on which the package was just installed: the virtual machine of the device
//! tests, with a camera, a face that takes poses, and a Maestro. `tests/guest/console` starts both.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    env, fs,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use common::browser::{Browser, element, labelled};

/// The machine is emulated, and 10 to 20 times slower than this one.
const PATIENCE: Duration = Duration::from_mins(5);
const PASSWORD: &str = "eyes that look";
/// The servos of a whole head.
const SERVOS: [&str; 8] = [
    "eyes sideways",
    "eyes up and down",
    "left upper lid",
    "right upper lid",
    "jaw",
    "neck turn",
    "neck left",
    "neck right",
];
const JAW: usize = 4;
/// The ends that the jaw gets.
const JAW_US: [u32; 2] = [1000, 1600];
/// The card of the jaw on the page.
const JAW_CARD: &str = "[aria-label='Channel 4 (jaw)']";

/// Frames of the built-in clip that show the pose of an instruction, and one that shows the face at rest.
const POSES: [(&str, u32); 6] = [
    ("Shut both eyes", 18),
    ("Open your mouth", 93),
    ("Raise your eyebrows", 11),
    ("Smile", 236),
    ("Pucker", 183),
    ("Look down", 67),
];
const AT_REST: u32 = 5;

struct Guest(PathBuf);

impl Guest {
    fn await_file(&self, name: &str) {
        self.wait(name, |guest| guest.0.join(name).exists());
    }

    fn wait(&self, what: &str, holds: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !holds(self) {
            assert!(Instant::now() < end, "waited in vain for {what}");
            thread::sleep(Duration::from_millis(200));
        }
    }

    /// Kills the service, and waits until systemd has started it again.
    fn kill_service(&self) {
        fs::write(self.0.join("kill"), "").unwrap();
        self.wait("the end of the service", |guest| !guest.0.join("kill").exists());
    }

    /// Puts a frame of the built-in clip before the camera.
    fn show(&self, frame: u32) {
        let pose = self.0.join("pose");
        fs::copy(self.0.join(format!("frames/{frame}.jpg")), &pose).unwrap();
        fs::rename(pose, self.0.join("pose.jpg")).unwrap();
    }

    /// The newest target of each channel, in microseconds; 0 for none. `None` for channels without one.
    fn pulses_us(&self) -> [Option<u32>; SERVOS.len()] {
        let mut pulses = [None; SERVOS.len()];
        let text = fs::read_to_string(self.0.join("targets")).unwrap_or_default();
        for (channel, target) in text.lines().filter_map(|line| line.split_once(' ')) {
            let place = pulses.get_mut(channel.parse::<usize>().unwrap());
            place.into_iter().for_each(|pulse| *pulse = Some(target.parse::<u32>().unwrap() / 4));
        }
        pulses
    }
}

fn go_to(browser: &mut Browser, page: &str, text: &str) {
    browser.turn_to(page);
    browser.wait_for_text(text);
}

/// Keeps the changed settings, once they have no fault.
fn keep(browser: &mut Browser) {
    browser.wait_until("!document.querySelector('#draft .trouble')");
    browser.click("Keep");
    browser.wait_until("!document.querySelector('#draft')");
}

fn log_in(browser: &mut Browser, url: &str) {
    browser.open(url);
    browser.fill(&element("input[name=password]"), PASSWORD);
    if browser.value("document.querySelector('input[name=again]') !== null") == true {
        browser.fill(&element("input[name=again]"), PASSWORD);
    }
    browser.press("Enter");
    browser.wait_until("document.querySelector('nav')");
}

/// Opens the jaw by its slider. On a machine this slow, driving may end between two heartbeats of the page. It then arms
/// again, as a person does.
fn jog_to_its_end(browser: &mut Browser, guest: &Guest, end_us: u32) {
    let end = Instant::now() + PATIENCE;
    while guest.pulses_us()[JAW] != Some(end_us) {
        assert!(Instant::now() < end, "waited in vain for the jaw at its end");
        browser.drive(&element(&format!("{JAW_CARD} input[type=range]")), 1.0);
        thread::sleep(Duration::from_millis(500));
    }
}

/// Takes each pose that the page asks for, until the profile is made.
fn calibrate(browser: &mut Browser, guest: &Guest) {
    go_to(browser, "wearer", "Name of the wearer");
    browser.fill(&labelled("#page-wearer", "Name of the wearer"), "anna");
    browser.click("Begin");
    browser.wait_until("document.querySelector('.guide h3')");
    let (end, mut shown) = (Instant::now() + PATIENCE, AT_REST);
    while let Some(asked) = browser.value("document.querySelector('.guide h3')?.textContent").as_str() {
        assert!(Instant::now() < end, "{}", browser.value("document.querySelector('.guide').innerText"));
        let pose = POSES.into_iter().find(|(instruction, _)| asked.starts_with(instruction));
        let frame = pose.map_or(AT_REST, |(_, frame)| frame);
        if frame != shown {
            guest.show(frame);
            shown = frame;
            browser.screenshot(&format!("guest-7-pose-{frame}"));
        }
        thread::sleep(Duration::from_millis(200));
    }
    browser.wait_for_text("The profile of anna is made and in use, from ");
    browser.screenshot("guest-8-calibrated");
    let taken = browser.value("document.querySelector('.notice.good').innerText.match(/from (\\d+) poses/)[1]");
    assert!(taken.as_str().unwrap().parse::<usize>().unwrap() > POSES.len() / 2, "{taken} poses were taken");
    guest.show(AT_REST);
    browser.click("Use at every start");
    browser.wait_for_text("1 setting is changed");
    keep(browser);
}

#[test]
#[ignore = "it needs the virtual machine of the device tests: tests/guest/console"]
fn a_head_is_set_up_by_clicks_alone_and_moves_by_itself_after_a_restart() {
    let guest = Guest(Path::new(&env::var_os("FACEWIRE_GUEST_SHARE").unwrap()).to_owned());
    let url = env::var("FACEWIRE_GUEST_PAGE").unwrap();
    guest.await_file("ready");
    let mut browser = Browser::start(360, 740);
    browser.set_patience(PATIENCE);
    log_in(&mut browser, &url);
    browser.screenshot("guest-1-first");

    // The camera, of those that are present.
    go_to(&mut browser, "start", "Which camera?");
    let loopback = "[...document.querySelectorAll('.choice')].find((choice) => choice.textContent.includes('/dev/'))";
    browser.click_on(&format!("{loopback}?.querySelector('input')"));
    browser.wait_for_text("1 setting is changed");
    browser.screenshot("guest-2-camera");
    // The Maestro that is plugged in.
    browser.click("Next");
    browser.click("Next");
    browser.wait_until("document.querySelector('.offer')?.textContent.includes('Maestro')");
    browser.click("Use it");
    browser.wait_for_text("set up");
    browser.screenshot("guest-3-receiver");

    go_to(&mut browser, "servos", "Add a channel");
    browser.click("Whole head");
    browser.wait_until(&format!("document.querySelectorAll('.channel').length === {}", SERVOS.len()));
    browser.click_on(&element(&format!("{JAW_CARD} > details > summary")));
    for (label, pulse_us) in ["Pulse at end 0", "Pulse at end 1"].into_iter().zip(JAW_US) {
        browser.fill(&labelled(JAW_CARD, label), &pulse_us.to_string());
        browser.press("Tab");
    }
    browser.wait_until("!document.querySelector('#draft .trouble')");
    browser.screenshot("guest-4-servos");
    keep(&mut browser);

    go_to(&mut browser, "start", "Start");
    browser.click("5");
    browser.click("Start now and with the board");
    browser.wait_for_text("The service runs.");
    go_to(&mut browser, "servos", "connected");
    browser.wait_until("document.querySelector('.board .state-good')");
    guest.wait("targets of all channels", |guest| guest.pulses_us().iter().all(Option::is_some));

    // Armed, a slider moves its servo to its end and not beyond.
    jog_to_its_end(&mut browser, &guest, JAW_US[1]);
    browser.screenshot("guest-5-armed");
    // A service that is killed ends the jog, and comes back without it.
    guest.kill_service();
    browser.wait_for_text("Moving by hand has ended");
    browser.wait_until("document.querySelector('.board .state-good')");
    browser.click("Arm");
    browser.wait_for_text("Armed.");
    browser.click("STOP");
    browser.wait_for_text("All servos are released");
    guest.wait("servos without pulses", |guest| guest.pulses_us() == [Some(0); SERVOS.len()]);
    browser.wait_for_text("Arm");
    browser.screenshot("guest-6-stopped");
    // They stay released, even if the service is killed.
    guest.kill_service();
    go_to(&mut browser, "servos", "connected");
    browser.wait_until("document.querySelector('.board .state-good')");
    browser.wait_for_text("All servos are released");
    assert_eq!(guest.pulses_us(), [Some(0); SERVOS.len()]);
    browser.click("Let servos move again");
    guest.wait("pulses of all channels", |guest| guest.pulses_us().iter().all(|pulse| pulse.is_some_and(|us| us > 0)));

    browser.wait_until("document.getElementById('state').textContent.startsWith('live')");
    let is_whole = env::var("FACEWIRE_TEST_ALL").is_ok_and(|all| all == "1");
    if is_whole {
        calibrate(&mut browser, &guest);
    }

    fs::write(guest.0.join("restart"), "").unwrap();
    guest.await_file("restarted");
    guest.wait("targets after the restart", |guest| guest.pulses_us().iter().all(Option::is_some));
    let jaw_us = guest.pulses_us()[JAW].unwrap();
    assert!((JAW_US[0]..=JAW_US[1]).contains(&jaw_us), "{jaw_us}");
    let kept = fs::read_to_string(guest.0.join("kept.toml")).unwrap();
    assert!(SERVOS.iter().all(|name| kept.contains(&format!("name = \"{name}\""))), "{kept}");
    log_in(&mut browser, &url);
    browser.resize(1280, 900);
    browser
        .wait_until("['live', 'hold'].some((state) => document.getElementById('state').textContent.startsWith(state))");
    browser.screenshot("guest-9-restarted");
    if is_whole {
        go_to(&mut browser, "wearer", "Wearers");
        browser.wait_until("document.querySelector('article[aria-label=anna]').innerText.includes('in use')");
        let anna = browser.value("document.querySelector('article[aria-label=anna]').innerText");
        assert!(anna.as_str().unwrap().contains("at every start"), "{anna}");
    }
    let failures = browser.events("Runtime.exceptionThrown");
    assert!(failures.is_empty(), "{}", failures[0]["exceptionDetails"]["exception"]["description"]);
}
