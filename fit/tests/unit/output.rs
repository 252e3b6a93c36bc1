use std::fs::{self};

use facewire_fit::output::*;

#[test]
fn checking_a_path_leaves_no_trace() {
    let folder = tempfile::tempdir().expect("a folder");
    let [new, old] = ["new", "old"].map(|name| folder.path().join(name));
    fs::write(&old, "kept").expect("written");
    check(&new).expect("can be written");
    check(&old).expect("can be written");
    assert!(!new.exists() && fs::read(&old).expect("still there") == b"kept");
    let refusal = check(&folder.path().join("absent/new")).expect_err("no such folder").to_string();
    assert!(refusal.contains("cannot write") && refusal.contains("absent/new"), "{refusal}");
    assert!(check(folder.path()).is_err(), "a folder");
}

#[test]
fn a_table_is_aligned_as_text_and_names_of_blendshapes_are_links_on_a_page() {
    let rows = [["jawOpen", "0.5"], ["mean", "-"]].map(|row| row.map(Cell::from).into());
    let table = Table::new(["blendshape", "r"], rows).linked();
    let text = "| blendshape |   r |\n|------------|----:|\n| jawOpen    | 0.5 |\n| mean       |   - |\n";
    assert_eq!(table.text(), text);
    let page = table.html().into_string();
    assert!(page.contains("<a href=\"#jawOpen\">jawOpen</a>") && page.contains("<td>-</td>"), "{page}");
    assert!(!page.contains("#mean"), "{page}");
}
