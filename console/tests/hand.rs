//! Rules for the tests of pages, in which scripts only look and all actions go through keys, mouse and touch, for the hand that
//! does them, and for the controls of pages.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    fs,
    path::{Path, PathBuf},
};

use common::{browser::Browser, skip};

/// A button that trades places with another one once the hand has seen where it is.
const UNSTEADY: &str = "data:text/html,<meta name=viewport content=width=device-width><body style='display:flex'>\
    <button>First</button><button>Second</button><script>\
    window.got = []; addEventListener('click', ({ target }) => target.matches('button') && got.push(target.innerText));\
    Object.defineProperty(window, 'hand', { get() { return this.own; }, \
    set(hand) { this.own = hand; document.body.style.flexDirection = 'row-reverse'; \
    document.body.style.justifyContent = 'flex-end'; } });</script>";

/// What a script could do in place of keys, mouse and touch. The words are split, so that they are not found here.
const DEEDS: [&str; 20] = [
    concat!(".va", "lue ="),
    concat!(".va", "lue="),
    concat!(".valueAs", "Number ="),
    concat!(".che", "cked ="),
    concat!(".sele", "cted ="),
    concat!(".selected", "Index ="),
    concat!(".inner", "Text ="),
    concat!(".text", "Content ="),
    concat!(".cli", "ck()"),
    concat!(".fo", "cus("),
    concat!(".bl", "ur("),
    concat!(".sele", "ct("),
    concat!(".sub", "mit("),
    concat!(".request", "Submit("),
    concat!(".res", "et("),
    concat!("dispatch", "Event("),
    concat!("setRange", "Text"),
    concat!("exec", "Command"),
    concat!("location.ha", "sh ="),
    concat!("history", ".back"),
];

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            files(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// Returns the lines below a folder that break a rule, with their places.
fn lines(folder: &str, breaks: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    files(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder), &mut found);
    assert!(found.len() > 5, "{folder}: {found:?}");
    let mut broken = Vec::new();
    for path in found {
        let text = fs::read_to_string(&path).unwrap();
        let lines = text.lines().enumerate().filter(|(_, line)| breaks(line));
        broken.extend(lines.map(|(number, line)| format!("{}:{}: {}", path.display(), number + 1, line.trim())));
    }
    broken
}

#[test]
fn no_test_does_by_a_script_in_the_page_what_a_hand_does() {
    let comparison = |line: &str, deed: &str| line.split(deed).skip(1).all(|rest| rest.starts_with('='));
    let broken = lines("tests", |line| DEEDS.iter().any(|deed| line.contains(deed) && !comparison(line, deed)));
    assert!(broken.is_empty(), "use the keys, the mouse and the thumb of common/browser.rs:\n{}", broken.join("\n"));
}

#[test]
fn no_control_of_a_page_waits_for_the_end_of_a_change_but_those_that_hold_what_is_put_in() {
    let broken = lines("page", |line| line.contains("onChange="));
    let broken: Vec<_> = broken.into_iter().filter(|place| !place.contains("page/hand.js:")).collect();
    assert!(broken.is_empty(), "every status writes over such a field, so use one of hand.js:\n{}", broken.join("\n"));
}

#[test]
fn a_hand_clicks_nothing_else_where_its_control_has_been() {
    if !Browser::is_installed() {
        return skip("there is no chromium; scripts/setup tests installs it");
    }
    for width in [360, 1280] {
        let mut browser = Browser::start(width, 740);
        browser.open(UNSTEADY);
        browser.click("First");
        assert_eq!(browser.value("got.join()"), "First", "at a width of {width}");
    }
}
