//! Random faults of the links, and stops of the thread that runs the inferences, wherever it is.
//!
//! The service's own rehearsal plays the faults of the camera and the face. Changes of settings are not faults, but come
//! as unexpectedly.

use std::net::{SocketAddr, UdpSocket};

use super::SEED;
use super::common::board::{Board, StablePath};
use super::common::stuck::Stuck;
use super::process::Process;

/// On average, the settings change once in so many seconds.
const SETTINGS_RARITY: u32 = 20;
/// Seconds in which the settings change in any case, before anything is judged: the system keeps the memory of the stacks of
/// the threads that prepare a reload, once they have run.
const FIRST_SETTINGS_S: [u32; 3] = [4, 8, 12];
/// After this many changes, a link changes too: the serial port gets another baud rate.
const LINK_CHANGE: u32 = 3;
/// The longest time in which a service takes new settings, on a busy machine.
const LONGEST_PENDING_S: u32 = 60;

/// A fault that comes and goes: on average, it begins once in `rarity` steps, and lasts at most `longest` steps.
struct Fault {
    rarity: u32,
    longest: u32,
    /// For how many more steps the present one lasts; 0 if there is none.
    left: u32,
    count: u32,
}

impl Fault {
    fn new(rarity: u32, longest: u32) -> Self {
        Self { rarity, longest, left: 0, count: 0 }
    }

    /// Returns whether the fault begins (true) or ends (false) in this step, if either.
    fn step(&mut self, random: &mut fastrand::Rng) -> Option<bool> {
        if self.left > 0 {
            self.left -= 1;
            return (self.left == 0).then_some(false);
        }
        let begins = random.u32(0..self.rarity) == 0;
        begins.then(|| {
            self.left = random.u32(1..=self.longest);
            self.count += 1;
            true
        })
    }
}

pub struct Faults {
    random: fastrand::Rng,
    path: StablePath,
    board: Option<Board>,
    address: SocketAddr,
    receiver: Option<UdpSocket>,
    stopped: Option<Stuck>,
    board_pulled: Fault,
    receiver_ended: Fault,
    inference_stopped: Fault,
    seconds: u32,
    changes: u32,
    /// Whether the settings are to be changed once the last change has been taken.
    is_due: bool,
    pending_s: u32,
}

impl Faults {
    pub fn new() -> Self {
        let path = StablePath::new();
        let board = Board::plugged_in();
        path.leads_to(&board);
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        Self {
            random: fastrand::Rng::with_seed(SEED),
            path,
            board: Some(board),
            address: receiver.local_addr().unwrap(),
            receiver: Some(receiver),
            stopped: None,
            board_pulled: Fault::new(80, 40),
            receiver_ended: Fault::new(80, 40),
            inference_stopped: Fault::new(150, 20),
            seconds: 0,
            changes: 0,
            is_due: false,
            pending_s: 0,
        }
    }

    /// Settings with a camera that has random faults, and with the links, after the changes so far.
    pub fn settings(&self) -> String {
        let (hold_ms, neutral_ms) = if self.changes.is_multiple_of(2) { (300, 1000) } else { (400, 900) };
        let baud = if (self.changes / LINK_CHANGE).is_multiple_of(2) { 115_200 } else { 230_400 };
        format!(
            "[camera]\ndevice = \"rehearsal: random {SEED}\"\nstall_timeout_ms = 500\n\
             [realtime]\nlock_memory = true\n[failsafe]\nhold_ms = {hold_ms}\nneutral_ms = {neutral_ms}\n\
             [[link]]\nkind = \"serial\"\ndevice = \"{}\"\nbaud = {baud}\n[[link]]\naddress = \"{}\"\n",
            self.path.path().display(),
            self.address
        )
    }

    /// Called every second; changes the service's settings now and then, unless the last change is still pending. Returns whether
    /// a change is pending or has just been made.
    pub fn change_settings(&mut self, process: &Process) -> bool {
        self.seconds += 1;
        self.is_due |= self.random.u32(0..SETTINGS_RARITY) == 0 || FIRST_SETTINGS_S.contains(&self.seconds);
        let is_pending = process.service.logged("settings changed") < self.changes as usize;
        self.pending_s = if is_pending { self.pending_s + 1 } else { 0 };
        assert!(self.pending_s < LONGEST_PENDING_S, "the service does not take its settings");
        if is_pending || !self.is_due {
            return is_pending;
        }
        self.is_due = false;
        self.changes += 1;
        process.service.reload(&self.settings());
        true
    }

    pub fn step(&mut self, process: &Process) {
        match self.board_pulled.step(&mut self.random) {
            Some(true) => self.path.pull(self.board.take().unwrap()),
            Some(false) => self.plug_in(),
            None => _ = self.board.as_mut().map(Board::packets),
        }
        if let Some(begins) = self.receiver_ended.step(&mut self.random) {
            self.receiver = if begins { None } else { UdpSocket::bind(self.address).ok() };
        }
        if let Some(begins) = self.inference_stopped.step(&mut self.random) {
            self.stopped = begins.then(|| Stuck::stop(process.threads[0]));
        }
    }

    fn plug_in(&mut self) {
        let board = Board::plugged_in();
        self.path.leads_to(&board);
        self.board = Some(board);
    }

    /// Ends the faults, and returns how often each happened.
    pub fn end(&mut self) -> String {
        self.stopped = None;
        if self.board.is_none() {
            self.plug_in();
        }
        let [pulled, ended, stopped] =
            [&self.board_pulled, &self.receiver_ended, &self.inference_stopped].map(|fault| fault.count);
        let changes = self.changes;
        format!(
            "boards pulled {pulled}, receivers ended {ended}, hot loops stopped {stopped}, settings changed {changes}"
        )
    }
}
