//! Links: where the face is sent, in which format, and when.
//!
//! Role: a [`Link`] joins an [`Encoder`] (the bytes of an output), a [`Pace`] (when an output is due) and what carries the
//! bytes to the receiver: datagrams, or a device with a thread of its own.
//! Contract: an open link never fails, blocks, allocates or logs on the caller's thread. It counts what it could not
//! send, because a receiver may appear and disappear at any time. No link waits for another.
//! Limits: nothing is queued or sent again, because the next packet is newer.

mod background;
mod bus_servo;
mod check;
mod discovery;
mod ear;
mod encoder;
mod ifacialmocap;
mod json;
mod output;
mod panel;
pub mod pca9685;
mod release;
mod serial;
mod udp;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::{fmt::Display, io, sync::Arc, sync::atomic::Ordering::Relaxed, time::Duration};

use facewire_board::{Attached, latency_remedy, root};

pub use self::background::Background;
pub use self::check::{check_settings, notes};
pub use self::discovery::{Announcement, announcement};
pub use self::encoder::packet;
use self::encoder::{Encoder, encoder_of};
use self::output::Shown;
#[cfg(test)]
pub(crate) use self::output::test_output;
pub(crate) use self::output::{LONGEST_STEP_US, towards};
pub use self::output::{Output, Pace};
pub use self::panel::{Panel, Traffic};
pub use self::release::release_servos;
use self::serial::PortClaim;
pub use self::serial::{PortSearch, lost, open_port, serial_carrier, serial_ports};
pub use self::udp::UdpCarrier;
use crate::config::{JsonSettings, JsonTarget, LinkKind, LinkSettings};

/// What `[send]` and `[failsafe]` say about the speed of all links.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    pub send_hz: u32,
    pub slew_per_s: f32,
}

pub struct Link {
    encoder: Encoder,
    udp: Option<UdpCarrier>,
    /// What may block. A link to receivers that ask for the face can have both.
    device: Option<Background>,
    pub panel: Arc<Panel>,
    sequence: u16,
    shown: Shown,
    pace: Pace,
    /// When an output was encoded last, microseconds.
    encoded_us: u64,
    /// When a message was sent last, microseconds.
    sent_us: u64,
    /// Whether an operator had a say in it, and since when that is so, microseconds.
    was_operated: bool,
    was_off: bool,
    operated_us: u64,
}

/// Stack of a thread that a link starts. With locked memory all of it is in RAM.
const LINK_STACK_BYTES: usize = 256 << 10;
/// How long a thread of a link that has panicked does nothing.
const PANIC_PAUSE: Duration = Duration::from_secs(1);

/// Time between two messages to servos that an operator jogs or has released, microseconds.
const OPERATED_PERIOD_US: u64 = 25_000;
/// The same while a board has not acknowledged a release, at first: each message asks one bus servo whether it has torque.
const UNACKNOWLEDGED_PERIOD_US: u64 = 3_000;
const UNACKNOWLEDGED_US: u64 = 400_000;

/// Longest time between two messages of a stream by DMX that has not ended, microseconds, with some to spare.
const STREAM_PERIOD_US: u64 = 2_000_000;

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("link {message}")]
pub struct LinkError {
    pub kind: LinkErrorKind,
    pub message: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkErrorKind {
    /// The host does not resolve, or no network leads there.
    Host,
    /// Nobody reads standard output.
    Output,
    /// The board may be plugged in at any time: no fault.
    Waiting,
    /// Another link has the device, which may be the one that this link replaces.
    Claimed,
    Other,
}

impl LinkError {
    pub fn new(kind: LinkErrorKind, receiver: impl Display, sentence: impl Display) -> Self {
        Self { kind, message: format!("{receiver}: {sentence}") }
    }

    fn no_thread(receiver: impl Display, error: io::Error) -> Self {
        Self::new(LinkErrorKind::Other, receiver, format!("no thread ({error}); raise the limit of threads"))
    }

