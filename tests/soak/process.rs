//! The service as a process, observed from outside.

use std::fs;
use std::io::{BufRead as _, BufReader, IoSliceMut, Write as _};
use std::os::fd::AsRawFd as _;
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use facewire_packet::{PACKET_BYTES, Packet};
use nix::cmsg_space;
use nix::errno::Errno;
use nix::sys::socket::sockopt::{RcvBuf, ReceiveTimestampns};
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt};
use nix::sys::time::TimeSpec;

use super::SERVICE;
use super::common::service::{Receiver, Service};

/// Fields of a thread's `stat`, counted after its name.
const MINOR_FAULTS: usize = 7;
const MAJOR_FAULTS: usize = 9;
/// Room for the packets of several seconds, in case this process gets no processor for so long.
const BUFFER_BYTES: usize = 1 << 20;

/// A packet, and when the kernel received it on the system's clock, however late this process reads it.
pub type Arrival = (Duration, Packet);

/// The service with a receiver that never goes away.
pub struct Process {
    pub service: Service,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    receiver: Receiver,
    /// The threads that handle a frame: the hot loop and the sender.
    pub threads: [i32; 2],
}

pub struct Sample {
    pub at: Instant,
    /// Counts of the hot loop and the sender since they started.
    pub allocations: [u64; 2],
    pub minor_faults: [u64; 2],
    pub major_faults: [u64; 2],
    /// How long the sender has waited for a processor since it started.
    pub starved: Duration,
    pub resident_kib: usize,
    pub descriptors: usize,
}

impl Process {
    /// Starts the service with these settings and another link, to the receiver.
    pub fn start(toml: &str) -> Self {
        let receiver = Receiver::new();
        setsockopt(&receiver.0, ReceiveTimestampns, &true).unwrap();
        setsockopt(&receiver.0, RcvBuf, &BUFFER_BYTES).unwrap();
        let this = Command::new(std::env::current_exe().unwrap());
        let mut service =
            Service::of(this, toml, &[receiver.address()], |command| command.env(SERVICE, "1").stdin(Stdio::piped()));
        let requests = service.child.stdin.take().unwrap();
        let answers = BufReader::new(service.child.stdout.take().unwrap());
        let threads = ["fw-hot", "fw-sender"].map(|name| service.thread(name));
        Self { service, requests, answers, receiver, threads }
    }

    /// Returns the packets that have come since the last call.
    pub fn packets(&self) -> Vec<Arrival> {
        arrivals(&self.receiver)
    }

    pub fn sample(&mut self) -> Sample {
        self.requests.write_all(b"\n").unwrap();
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        let allocations = |thread: i32| {
            let mut pairs = answer.split_whitespace().filter_map(|pair| pair.split_once(':'));
            pairs.find(|(number, _)| *number == thread.to_string()).map_or(0, |(_, count)| count.parse().unwrap())
        };
        let faults = |thread: i32, field: usize| {
            let stat = self.service.proc(&format!("task/{thread}/stat"));
            let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
            fields[field].parse().unwrap()
        };
        Sample {
            at: Instant::now(),
            allocations: self.threads.map(allocations),
            minor_faults: self.threads.map(|thread| faults(thread, MINOR_FAULTS)),
            major_faults: self.threads.map(|thread| faults(thread, MAJOR_FAULTS)),
            starved: self.starved(),
            resident_kib: self.service.kib("VmRSS:"),
            descriptors: self.descriptors(),
        }
    }

    pub fn descriptors(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.service.child.id())).unwrap().count()
    }

    /// How long the sender has waited for a processor. The kernel reports nanoseconds, after the time for which the thread ran.
    fn starved(&self) -> Duration {
        let times = self.service.proc(&format!("task/{}/schedstat", self.threads[1]));
        Duration::from_nanos(times.split(' ').nth(1).unwrap().parse().unwrap())
    }

    /// Stops the service. Returns the packets that came meanwhile, and the log.
    pub fn stop(self) -> (Vec<Arrival>, String) {
        let log = self.service.stopped();
        (arrivals(&self.receiver), log)
    }
}

/// Takes the packets that have come.
fn arrivals(receiver: &Receiver) -> Vec<Arrival> {
    let mut arrivals = Vec::new();
    let mut bytes = [0; PACKET_BYTES];
    let mut control = cmsg_space!(TimeSpec);
    loop {
        let mut parts = [IoSliceMut::new(&mut bytes)];
        let descriptor = receiver.0.as_raw_fd();
        let message = match recvmsg::<()>(descriptor, &mut parts, Some(&mut control), MsgFlags::MSG_DONTWAIT) {
            Ok(message) => message,
            Err(Errno::EAGAIN) => return arrivals,
            Err(error) => panic!("{error}"),
        };
        let stamp = message.cmsgs().unwrap().find_map(|message| match message {
            ControlMessageOwned::ScmTimestampns(stamp) => Some(Duration::from(stamp)),
            _ => None,
        });
        arrivals.push((stamp.unwrap(), Packet::decode(&bytes).unwrap()));
    }
}
