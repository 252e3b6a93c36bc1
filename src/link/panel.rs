//! What a link shows of itself while it runs.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::ear::Ear;
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

/// What the sender, the threads of a link and the control thread know of it. The sender never takes a lock.
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
    ear: Mutex<Option<Ear>>,
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

    /// Hears the receiver by this ear from now on.
    pub(super) fn listen_by(&self, ear: Option<Ear>) {
        *self.ear() = ear;
    }

    fn ear(&self) -> MutexGuard<'_, Option<Ear>> {
        self.ear.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hears what has come back from the receiver, and logs that nobody listens there.
    pub fn listen(&self, now: Instant) {
        if let Some(sentence) = self.ear().as_mut().and_then(|ear| ear.hear(&self.sent, now)) {
            tracing::info!("link {}: {sentence}", self.receiver);
        }
    }

    /// Whether the receiver's machine says that nobody listens there.
    pub fn is_unheard(&self) -> bool {
        self.ear().as_ref().is_some_and(|ear| ear.is_unheard)
    }

    /// What the log says about packets that the network refuses.
    pub fn refusal(&self) -> Option<String> {
        let error = Some(self.refusal.load(Relaxed)).filter(|error| *error != 0)?;
        let reason = io::Error::from_raw_os_error(error);
        let remedy = "IPAddressAllow in the unit, or the firewall of this machine";
        Some(format!(
            "the network takes no packets ({reason}); check this machine's cable or Wi-Fi, the address, and {remedy}"
        ))
    }

    /// The kind and the receiver.
    pub fn name(&self) -> String {
        format!("{} {}", self.kind.name(), self.receiver)
    }

    /// What programs at the control socket are told of the link.
    pub fn status(&self) -> LinkStatus {
        let channel = |dial: &Dial| {
            let [volts, celsius, load, _] = &dial.health;
            ChannelStatus {
                number: dial.number,
                target: dial.target.get(),
                position: dial.position.get(),
                pulse_us: dial.place.get(),
                name: Some(dial.name.clone()).filter(|name| !name.is_empty()),
                measured: dial.measured.get(),
                volts: volts.get(),
                celsius: celsius.get(),
                load: load.get(),
            }
        };
        LinkStatus {
            name: self.name(),
            kind: self.kind.name().to_owned(),
            open: self.is_open.load(Relaxed),
            sent: self.sent.load(Relaxed),
            dropped: self.dropped.load(Relaxed),
            trouble: self.trouble(),
            unheard: self.is_unheard(),
            answered_s_ago: self
                .ear()
                .as_ref()
                .and_then(|ear| ear.answered_ago(Instant::now()))
                .map(|ago| ago.as_secs()),
            stop: self.kind.at_stop().map(str::to_owned),
            released: self.kind.moves_servos().then(|| self.dials.has_released()),
            channels: self.dials.channels.iter().map(channel).collect(),
        }
    }

    /// The last trouble since the device was opened, or since the host was found, or else that nobody listens there.
    pub fn trouble(&self) -> Option<String> {
        let noted = || self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let unheard = || Some(format!("{}: {}", self.receiver, self.ear().as_ref()?.trouble()?));
        self.refusal().or_else(noted).or_else(unheard)
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use facewire_packet::Packet;
    use facewire_servo::bus::simulator::Simulator;
    use facewire_servo::bus::{Line, Unit};

    use super::*;

    #[test]
    fn the_status_of_a_link_has_what_each_bus_servo_tells_of_itself_and_its_name_and_nothing_of_one_that_is_silent() {
        let channel = |id, keys| format!("[[link.channel]]\nchannel = {id}\nposition_at_0 = 400\n{keys}");
        let channels = [channel(3, "position_at_1 = 600\nname = \"left brow\"\n"), channel(4, "position_at_1 = 800\n")];
        let text = format!("[[link]]\nkind = \"bus-servo\"\nfamily = \"feetech-sts\"\n{}", channels.concat());
        let settings = crate::config::parse("test", &text).unwrap().links.remove(0);
        let LinkKind::BusServo(bus) = &settings.kind else { panic!() };
        let panel = Panel::new(&settings, &Arc::default());
        let mut line = Line::new(bus.family, Unit::Steps, 1_000_000, &bus.channels, &panel.dials);
        let mut now = Instant::now();
        // Number 4 is not plugged in. Number 3 stands at 500 steps.
        let mut servos = Simulator::new(bus.family, &[3], now);
        servos.servos[0].registers[60..62].copy_from_slice(&250_u16.to_le_bytes());
        panel.traffic.operator.is_released.store(true, Relaxed);
        let mut back = Vec::new();
        for _ in 0..50 {
            now += Duration::from_millis(20);
            let mut message = Vec::new();
            line.step(&Packet::NEUTRAL, &back, now, &mut message);
            back = servos.take(&message, now);
        }
        let told = |channel: &ChannelStatus| {
            let numbers = [channel.measured, channel.volts, channel.celsius, channel.load];
            (channel.number, channel.name.clone(), numbers)
        };
        let brow = (3, Some("left brow".to_owned()), [Some(0.5), Some(7.4), Some(30.0), Some(0.25)]);
        let silent = (4, None, [None; 4]);
        assert_eq!(panel.status().channels.iter().map(told).collect::<Vec<_>>(), [brow, silent]);
        let text = serde_json::to_string(&panel.status().channels[1]).unwrap();
        assert_eq!(text, "{\"number\":4,\"target\":0.0,\"position\":0.0,\"pulse_us\":null}", "for older clients");
    }
}
