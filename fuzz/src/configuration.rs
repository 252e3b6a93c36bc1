//! Checks the reader of settings.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use facewire::config::{BOARDS, Faults, Settings, load, parse_and_check};
use facewire::link::{check_settings, notes};

/// The name of a table that does not exist. Adding it is a fault that affects no other setting.
const ONE_MORE: &str = "no_such_table";

static FILE: LazyLock<PathBuf> =
    LazyLock::new(|| std::env::temp_dir().join(format!("facewire-fuzz-{}.toml", std::process::id())));

/// Checks that any file, over the settings of any board (the first byte, `1` to `8`, chooses one), is accepted or refused
/// with faults that each fill one line and name an existing line. An additional fault is reported beside all others, unless
/// these are as many as are named.
pub fn configuration(data: &[u8]) {
    fs::write(&*FILE, data).unwrap();
    let board = data.first().and_then(|first| BOARDS.get(usize::from(first.wrapping_sub(b'1'))));
    let settled = load(board.map(|(name, _)| *name), "pi4", Some(&FILE), check);
    fs::remove_file(&*FILE).unwrap();
    let Ok(text) = str::from_utf8(data) else {
        let faults = settled.unwrap_err();
        assert!(faults.to_string().contains(": cannot be read ("), "{faults}");
        return;
    };
    judge(&settled, &FILE.display().to_string(), text);
    let alone = parse_and_check("file", text, check);
    judge(&alone, "file", text);
    tells_one_more_fault(&alone, text);
}

fn check(settings: &Settings, faults: &mut Faults) {
    check_settings(settings, &[], faults);
}

fn judge(settled: &Result<Settings, Faults>, source: &str, text: &str) {
    match settled {
        Ok(settings) => assert!(notes(settings).iter().all(|note| !note.contains(char::is_control))),
        Err(faults) => {
            assert!(faults.iter().next().is_some());
            faults.iter().for_each(|fault| judge_fault(fault, source, text));
        }
    }
}

fn judge_fault(fault: &str, source: &str, text: &str) {
    assert!(!fault.is_empty() && !fault.contains(char::is_control), "{fault:?}");
    if let Some(place) = fault.strip_prefix(&format!("{source}:")) {
        let line = place.split(':').next().and_then(|line| line.parse::<usize>().ok());
        assert!(line.is_some_and(|line| (1..=text.split('\n').count()).contains(&line)), "{fault}");
    }
}

fn tells_one_more_fault(settled: &Result<Settings, Faults>, text: &str) {
    let before = told(settled);
    let hides_more = |fault: &String| fault.contains("not valid TOML") || fault.contains("may have more faults");
    if text.contains(ONE_MORE) || before.iter().any(hides_more) {
        return;
    }
    let mut after = told(&parse_and_check("file", &format!("{text}\n[{ONE_MORE}]\n"), check));
    let added = after.iter().position(|fault| fault.contains(ONE_MORE));
    after.remove(added.unwrap());
    assert_eq!(after, before);
}

fn told(settled: &Result<Settings, Faults>) -> Vec<String> {
    settled.as_ref().err().map_or_else(Vec::new, |faults| faults.iter().map(str::to_owned).collect())
}
