//! VRChat on another machine: a receiver of OSC that another implementation of mDNS advertises, in a network of its own.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    io::{BufRead as _, BufReader, Write as _},
    process::{Child, Command, Stdio},
};

use common::{eventually, interface::Interface, python_with, service::Console, skip};
use serde_json::{Value, json};

const ADDRESS: &str = "10.77.0.2";

/// A machine at the other end of the cable of [`Interface`], with what `vrchat.py` runs there.
struct Machine(Child);

impl Machine {
    /// Starts it, and waits until it has another receiver of OSC than VRChat, and a program that answers falsely.
    fn start() -> Option<Self> {
        let Some(python) = python_with("venv-tests", "zeroconf") else {
            skip("there is no zeroconf; scripts/setup tests installs it");
            return None;
        };
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/vrchat.py");
        let mut command = Command::new("unshare");
        command.arg("--net").arg(python).args([script, "face1", ADDRESS]);
        let mut machine = Self(command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap());
        let network = machine.0.id().to_string();
        let network_of = |process: &str| std::fs::read_link(format!("/proc/{process}/ns/net")).unwrap();
        eventually("a network of its own", || network_of(&network) != network_of("self"));
        let moved = Command::new("ip").args(["link", "set", "face1", "netns", &network]).status();
        assert!(moved.unwrap().success());
        let mut lines = BufReader::new(machine.0.stdout.take().unwrap()).lines();
        assert_eq!(lines.next().unwrap().unwrap(), "ready");
        Some(machine)
    }

    fn start_vrchat(&mut self) {
        writeln!(self.0.stdin.as_ref().unwrap()).unwrap();
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The links of a status, as pairs of the receiver and what is known of VRChat.
fn links(event: &Value) -> Value {
    let links = event.pointer("/service/links").and_then(Value::as_array);
    let of_vrchat = links.into_iter().flatten().filter(|link| link["kind"] == "vrchat");
    of_vrchat.map(|link| json!([link["name"], link["vrchat"]])).collect()
}

#[test]
fn a_link_shows_that_vrchat_answers_once_it_does_and_one_with_another_address_where_it_does() {
    let name = "a_link_shows_that_vrchat_answers_once_it_does_and_one_with_another_address_where_it_does";
    let Some(_interface) = Interface::inside(name) else { return };
    let Some(mut machine) = Machine::start() else { return };
    let console = Console::start("");
    let receivers = ["10.77.0.2:9000", "10.77.0.2:9001", "127.0.0.1:9000", "239.255.0.1:9000"];
    let link = |receiver| {
        let name = format!("vrchat {receiver}");
        json!({"name": name, "kind": "vrchat", "open": true, "sent": 5, "dropped": 0})
    };
    console.service.seen.lock().unwrap().more_links = receivers.map(link).to_vec();
    let mut events = console.viewer.events();
    assert!(events.status().contains("200"));
    let shown = |answers: [bool; 3], elsewhere: [&[&str]; 3]| {
        let links = receivers.iter().enumerate().map(|(place, receiver)| {
            let known = answers.get(place).map(|answers| json!({"answers": answers, "elsewhere": elsewhere[place]}));
            json!([format!("vrchat {receiver}"), known])
        });
        links.collect::<Value>()
    };
    eventually("no answer", || links(&events.next()) == shown([false; 3], [&[]; 3]));
    machine.start_vrchat();
    let there: &[&str] = &["10.77.0.2:9000"];
    eventually("the answer", || links(&events.next()) == shown([true, false, false], [&[], there, there]));
}
