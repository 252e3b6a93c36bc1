//! The documents refer to what exists: their links lead to files and headings, and the settings that they show load.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

use std::fs;
use std::path::{Path, PathBuf};

use facewire::config::parse_and_check;
use facewire::link::check_settings;

/// Every document for users: those in the top folder, in `docs`, and the README of each folder.
fn documents() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let in_folder =
        |folder: &Path| -> Vec<PathBuf> { fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect() };
    let is_document = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "md");
    let mut paths: Vec<_> =
        in_folder(root).into_iter().chain(in_folder(&root.join("docs"))).filter(is_document).collect();
    paths.extend(in_folder(root).iter().map(|folder| folder.join("README.md")).filter(|path| path.exists()));
    paths.into_iter().map(|path| (path.clone(), fs::read_to_string(path).unwrap())).collect()
}

/// The targets of all links in a document.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

/// The part of a link that leads to a heading: lower case, with hyphens for spaces and without other characters.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|character| character.is_alphanumeric() || " -_".contains(*character));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

fn has_heading(text: &str, wanted: &str) -> bool {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    headings.map(anchor).any(|found| found == wanted)
}

#[test]
fn every_link_between_documents_leads_to_a_file_and_to_a_heading_in_it() {
    for (path, text) in documents() {
        for link in links(&text).filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: there is no {link}", path.display());
            let is_found = heading.is_empty() || has_heading(&fs::read_to_string(&target).unwrap(), heading);
            assert!(is_found, "{}: {link} has no such heading", path.display());
        }
    }
}

/// The blocks of settings in a document: in a fence marked `toml`, or indented and beginning with a table.
fn settings(text: &str) -> Vec<String> {
    let mut blocks: Vec<String> =
        text.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap().into()).collect();
    let paragraphs = text.split("\n\n").filter(|paragraph| paragraph.starts_with("    ["));
    blocks.extend(paragraphs.map(|paragraph| paragraph.lines().map(|line| line.trim().to_owned() + "\n").collect()));
    blocks
}

/// The tables of systemd's units, which documents show, too.
const UNIT_TABLES: [&str; 3] = ["[Service]", "[Unit]", "[Journal]"];

#[test]
fn every_block_of_settings_in_a_document_loads() {
    let (mut count, check) = (0, |settings: &_, faults: &mut _| check_settings(settings, &[], faults));
    for (path, text) in documents() {
        for block in settings(&text) {
            let is_unit = UNIT_TABLES.iter().any(|table| block.starts_with(table));
            if !is_unit && let Err(faults) = parse_and_check(&path.display().to_string(), &block, check) {
                panic!("{faults}\nin\n{block}");
            }
            count += 1;
        }
    }
    assert!(count > 5, "{count} blocks");
}
