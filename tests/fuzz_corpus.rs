//! The promises of the fuzz targets hold for every file of the corpus, including inputs that once broke one.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, clippy::float_cmp, clippy::type_complexity)]

#[path = "../fuzz/src/lib.rs"]
mod targets;

use std::fs;

/// Runs the target on every file in its folder, and on no bytes at all.
fn keeps_its_promise(target: fn(&[u8]), name: &str) {
    let folder = format!("{}/fuzz/corpus/{name}", env!("CARGO_MANIFEST_DIR"));
    let mut files: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(files.len() >= 3, "{folder} holds {} files", files.len());
    files.sort();
    for file in files {
        println!("{}", file.display());
        target(&fs::read(file).unwrap());
    }
    target(&[]);
}

#[test]
fn packet_corpus() {
    keeps_its_promise(targets::packet, "packet");
}

#[test]
fn cobs_stream_corpus() {
    keeps_its_promise(targets::cobs_stream, "cobs_stream");
}

#[test]
fn configuration_corpus() {
    keeps_its_promise(targets::configuration, "configuration");
}

#[test]
fn frame_intake_corpus() {
    keeps_its_promise(targets::frame_intake, "frame_intake");
}

#[test]
fn model_file_corpus() {
    keeps_its_promise(targets::model_file, "model_file");
}

#[test]
fn profile_file_corpus() {
    keeps_its_promise(targets::profile_file, "profile_file");
}

#[test]
fn recording_corpus() {
    keeps_its_promise(targets::recording, "recording");
}

#[test]
fn receiver_corpus() {
    keeps_its_promise(targets::receiver, "receiver");
}

#[test]
fn network_file_corpus() {
    keeps_its_promise(targets::network_file, "network_file");
}

#[test]
fn network_corpus() {
    keeps_its_promise(targets::network, "network");
}

#[test]
fn y4m_corpus() {
    keeps_its_promise(targets::y4m, "y4m");
}

#[test]
fn avi_corpus() {
    keeps_its_promise(targets::avi, "avi");
}

#[test]
fn subscription_corpus() {
    keeps_its_promise(targets::subscription, "subscription");
}
