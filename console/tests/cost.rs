//! What the program costs while packets come and a page is open.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;

use common::{Sending, Viewer, memory_kb, packet};

/// Ticks of a second in `/proc/PID/stat`.
const TICKS_HZ: f64 = 100.0;

/// Returns the processor time of a process in seconds.
fn cpu_s(pid: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    fields[11..13].iter().map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>() / TICKS_HZ
}

#[test]
fn at_60_packets_a_second_and_one_page_it_takes_little_of_a_core_and_of_memory() {
    let viewer = Viewer::start();
    let mut events = viewer.events();
    let sending = Sending::to(viewer.packets_to(), packet(&[("jawOpen", 0.123), ("mouthSmileLeft", 0.456)]));
    let first = events.until(|event| event["packets"].as_u64() > Some(60));
    let before_s = cpu_s(viewer.pid());
    let last = events.until(|event| event["packets"].as_u64() > Some(260));
    let span_s = last["packet"]["time_s"].as_f64().unwrap() - first["packet"]["time_s"].as_f64().unwrap();
    let share = (cpu_s(viewer.pid()) - before_s) / span_s;
    let program = fs::metadata(env!("CARGO_BIN_EXE_facewire-console")).unwrap().len();
    println!(
        "program {:.1} MB, peak memory {:.1} MB, {:.2} % of a core at {:.0} packets a second",
        program as f64 / 1e6,
        memory_kb(viewer.pid(), "VmHWM") as f64 / 1e3,
        100.0 * share,
        200.0 / span_s
    );
    assert!(share < 0.1 && memory_kb(viewer.pid(), "VmHWM") < 24_000);
    drop(sending);
}
