use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use super::super::profile_file::tests::file;
use super::*;

fn name(text: &str) -> WearerName {
    WearerName::new(text).unwrap()
}

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path().join("facewire").to_str().unwrap());
    (folder, store)
}

/// What the folder holds, hidden files included.
fn content(store: &Store) -> Vec<String> {
    let entries = fs::read_dir(store.folder()).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn profiles_of_two_wearers_are_kept_apart_listed_and_deleted() {
    let (_folder, store) = store();
    assert_eq!(store.wearers().unwrap(), []);
    let (anna, bert) = (name("anna"), name("bert"));
    store.save(&bert, &file(1)).unwrap();
    store.save(&anna, &file(2)).unwrap();
    store.save(&anna, &file(3)).unwrap();
    assert_eq!(store.wearers().unwrap(), [anna.clone(), bert.clone()]);
    assert_eq!([&anna, &bert].map(|name| store.load(name).unwrap()), [file(3), file(1)]);
    store.delete(&anna).unwrap();
    assert!(matches!(store.load(&anna), Err(StoreError::Missing(_))));
    assert!(matches!(store.delete(&anna), Err(StoreError::Missing(_))));
    assert_eq!(content(&store), ["bert.toml"]);
}

#[test]
fn nobody_else_can_read_a_profile() {
    let (_folder, store) = store();
    let path = store.save(&name("anna"), &file(1)).unwrap().0;
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!([mode(store.folder()), mode(&path)], [0o700, 0o600]);
}

#[test]
fn damaged_profile_is_told_with_its_file_and_the_remedy() {
    let (_folder, store) = store();
    let path = store.save(&name("anna"), &file(1)).unwrap().0;
    let whole = fs::read(&path).unwrap();
    for damaged in [&whole[..whole.len() / 2], b"", b"\xff\xfe", &b" ".repeat(1 << 20)] {
        fs::write(&path, damaged).unwrap();
        let error = store.load(&name("anna")).unwrap_err().to_string();
        assert!(error.starts_with(path.to_str().unwrap()), "{error}");
        assert!(error.contains("facewire calibrate --wearer anna"), "{error}");
    }
}

#[test]
fn folder_and_pipe_in_place_of_a_profile_are_refused() {
    let (_folder, store) = store();
    fs::create_dir_all(store.folder().join("anna.toml")).unwrap();
    assert!(matches!(store.load(&name("anna")), Err(StoreError::Unreadable(_))));
    assert!(matches!(store.save(&name("anna"), &file(1)), Err(StoreError::Unwritable(_))));
    assert_eq!(content(&store), ["anna.toml"], "nothing is left behind");
    assert!(Command::new("mkfifo").arg(store.folder().join("bert.toml")).status().unwrap().success());
    assert!(matches!(store.load(&name("bert")), Err(StoreError::Bad(_))));
}

#[test]
fn rest_of_an_interrupted_attempt_does_no_harm() {
    let (_folder, store) = store();
    fs::create_dir_all(store.folder()).unwrap();
    fs::write(store.folder().join(".anna.new"), "half a prof").unwrap();
    assert_eq!(store.wearers().unwrap(), []);
    store.save(&name("anna"), &file(1)).unwrap();
    assert_eq!(content(&store), ["anna.toml"]);
}

#[test]
fn folder_that_cannot_be_synced_does_not_hide_that_the_new_profile_is_in_place() {
    let (_folder, mut store) = store();
    store.save(&name("anna"), &file(1)).unwrap();
    store.sync_folder = |_| Err(io::Error::other("no answer"));
    let (path, warning) = store.save(&name("anna"), &file(2)).unwrap();
    assert!(warning.is_some_and(|warning| warning.contains("no answer") && warning.contains("check the disk")));
    assert!(path.exists());
    assert_eq!(store.load(&name("anna")).unwrap(), file(2));
}

/// The folder in which `full_disk_leaves_the_former_profile` lets a process with a limit on the size of files write.
const LIMITED: &str = "FACEWIRE_TEST_LIMITED_FOLDER";

#[test]
fn full_disk_leaves_the_former_profile() {
    if let Ok(folder) = std::env::var(LIMITED) {
        let error = Store::new(&folder).save(&name("anna"), &file(2)).unwrap_err().to_string();
        assert!(error.contains("anna.toml") && error.contains("free some space"), "{error}");
        return;
    }
    let (_folder, store) = store();
    store.save(&name("anna"), &file(1)).unwrap();
    // A write beyond the limit fails like one to a full disk, and after some of it has been written.
    let test = "calibration::store::tests::full_disk_leaves_the_former_profile";
    let script = format!("trap '' XFSZ; ulimit -f 8; exec \"$0\" --exact {test} --nocapture");
    let mut child = Command::new("sh");
    child.args(["-c", &script]).arg(std::env::current_exe().unwrap()).env(LIMITED, store.folder());
    let output = child.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.contains("1 passed"), "{output:?}");
    assert_eq!(store.load(&name("anna")).unwrap(), file(1));
    assert_eq!(content(&store), ["anna.toml"]);
}

#[test]
fn folder_is_that_of_the_settings_the_manager_the_system_or_the_user() {
    let choose = |setting, variables: &[(&str, &str)], is_readable| {
        let variable = |name: &str| variables.iter().find(|(known, _)| *known == name).map(|(_, v)| (*v).to_owned());
        folder(setting, variable, |_| is_readable).to_str().unwrap().to_owned()
    };
    let home = ("HOME", "/home/a");
    assert_eq!(choose("/data", &[("STATE_DIRECTORY", "/var/lib/x")], true), "/data");
    assert_eq!(choose("", &[("STATE_DIRECTORY", "/var/lib/x:/var/lib/y"), home], true), "/var/lib/x");
    assert_eq!(choose("", &[home], true), "/var/lib/facewire");
    assert_eq!(choose("", &[home], false), "/home/a/.local/state/facewire");
    assert_eq!(choose("", &[home, ("XDG_STATE_HOME", "/state")], false), "/state/facewire");
    assert_eq!(choose("", &[home, ("XDG_STATE_HOME", "relative")], false), "/home/a/.local/state/facewire");
    assert_eq!(choose("", &[], false), "/var/lib/facewire");
}

#[test]
fn names_that_could_be_paths_options_or_hidden_files_are_refused() {
    for bad in ["", ".", "..", "a/b", "../a", ".a", "-a", "a b", "a\n", "a\0", "é", "a.toml", &"a".repeat(33)] {
        assert_eq!(WearerName::new(bad), None, "{bad:?}");
    }
    for good in ["anna", "Anna-2", "_", "7", &"a".repeat(32)] {
        assert_eq!(WearerName::new(good).map(|name| name.to_string()).as_deref(), Some(good));
    }
}
