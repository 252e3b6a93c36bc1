//! The sender's links: what became of their packets, and how new settings change them.
//!
//! A link that the new settings have too goes on as it is. One that they do not have is told to end with its last packet,
//! and closed and counted on another thread than the sender's.

use std::mem::swap;
use std::sync::atomic::Ordering::Relaxed;

use facewire_packet::Packet;

use super::counters::Counters;
use crate::config::{LinkKind, LinkSettings};
use crate::link::{Link, LinkCounts, LinkError, UdpLink};

/// Links in the order of their settings.
#[derive(Debug)]
pub(super) struct Links(Vec<Slot>);

#[derive(Debug)]
enum Slot {
    /// A link, and what of its counts the service has already.
    Open(Link, LinkCounts),
    /// In a change: the place among the links before it of one that stays. After it: that one went on.
    Kept(usize),
}

impl Links {
    /// Opens the links of a service.
    ///
    /// # Errors
    /// As [`Links::change`].
    pub(super) fn open(settings: &[LinkSettings]) -> Result<Self, LinkError> {
        Self::change(settings, &[])
    }

    /// Opens the links that the new settings have and the live ones have not.
    ///
    /// # Errors
    /// As [`Link::open`]. A host that does not resolve is an error too where there is no other link: then nothing is lost
    /// by telling it at once, and whoever started the service may start it again.
    pub(super) fn change(new: &[LinkSettings], live: &[LinkSettings]) -> Result<Self, LinkError> {
        if let [only] = new
            && only.kind == LinkKind::Udp
            && !live.contains(only)
        {
            UdpLink::find(&only.address)?;
        }
        let mut free: Vec<Option<&LinkSettings>> = live.iter().map(Some).collect();
        new.iter().map(|settings| Slot::change(settings, &mut free)).collect::<Result<_, _>>().map(Self)
    }

    /// Takes a change of these links, and leaves those that end in its place. Nothing is allocated or waited for.
    pub(super) fn adopt(&mut self, change: &mut Self) {
        for slot in &mut change.0 {
            if let Slot::Kept(place) = *slot
                && let Some(kept) = self.0.get_mut(place)
            {
                swap(slot, kept);
            }
        }
        swap(self, change);
        change.0.iter().filter_map(Slot::link).for_each(Link::stop);
    }

    /// Sends the packet by each.
    pub(super) fn send(&mut self, packet: &Packet) {
        self.0.iter_mut().for_each(|slot| {
            if let Slot::Open(link, _) = slot {
                link.send(packet);
            }
        });
    }

    /// Adds to the counters what became of packets since the last time, and says how many links are open and which is
    /// refused.
    pub(super) fn count(&mut self, counters: &Counters) {
        for slot in &mut self.0 {
            if let Slot::Open(link, counted) = slot {
                add(counters, counted, link.counts());
            }
        }
        let open = self.0.iter().filter_map(Slot::link).filter(|link| link.is_open()).count();
        counters.links_open.store(open as u64, Relaxed);
        let refused = |(link, place): (&Slot, u32)| Some((place, link.link()?.refusal()?));
        counters.refuse(self.0.iter().zip(0..).find_map(refused));
    }

    /// Closes each and counts what became of its last packets.
    pub(super) fn close(self, counters: &Counters) {
        for slot in self.0 {
            if let Slot::Open(link, mut counted) = slot {
                add(counters, &mut counted, link.close());
            }
        }
    }
}

impl Slot {
    /// One of the links that are free to be kept, or a new one.
    fn change(settings: &LinkSettings, free: &mut [Option<&LinkSettings>]) -> Result<Self, LinkError> {
        if let Some((place, live)) = free.iter_mut().enumerate().find(|(_, live)| **live == Some(settings)) {
            *live = None;
            return Ok(Self::Kept(place));
        }
        Link::open(settings).map(|link| Self::Open(link, LinkCounts::default()))
    }

    fn link(&self) -> Option<&Link> {
        match self {
            Self::Open(link, _) => Some(link),
            Self::Kept(_) => None,
        }
    }
}

/// Adds to the counters what is not counted yet.
fn add(counters: &Counters, counted: &mut LinkCounts, counts: LinkCounts) {
    let LinkCounts { sent, dropped } = std::mem::replace(counted, counts);
    counters.sent.fetch_add(counts.sent.saturating_sub(sent), Relaxed);
    counters.dropped.fetch_add(counts.dropped.saturating_sub(dropped), Relaxed);
}
