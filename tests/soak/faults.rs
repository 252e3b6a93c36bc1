//! Random faults of the links, and of inferences: the thread that runs them is stopped wherever it is.
//!
//! The service's own rehearsal plays the faults of the camera and the face. Changes of settings are not faults, but come
//! as unexpectedly.

use std::net::{SocketAddr, UdpSocket};

use super::board::{Board, StablePath};
use super::common::stuck::Stuck;
use super::process::Service;

/// On average, a fault begins once in `rarity` steps. It lasts at most `longest` steps.
const SERIAL: Chance = Chance { rarity: 80, longest: 40 };
const RECEIVER: Chance = Chance { rarity: 80, longest: 40 };
const INFERENCE: Chance = Chance { rarity: 150, longest: 20 };
/// On average, the settings change once in `rarity` seconds.
const SETTINGS: Chance = Chance { rarity: 20, longest: 1 };
/// Seconds in which the settings change in any case, before anything is judged: the threads that prepare a reload run
/// once, and the system keeps the memory of their stacks.
const FIRST_SETTINGS_S: [u32; 3] = [4, 8, 12];
/// After this many changes, a link changes too: the serial port gets another baud rate.
const LINK_CHANGE: u32 = 3;

struct Chance {
    rarity: u32,
    longest: u32,
}

/// The current faults, and for how many more steps they last.
pub struct Faults {
    seed: u64,
    random: fastrand::Rng,
    path: StablePath,
    board: Option<Board>,
    board_back_in: u32,
    address: SocketAddr,
    receiver: Option<UdpSocket>,
    receiver_back_in: u32,
    stopped: Option<Stuck>,
    resumed_in: u32,
    seconds: u32,
    /// How often each fault has happened: boards unplugged, receivers ended, threads stopped, settings changed.
    pub counts: [u32; 4],
}

impl Faults {
    pub fn new(seed: u64) -> Self {
        let (path, board) = (StablePath::new(), Board::plugged_in());
        path.leads_to(&board);
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = receiver.local_addr().unwrap();
        let (board, receiver) = (Some(board), Some(receiver));
        Self {
            seed,
            random: fastrand::Rng::with_seed(seed),
            path,
            board,
            board_back_in: 0,
            address,
            receiver,
            receiver_back_in: 0,
            stopped: None,
            resumed_in: 0,
            seconds: 0,
            counts: [0; 4],
        }
    }

    /// Settings with a camera that has random faults, and with the links, after the changes so far.
    pub fn settings(&self) -> String {
        let changes = self.counts[3];
        let (hold_ms, neutral_ms) = if changes.is_multiple_of(2) { (300, 1000) } else { (400, 900) };
        let baud = if (changes / LINK_CHANGE).is_multiple_of(2) { 115_200 } else { 230_400 };
        format!(
            "[camera]\ndevice = \"rehearsal: random {}\"\nstall_timeout_ms = 500\n\
             [realtime]\nlock_memory = true\n[failsafe]\nhold_ms = {hold_ms}\nneutral_ms = {neutral_ms}\n\
             [[link]]\nkind = \"serial\"\ndevice = \"{}\"\nbaud = {baud}\n[[link]]\naddress = \"{}\"\n",
            self.seed,
            self.path.path().display(),
            self.address
        )
    }

    /// Called every second; changes the service's settings now and then. Returns whether they were changed.
    pub fn change_settings(&mut self, service: &Service) -> bool {
        self.seconds += 1;
        let is_time = self.begins(&SETTINGS).is_some() || FIRST_SETTINGS_S.contains(&self.seconds);
        if is_time {
            self.counts[3] += 1;
            service.change(&self.settings());
        }
        is_time
    }

    /// Begins and ends faults at random. Called in every step.
    pub fn step(&mut self, service: &Service) {
        self.serial();
        self.receiver();
        self.inference(service);
    }

    /// Ends the fault of the inference.
    pub fn end(&mut self) {
        self.stopped = None;
    }

    fn begins(&mut self, chance: &Chance) -> Option<u32> {
        (self.random.u32(0..chance.rarity) == 0).then(|| self.random.u32(1..=chance.longest))
    }

    fn serial(&mut self) {
        if let Some(board) = &mut self.board {
            board.packets();
        } else if self.board_back_in == 0 {
            let board = Board::plugged_in();
            self.path.leads_to(&board);
            self.board = Some(board);
        }
        self.board_back_in = self.board_back_in.saturating_sub(1);
        if let Some(steps) = self.begins(&SERIAL).filter(|_| self.board.is_some()) {
            self.path.pull(self.board.take().unwrap());
            self.board_back_in = steps;
            self.counts[0] += 1;
        }
    }

    fn receiver(&mut self) {
        if self.receiver.is_none() && self.receiver_back_in == 0 {
            self.receiver = UdpSocket::bind(self.address).ok();
        }
        self.receiver_back_in = self.receiver_back_in.saturating_sub(1);
        if let Some(steps) = self.begins(&RECEIVER).filter(|_| self.receiver.is_some()) {
            self.receiver = None;
            self.receiver_back_in = steps;
            self.counts[1] += 1;
        }
    }

    fn inference(&mut self, service: &Service) {
        self.stopped.take_if(|_| self.resumed_in == 0);
        self.resumed_in = self.resumed_in.saturating_sub(1);
        if let Some(steps) = self.begins(&INFERENCE).filter(|_| self.stopped.is_none()) {
            self.stopped = Some(Stuck::stop(service.hot_thread()));
            self.resumed_in = steps;
            self.counts[2] += 1;
        }
    }
}
