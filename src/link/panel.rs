//! What a link shows of itself while it runs.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

use crate::config::{LinkKind, LinkSettings};
use facewire_packet::control::{ChannelStatus, LinkStatus};
use facewire_servo::{Dial, Dials, Operator};

/// What all links share: counters that never decrease, where each message ends up as sent or as dropped, and the wishes of
/// an operator of servos.
#[derive(Debug, Default)]
pub struct Traffic {
    pub packets: AtomicU64,
    pub sent: AtomicU64,
    pub dropped: AtomicU64,
    pub operator: Arc<Operator>,
}

/// What the sender, the threads of a link and the control thread know of it. The sender never takes the lock.
#[derive(Debug, Default)]
pub struct Panel {
    pub kind: LinkKind,
    pub receiver: String,
    pub sent: AtomicU64,
    pub dropped: AtomicU64,
    pub is_open: AtomicBool,
    /// The system's error number if the network refused the last message, or else 0.
    pub refusal: AtomicI32,
    trouble: Mutex<Option<String>>,
    pub dials: Arc<Dials>,
    pub traffic: Arc<Traffic>,
}

impl Panel {
    pub(super) fn new(settings: &LinkSettings, traffic: &Arc<Traffic>) -> Arc<Self> {
        let kind = settings.kind.clone();
        let receiver = settings.to_string();
        let traffic = Arc::clone(traffic);
        let channels = kind.channels().map_or(&[][..], Vec::as_slice);
        let dials = Arc::new(Dials::new(channels, &traffic.operator));
        Arc::new(Self { kind, receiver, dials, traffic, ..Self::default() })
    }

    pub(super) fn count(&self, is_sent: bool) {
        let counters = if is_sent { [&self.sent, &self.traffic.sent] } else { [&self.dropped, &self.traffic.dropped] };
        for counter in counters {
            counter.fetch_add(1, Relaxed);
        }
    }

    /// Notes the present trouble of the device or the host, or that there is none any more.
    pub(super) fn note(&self, trouble: Option<&str>) {
        *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = trouble.map(str::to_owned);
    }

    /// What the log says about packets that the network refuses.
    pub fn refusal(&self) -> Option<String> {
        let error = Some(self.refusal.load(Relaxed)).filter(|error| *error != 0)?;
        let reason = io::Error::from_raw_os_error(error);
        let remedy = "IPAddressAllow in the unit";
        Some(format!(
            "the network takes no packets ({reason}); check this machine's cable or Wi-Fi, the address, and {remedy}"
        ))
    }

    /// What programs at the control socket are told of the link.
    pub fn status(&self) -> LinkStatus {
        let kind = self.kind.name();
        let channel = |dial: &Dial| ChannelStatus {
            number: dial.number,
            target: dial.target.get(),
            position: dial.position.get(),
            pulse_us: dial.place.get(),
        };
        LinkStatus {
            name: format!("{kind} {}", self.receiver),
            kind: kind.to_owned(),
            open: self.is_open.load(Relaxed),
            sent: self.sent.load(Relaxed),
            dropped: self.dropped.load(Relaxed),
            trouble: self.trouble(),
            channels: self.dials.channels.iter().map(channel).collect(),
        }
    }

    /// The last trouble since the device was opened, or since the host was found.
    pub fn trouble(&self) -> Option<String> {
        self.refusal().or_else(|| self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }
}
