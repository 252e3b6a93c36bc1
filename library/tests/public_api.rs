//! The public interface does not change unseen.
#![allow(clippy::unwrap_used)]

#[path = "../../tests/common/skip.rs"]
mod skip;

use std::fs;
use std::process::Command;

#[test]
fn the_public_interface_is_that_of_the_list_in_public_api_txt() {
    let folder = env!("CARGO_MANIFEST_DIR");
    let listed = Command::new("python3").arg(format!("{folder}/public-api")).output().unwrap();
    if listed.status.code() == Some(77) {
        return skip::skip(&String::from_utf8_lossy(&listed.stderr));
    }
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let (found, wanted) =
        (String::from_utf8(listed.stdout).unwrap(), fs::read_to_string(format!("{folder}/public-api.txt")).unwrap());
    let missing = |of: &str, among: &str| {
        of.lines().filter(|line| !among.lines().any(|other| other == *line)).map(str::to_owned).collect::<Vec<_>>()
    };
    let (added, gone) = (missing(&found, &wanted), missing(&wanted, &found));
    assert!(
        added.is_empty() && gone.is_empty(),
        "new: {added:#?}\ngone: {gone:#?}\nIf that is intended, run library/public-api --update; what is gone needs a new version"
    );
}