    fn no_listener(place: impl Display, error: io::Error) -> Self {
        let advice = "stop what listens there already, or give another place";
        Self::new(LinkErrorKind::Other, place, format!("nothing can listen there ({error}); {advice}"))
    }
}

/// Whether the work of a link's thread ends by a panic, which is logged and shown as the trouble of the link.
fn panics(link: &dyn Display, panel: &Panel, work: impl FnOnce()) -> bool {
    let has_panicked = catch_unwind(AssertUnwindSafe(work)).is_err();
    if has_panicked {
        let trouble = format!("{link}: its thread has panicked, which is a fault of facewire: please report it");
        tracing::error!("link {trouble}");
        panel.dials.note_released(false);
        panel.note(Some(&trouble));
    }
    has_panicked
}

impl Link {
    /// Opens a link that counts into `traffic`. Threads of its own look up its host or open its serial port, again and
    /// again until they succeed.
    pub fn open(settings: &LinkSettings, traffic: &Arc<Traffic>) -> Result<Self, LinkError> {
        let panel = Panel::new(settings, traffic);
        let shared = || Arc::clone(&panel);
        let mut udp = settings.kind.address().map(|address| UdpCarrier::open(&address, shared())).transpose()?;
        let device = match &settings.kind {
            LinkKind::Serial(_) | LinkKind::Maestro(_) => serial_carrier(&settings.kind, shared())?,
            LinkKind::BusServo(it) => {
                Some(Background::start(settings, "fw-servos", bus_servo::Servos::new(it, shared()), shared())?)
            }
            LinkKind::Pca9685(it) => {
                Some(Background::start(settings, "fw-i2c", pca9685::Chip::new(it, &panel.dials), shared())?)
            }
            LinkKind::IFacialMocap(it) => {
                udp = it.address.as_ref().map(|address| UdpCarrier::open(address, shared())).transpose()?;
                // With an address, only the messages to it are counted.
                let others = if udp.is_some() { Arc::default() } else { shared() };
                let server = it.listen.map(|listen| ifacialmocap::Server::new(listen, it.reply_port));
                server.map(|server| Background::start(settings, "fw-subscribe", server, others)).transpose()?
            }
            LinkKind::Json(it) => match &it.to {
                JsonTarget::Stdout => Some(Background::start(settings, "fw-stdout", json::Stdout, shared())?),
                JsonTarget::Unix(path) => {
                    Some(Background::start(settings, "fw-socket", json::Server::new(path), shared())?)
                }
                JsonTarget::Udp(_) => None,
            },
            _ => None,
        };
        Ok(Self {
            encoder: encoder_of(&settings.kind, &panel.dials),
            udp,
            device,
            panel,
            sequence: 0,
            shown: Shown::default(),
            pace: Pace::default(),
            encoded_us: 0,
            sent_us: 0,
            was_operated: false,
            was_off: false,
            operated_us: 0,
        })
    }

    /// Tests whether these links can be opened together at this moment, without sending anything, and describes each.
    pub fn check_all(settings: &[LinkSettings]) -> Vec<Result<String, LinkError>> {
        let mut claims = Vec::new();
        settings.iter().map(|settings| Self::check(settings, &mut claims)).collect()
    }

    fn check(settings: &LinkSettings, claims: &mut Vec<PortClaim>) -> Result<String, LinkError> {
        let fixed = if let LinkKind::IFacialMocap(it) = &settings.kind { it.address.clone() } else { None };
        if let Some(address) = settings.kind.address().or(fixed) {
            let receiver = udp::check(&address, settings.kind.universe().and_then(|(_, from)| from))?;
            if address.as_str().parse() != Ok(receiver) {
                let host = address.parts().map_or("", |(host, _)| host);
                return Ok(format!("{settings}; {host} is {} at present", receiver.ip()));
            }
        } else if let LinkKind::Json(JsonSettings { to: JsonTarget::Unix(path) }) = &settings.kind {
            match json::check(path) {
                Err(error) if error.kind == LinkErrorKind::Waiting => return Ok(error.message),
                checked => checked?,
            }
        } else if let LinkKind::Pca9685(board) = &settings.kind {
            pca9685::Bus::open(board)?;
        } else if let Some((device, baud, auto)) = settings.kind.line() {
            let port = match PortSearch::new(device, auto).find() {
                Err(error) if error.kind == LinkErrorKind::Waiting => return Ok(error.message),
                port => port?,
            };
            claims.push(PortClaim::acquire(&port)?);
            open_port(&port, baud, Duration::ZERO)?;
            let late = latency_remedy(&root(), &port).filter(|_| auto == Attached::BusServos);
            let late = late.map(|late| format!("; {late}")).unwrap_or_default();
            return Ok(format!("{} at {baud} baud{late}", port.display()));
        }
        // Where others listen, a service that runs already does so itself.
        Ok(settings.to_string())
    }

    /// Sends the output if it is due, which an operator of servos can bring forward. All settings but the kind may differ
    /// from those of the last call. Returns how long the link can wait for the next output, microseconds.
    pub fn offer(&mut self, settings: &LinkSettings, rates: Rates, now_us: u64, output: &Output) -> u64 {
        let output = self.shown.next(settings, rates.slew_per_s, now_us, output);
        let (mut is_due, mut wait_us) = self.pace.step(settings, rates.send_hz, now_us, &output);
        let is_operated = self.panel.dials.is_operated();
        let is_off = self.panel.dials.is_off();
        if is_operated != self.was_operated || is_off != self.was_off {
            self.operated_us = now_us;
            is_due = true;
        }
        if is_operated {
            let period_us = self.operated_period_us(settings.rate_hz(rates.send_hz), now_us);
            is_due |= now_us.saturating_sub(self.encoded_us) >= period_us;
            wait_us = wait_us.min(period_us);
        }
        if is_due {
            self.encoded_us = now_us;
            self.was_operated = is_operated;
            self.was_off = is_off;
            self.encode(&output);
        }
        self.panel.is_open.store(self.is_open(), Relaxed);
        self.panel.refusal.store(self.udp.as_ref().and_then(|udp| udp.refusal).unwrap_or(0), Relaxed);
        wait_us
    }

