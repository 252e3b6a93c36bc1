//! The service as a process, observed from outside.

use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use facewire_packet::Packet;

use super::SERVICE;
use super::common::service::{Receiver, Service};

/// Fields of a thread's `stat`, counted after its name: minor and major page faults.
const FAULT_FIELDS: [usize; 2] = [7, 9];

pub type Arrival = (Instant, Packet);

/// The service with a receiver that never goes away.
pub struct Process {
    pub service: Service,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    arrivals: Arc<Mutex<Vec<Arrival>>>,
    /// The threads that handle a frame: the hot loop and the sender.
    pub threads: [i32; 2],
}

pub struct Sample {
    pub at: Instant,
    /// Counts of the hot loop and the sender since they started.
    pub allocations: [u64; 2],
    pub page_faults: [u64; 2],
    pub resident_kib: usize,
    pub descriptors: usize,
}

impl Process {
    /// Starts the service with these settings and another link, to the receiver.
    pub fn start(toml: &str) -> Self {
        let receiver = Receiver::new();
        let this = Command::new(std::env::current_exe().unwrap());
        let mut service =
            Service::of(this, toml, &[receiver.address()], |command| command.env(SERVICE, "1").stdin(Stdio::piped()));
        let arrivals = Arc::<Mutex<Vec<Arrival>>>::default();
        let collected = Arc::clone(&arrivals);
        receiver.0.set_read_timeout(None).unwrap();
        thread::spawn(move || {
            loop {
                let packet = receiver.packet();
                collected.lock().unwrap().push((Instant::now(), packet));
            }
        });
        let (requests, answers) = (service.child.stdin.take().unwrap(), service.child.stdout.take().unwrap());
        let threads = ["fw-hot", "fw-sender"].map(|name| service.thread(name));
        Self { service, requests, answers: BufReader::new(answers), arrivals, threads }
    }

    pub fn packets(&self) -> Vec<Arrival> {
        std::mem::take(&mut self.arrivals.lock().unwrap())
    }

    pub fn sample(&mut self) -> Sample {
        self.requests.write_all(b"\n").unwrap();
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        let allocations = |thread: i32| {
            let mut pairs = answer.split_whitespace().filter_map(|pair| pair.split_once(':'));
            pairs.find(|(number, _)| *number == thread.to_string()).map_or(0, |(_, count)| count.parse().unwrap())
        };
        let page_faults = |thread: i32| {
            let stat = self.service.proc(&format!("task/{thread}/stat"));
            let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
            FAULT_FIELDS.iter().map(|field| fields[*field].parse::<u64>().unwrap()).sum()
        };
        Sample {
            at: Instant::now(),
            allocations: self.threads.map(allocations),
            page_faults: self.threads.map(page_faults),
            resident_kib: self.service.kib("VmRSS:"),
            descriptors: fs::read_dir(format!("/proc/{}/fd", self.service.child.id())).unwrap().count(),
        }
    }

    /// Stops the service. Returns the packets that came meanwhile, and the log.
    pub fn stop(self) -> (Vec<Arrival>, String) {
        let log = self.service.stopped();
        thread::sleep(Duration::from_millis(300));
        let rest = std::mem::take(&mut *self.arrivals.lock().unwrap());
        (rest, log)
    }
}
