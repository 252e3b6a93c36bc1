//! Recordings, as a user meets them: made beside the service or without one, sent again, and tracked.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, clippy::float_cmp)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use common::program::{Run, facewire, settings, text};
use common::service::{DEMO, Receiver, Service};
use facewire::recording::{Reader, Recorded, Writer};
use facewire_face::Landmarks;
use facewire_packet::{Packet, Pose, Reason, State};
use tempfile::TempDir;

const JAW_OPEN: usize = 17;

fn place() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("face.fwrec");
    (folder, path)
}

/// `facewire record` with these arguments. A service that runs for this test has its socket in `runtime`.
fn record(path: &Path, arguments: &[&str], runtime: &Path) -> Command {
    let mut command = facewire(["record", text(path)].into_iter().chain(arguments.iter().copied()));
    command.env("XDG_RUNTIME_DIR", runtime);
    command
}

fn frames(path: &Path) -> Vec<Recorded> {
    let mut reader = Reader::open(path).unwrap();
    std::iter::from_fn(|| reader.next_frame().unwrap()).collect()
}

/// A recording of a jaw that opens by 1 % a frame, with a frame without a face at the end.
fn opening_jaw(path: &Path) {
    let mut writer = Writer::create(path, u64::MAX).unwrap();
    for number in 0..30_u8 {
        let mut pose = Pose::NEUTRAL;
        pose.coefficients[JAW_OPEN] = f32::from(number) / 100.0;
        let landmarks = Landmarks([[320.0, 240.0, 0.0]; 478]);
        let frame = Recorded::new(u64::from(number) * 20_000, &pose, [640.0, 480.0], Some(&landmarks));
        assert!(writer.push(&frame).unwrap());
    }
    assert!(writer.push(&Recorded::nothing(600_000, Reason::NoFace)).unwrap());
    writer.finish().unwrap();
}

#[test]
fn recording_of_a_camera_is_tracked_again_with_its_own_times_and_no_file_is_replaced() {
    let ((folder, path), file) = (place(), settings(DEMO));
    let run = || Run::of(&mut record(&path, &["--seconds", "2", "--config", text(file.path())], folder.path()));
    let said = run().succeeded().err;
    assert!(said.contains("no service answers: opening the camera") && said.contains(" frames in "), "{said}");
    let recorded = frames(&path);
    assert!(recorded.iter().any(|frame| frame.landmarks.is_some()) && recorded[0].time_us == 0);
    let csv = Run::of(&mut facewire(["track", text(&path)])).succeeded().out;
    let times: Vec<f64> = csv.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    let want: Vec<f64> = recorded.iter().map(|frame| frame.time_us as f64 * 1e-6).collect();
    assert!(times.len() == want.len() && times.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-6), "{times:?}");
    assert!(run().sentence(74).contains("give another name"));
    assert_eq!(frames(&path).len(), recorded.len());
}

#[test]
fn service_is_recorded_while_it_goes_on_sending_what_the_recording_holds() {
    let ((folder, path), receiver) = (place(), Receiver::new());
    let service =
        Service::start_with(DEMO, &[receiver.address()], |command| command.env("XDG_RUNTIME_DIR", folder.path()));
    receiver.live();
    let mut sent = Vec::new();
    thread::scope(|scope| {
        let recording = scope.spawn(|| Run::of(&mut record(&path, &["--seconds", "3"], folder.path())));
        // A socket that nobody reads for seconds loses packets.
        while !recording.is_finished() {
            sent.push(receiver.packet());
        }
        recording.join().unwrap().succeeded();
    });
    sent.extend(receiver.rest());
    service.stopped();
    let recorded = frames(&path);
    // A busy machine may not send each pose.
    let is_recorded = |packet: &Packet| {
        recorded.iter().any(|frame| frame.pose.is_ok_and(|pose| pose.coefficients == packet.coefficients))
    };
    let live = sent.iter().filter(|packet| packet.state == State::Live);
    assert!(live.clone().any(is_recorded), "{} frames and {} packets", recorded.len(), live.count());
}

#[test]
fn replay_sends_the_recorded_faces_in_order_and_moves_to_neutral_at_the_end() {
    let ((_folder, path), receiver) = (place(), Receiver::new());
    opening_jaw(&path);
    let file = settings(&format!("[[link]]\naddress = \"{}\"\n", receiver.address()));
    let said = Run::of(&mut facewire(["replay", text(&path), "--config", text(file.path())])).succeeded().err;
    assert!(said.contains("31 frames"), "{said}");
    let sent = receiver.rest();
    let jaw: Vec<f32> =
        sent.iter().filter(|packet| packet.state == State::Live).map(|packet| packet.coefficients[JAW_OPEN]).collect();
    assert!(!jaw.is_empty() && jaw.is_sorted(), "{jaw:?}");
    let last = sent.last().unwrap();
    assert_eq!((last.state, last.reason, last.coefficients[JAW_OPEN]), (State::Neutral, Reason::Stopping, 0.0));
}

#[test]
fn recording_that_was_cut_off_is_replayed_to_its_last_complete_second_and_other_files_are_refused() {
    let ((folder, path), file) = (place(), settings("[[link]]\naddress = \"127.0.0.1:9\"\n"));
    opening_jaw(&path);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let replay = |path: &Path| Run::of(&mut facewire(["replay", text(path), "--config", text(file.path())]));
    assert!(replay(&path).succeeded().err.contains(" 0 frames"));
    assert!(replay(file.path()).sentence(65).contains("is no recording of facewire"));
    assert!(replay(&folder.path().join("missing")).sentence(66).contains("cannot be read"));
}
