use facewire_fit::judge::set::*;

#[test]
fn a_folder_without_films_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("01.csv"), "").expect("written");
    let refusal = Clip::load_all(folder.path(), false).err().expect("refused").to_string();
    assert!(refusal.contains("no .avi files") && refusal.contains("facewire-fit film"), "{refusal}");
}