    /// Time between two messages while an operator has a say in them, microseconds.
    fn operated_period_us(&self, rate_hz: u32, now_us: u64) -> u64 {
        let dials = &self.panel.dials;
        let is_awaited = dials.operator.is_released.load(Relaxed) && !dials.has_released();
        if is_awaited && now_us.saturating_sub(self.operated_us) < UNACKNOWLEDGED_US {
            return UNACKNOWLEDGED_PERIOD_US;
        }
        OPERATED_PERIOD_US.max(1_000_000 / u64::from(rate_hz.max(1)))
    }

    /// Sends what consoles list the source of this link by, if that is due and the stream has not ended.
    pub fn announce(&mut self, announcement: &mut Announcement, now_us: u64) {
        let goes_on = now_us.saturating_sub(self.sent_us) < STREAM_PERIOD_US;
        if let Some(udp) = self.udp.as_mut().filter(|udp| goes_on && udp.is_open())
            && let Some(message) = announcement.due(now_us)
        {
            udp.announce(message);
        }
    }

    /// Sends the output at once, as the last one.
    pub fn send_last(&mut self, settings: &LinkSettings, output: &Output) {
        self.encode(&Shown::adjusted(settings, output));
    }

    /// Whether the link still shows a pose that it has held, or is on its way from there.
    pub fn is_held(&self) -> bool {
        self.shown.held.is_some()
    }

    fn encode(&mut self, output: &Output) {
        let Self { encoder, udp, device, panel, encoded_us, sent_us, .. } = self;
        if udp.is_none() && !device.as_ref().is_some_and(Background::has_receiver) {
            return;
        }
        let is_off = panel.dials.is_off();
        // What was acknowledged before this message no longer counts, even if the device takes the message late.
        if !is_off {
            panel.dials.note_released(false);
        }
        let mut is_taken = true;
        encoder(&packet(output, self.sequence), output, &mut |message| {
            panel.traffic.packets.fetch_add(1, Relaxed);
            *sent_us = *encoded_us;
            if let Some(udp) = udp {
                is_taken &= udp.send(message);
            }
            if let Some(device) = device {
                device.send(message);
            }
        });
        if self.udp.is_some() {
            // No receiver of datagrams acknowledges anything.
            self.panel.dials.note_released(is_off && is_taken);
        }
        self.sequence = self.sequence.wrapping_add(1);
    }

    /// Whether messages reach the network or the device at present.
    pub fn is_open(&self) -> bool {
        self.udp.as_ref().is_some_and(UdpCarrier::is_open) || self.device.as_ref().is_some_and(Background::is_open)
    }

    /// Asks to look up the receiver's address now.
    pub fn refresh(&self) {
        if let Some(udp) = &self.udp {
            udp.refresh();
        }
    }

    /// Asks the link to send what it was given and end, without waiting for it.
    pub fn stop(&self) {
        if let Some(device) = &self.device {
            device.stop();
        }
    }

    /// As [`Link::stop`], for a link that another one to the same servo board replaces: servos keep their torque.
    pub fn hand_over(&self) {
        if let Some(device) = &self.device {
            device.hand_over();
        }
    }

    /// Whether the link has ended after [`Link::stop`].
    pub fn has_ended(&self) -> bool {
        self.device.as_ref().is_none_or(Background::has_ended)
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use std::fs::{self, File};
    use std::{thread, time::Instant};

    use facewire_packet::{BLENDSHAPES, State};

    use super::*;

    /// Longer than any step takes on a busy machine.
    pub const PATIENCE: Duration = Duration::from_mins(3);

    pub fn kind(name: &str, keys: &str) -> LinkKind {
        let text = format!("[[link]]\nkind = \"{name}\"\n{keys}");
        crate::config::parse("test", &text).unwrap().links.remove(0).kind
    }

    pub fn face(look: &[(&str, f32)]) -> Output {
        let mut output = test_output(State::Live);
        for (name, value) in look {
            let index = BLENDSHAPES.iter().position(|known| known == name).unwrap();
            output.pose.coefficients[index] = *value;
        }
        output
    }

    /// What the work logs.
    pub fn logged(work: impl FnOnce()) -> String {
        let file = tempfile::NamedTempFile::new().unwrap();
        let writer = Arc::<File>::new(file.reopen().unwrap());
        tracing::subscriber::with_default(tracing_subscriber::fmt().with_writer(writer).finish(), work);
        fs::read_to_string(file.path()).unwrap()
    }

    pub fn eventually(what: &str, mut happens: impl FnMut() -> bool) {
        let end = Instant::now() + PATIENCE;
        while !happens() {
            assert!(Instant::now() < end, "{what}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Messages sent, and messages dropped.
    pub fn counts(panel: &Panel) -> [u64; 2] {
        [&panel.sent, &panel.dropped].map(|counter| counter.load(Relaxed))
    }
}
