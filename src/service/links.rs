//! The sender's links, and how a reload changes them.
//!
//! A link whose format and receiver stay the same is carried over with its open port and its packet numbers. One that is
//! removed or replaced sends the neutral face, and closes its port on its own thread.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use super::counters::Counters;
use crate::config::{LinkKind, LinkSettings};
use crate::link::{Link, LinkError, Output, Rates, Traffic};

/// How long a stopping service waits for its links to send their last packet.
const LAST_PACKET: Duration = Duration::from_millis(500);
const LOOK: Duration = Duration::from_millis(5);

/// Links in the order of their settings. In a change that a reload prepares, a link is `None` if the sender has it.
#[derive(Debug)]
pub(super) struct Links(Vec<(LinkSettings, Option<Link>)>);

impl Links {
    /// Opens the links in `new` that `live` does not have. A host name that does not resolve is an error only for a new
    /// link that is the only one: the service then has nothing else to do, and its manager starts it again.
    pub(super) fn change(
        new: &[LinkSettings],
        live: &[LinkSettings],
        traffic: &Arc<Traffic>,
    ) -> Result<Self, LinkError> {
        let mut kept: Vec<&LinkKind> = live.iter().map(|link| &link.kind).collect();
        let change = new.iter().map(|settings| {
            let link = if let Some(index) = kept.iter().position(|kind| **kind == settings.kind) {
                kept.swap_remove(index);
                None
            } else {
                if new.len() == 1 {
                    Link::resolve(settings)?;
                }
                Some(Link::open(settings, traffic)?)
            };
            Ok((settings.clone(), link))
        });
        change.collect::<Result<_, _>>().map(Self)
    }

    /// Takes over those of the old links that the change keeps, and makes all links look up their host names now. The
    /// other old links send `last`. This neither allocates nor waits.
    pub(super) fn take_over(&mut self, old: &mut Self, last: &Output) {
        for (settings, link) in self.0.iter_mut().filter(|(_, link)| link.is_none()) {
            let same = old.0.iter_mut().find(|(live, link)| live.kind == settings.kind && link.is_some());
            *link = same.and_then(|(_, link)| link.take());
        }
        old.send_last(last);
        self.each().for_each(|(_, link)| link.carrier().refresh());
    }

    /// Offers the output to every link. Returns how long the links can wait for the next output, in microseconds.
    pub(super) fn offer(&mut self, now_us: u64, output: &Output, rates: Rates) -> u64 {
        let waits = self.each().map(|(settings, link)| link.offer(settings, rates, now_us, output));
        waits.min().unwrap_or(u64::MAX)
    }

    /// Whether a link is still on its way from a pose that it has held.
    pub(super) fn is_held(&mut self) -> bool {
        self.each().any(|(_, link)| link.is_held())
    }

    pub(super) fn send_last(&mut self, output: &Output) {
        self.each().for_each(|(settings, link)| link.send_last(settings, output));
    }

    pub(super) fn count(&mut self, counters: &Counters) {
        let open = self.each().filter(|(_, link)| link.carrier().is_open()).count();
        counters.links_open.store(open as u64, Relaxed);
        let refusal = (0..).zip(self.each()).find_map(|(index, (_, link))| Some((index, link.carrier().refusal()?)));
        counters.set_refusal(refusal);
    }

    pub(super) fn close(mut self) {
        let end = Instant::now() + LAST_PACKET;
        self.each().for_each(|(_, link)| link.carrier().stop());
        while self.each().any(|(_, link)| !link.carrier().has_ended()) && Instant::now() < end {
            thread::sleep(LOOK);
        }
    }

    fn each(&mut self) -> impl Iterator<Item = (&LinkSettings, &mut Link)> {
        self.0.iter_mut().filter_map(|(settings, link)| Some((&*settings, link.as_mut()?)))
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use facewire_packet::{Packet, Reason, State};

    use super::*;
    use crate::config;
    use crate::link::test_output;

    fn settings(receivers: [&UdpSocket; 2]) -> Vec<LinkSettings> {
        let link = |socket: &UdpSocket| format!("[[link]]\naddress = \"{}\"\n", socket.local_addr().unwrap());
        config::parse("test", &receivers.map(link).concat()).unwrap().links
    }

    fn seen(socket: &UdpSocket) -> Vec<(State, Reason)> {
        socket.set_nonblocking(true).unwrap();
        let mut datagram = [0; 256];
        let lengths = std::iter::from_fn(|| Some((socket.recv(&mut datagram).ok()?, datagram)));
        let packets = lengths.map(|(length, datagram)| Packet::decode(&datagram[..length]).unwrap());
        packets.map(|packet| (packet.state, packet.reason)).collect()
    }

    #[test]
    fn the_receiver_of_a_link_that_a_reload_removes_is_shown_the_neutral_face_last_and_no_other_is() {
        let [old, kept, new] = [(); 3].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let (before, after) = (settings([&old, &kept]), settings([&kept, &new]));
        let mut links = Links::change(&before, &[], &Arc::default()).unwrap();
        links.send_last(&test_output(State::Live));
        let mut change = Links::change(&after, &before, &Arc::default()).unwrap();
        change.take_over(&mut links, &Output { reason: Reason::Stopping, ..test_output(State::Neutral) });
        change.send_last(&test_output(State::Hold));
        let (live, hold) = ((State::Live, Reason::None), (State::Hold, Reason::NoFace));
        assert_eq!(seen(&old), [live, (State::Neutral, Reason::Stopping)]);
        assert_eq!((seen(&kept), seen(&new)), (vec![live, hold], vec![hold]));
    }
}
