//! Simulated servos at a pseudo-terminal.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

use facewire_servo::bus::FAMILIES;
use facewire_servo::bus::simulator::Simulator;

use crate::common::answers::AnsweringDevice;

/// Servos that run on a thread of their own until they are unplugged.
pub struct Bus {
    pub device: PathBuf,
    pub simulator: Arc<Mutex<Simulator>>,
    _thread: AnsweringDevice,
}

impl Bus {
    pub fn plugged_in(family: &str, ids: &[u8]) -> Self {
        let (_, family) = FAMILIES.iter().find(|(name, _)| *name == family).unwrap();
        Self::with(Arc::new(Mutex::new(Simulator::new(family, ids, Instant::now()))))
    }

    pub fn with(simulator: Arc<Mutex<Simulator>>) -> Self {
        let shared = Arc::clone(&simulator);
        let thread = AnsweringDevice::plugged_in(move |bytes| shared.lock().unwrap().take(bytes, Instant::now()));
        Self { device: thread.path.clone(), simulator, _thread: thread }
    }

    pub fn lock(&self) -> MutexGuard<'_, Simulator> {
        self.simulator.lock().unwrap()
    }

    /// Torque and place of each servo.
    pub fn servos(&self) -> Vec<(bool, f64)> {
        self.lock().servos.iter().map(|servo| (servo.has_torque(), servo.place.round())).collect()
    }
}
