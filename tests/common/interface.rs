//! A network interface for one test, in a network namespace of the kernel that has no other network.

use std::env;
use std::process::{Command, Stdio};

use super::skip;

const INSIDE: &str = "FACEWIRE_TEST_NETWORK";
/// Prepares the namespace: the interface is one end of a virtual cable, whose other end is always up.
const PREPARE: &str = "ip link set lo up && ip link add face0 type veth peer name face1 && \
                       ip address add 10.77.0.1/24 dev face0 && ip link set face1 up && ip link set face0 up";

/// The interface `face0` with the address [`Interface::ADDRESS`].
pub struct Interface;

impl Interface {
    pub const ADDRESS: &str = "10.77.0.1";

    /// Runs the calling test, whose name is `test`, again in a namespace with this interface alone, and returns it there.
    /// Returns `None` in the first process, after the other one has passed, or after the test was skipped because this
    /// machine allows no namespace.
    pub fn inside(test: &str) -> Option<Self> {
        if env::var_os(INSIDE).is_some() {
            return Some(Self);
        }
        if !isolated(&["true"]).output().unwrap().status.success() {
            skip("this machine allows no network of its own to a test (unshare --user --net, ip link add type veth)");
            return None;
        }
        let program = env::current_exe().unwrap();
        let mut this = isolated(&[program.to_str().unwrap(), "--exact", test, "--nocapture"]);
        succeed(this.env(INSIDE, "1"));
        None
    }

    /// Takes the interface and its address away, as the system does when a cable is pulled or Wi-Fi is lost.
    pub fn take_down(&self) {
        ip("address flush dev face0");
        ip("link set face0 down");
    }

    pub fn bring_up(&self) {
        ip("link set face0 up");
        ip("address add 10.77.0.1/24 dev face0");
    }
}

fn ip(words: &str) {
    succeed(Command::new("ip").args(words.split(' ')));
}

/// Runs a command to its end, and fails the test with what it has said unless it succeeds.
fn succeed(command: &mut Command) {
    let output = command.stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}

/// Returns a command that runs these words in a new namespace that has been prepared.
fn isolated(words: &[&str]) -> Command {
    let mut command = Command::new("unshare");
    command
        .args(["--user", "--map-root-user", "--net", "sh", "-c", &format!("{PREPARE} && exec \"$@\""), "sh"])
        .args(words);
    command
}
