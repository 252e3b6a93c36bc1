//! Simulated servos at a pseudo-terminal.

use std::io::{Read as _, Write as _};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use facewire_servo::bus::FAMILIES;
use facewire_servo::bus::simulator::Simulator;

use crate::common::board::Board;

/// Servos that run on a thread of their own until they are unplugged.
pub struct Bus {
    pub device: PathBuf,
    pub simulator: Arc<Mutex<Simulator>>,
    _is_plugged_in: Arc<()>,
}

impl Bus {
    pub fn plugged_in(family: &str, ids: &[u8]) -> Self {
        let (_, family) = FAMILIES.iter().find(|(name, _)| *name == family).unwrap();
        Self::with(Arc::new(Mutex::new(Simulator::new(family, ids, Instant::now()))))
    }

    pub fn with(simulator: Arc<Mutex<Simulator>>) -> Self {
        let (mut board, plug) = (Board::plugged_in(), Arc::new(()));
        let (device, shared, is_plugged_in) = (board.device.clone(), Arc::clone(&simulator), Arc::downgrade(&plug));
        thread::spawn(move || {
            while is_plugged_in.strong_count() > 0 {
                let mut bytes = [0; 1024];
                let length = board.master.read(&mut bytes).unwrap_or(0);
                let answers = shared.lock().unwrap().take(&bytes[..length], Instant::now());
                let _ = board.master.write_all(&answers);
                thread::sleep(Duration::from_millis(1));
            }
        });
        Self { device, simulator, _is_plugged_in: plug }
    }

    pub fn lock(&self) -> MutexGuard<'_, Simulator> {
        self.simulator.lock().unwrap()
    }

    /// Torque and place of each servo.
    pub fn servos(&self) -> Vec<(bool, f64)> {
        self.lock().servos.iter().map(|servo| (servo.has_torque(), servo.place.round())).collect()
    }
}
