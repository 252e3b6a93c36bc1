//! The task of a client that watches: it is sent packets as they go to the links. All watchers are sent the same ones.

use std::time::{Duration, Instant};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_packet::Packet;
use facewire_packet::control::Reply;

use crate::service::observer::Observed;

/// Least time between two packets to a watcher.
const WATCH_PERIOD: Duration = Duration::from_micros(16_666);

/// When watchers were shown a packet last.
#[derive(Default)]
pub(super) struct Shown(Option<Instant>);

impl Shown {
    /// Returns what watchers are to be shown now, if it is time for a packet and there is a new one.
    pub(super) fn next(&mut self, watched: &mut Observed<Packet>) -> Option<Reply> {
        if self.0.is_some_and(|at| at.elapsed() < WATCH_PERIOD) {
            return None;
        }
        let packet = watched.newest()?;
        self.0 = Some(Instant::now());
        Some(Reply::Packet(BASE64_STANDARD.encode(packet.encode())))
    }
}
