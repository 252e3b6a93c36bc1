//! The places of receivers, and what the log gets about them. Anybody can send requests, also in the name of others, so
//! both are limited.

use std::{
    fmt,
    net::SocketAddr,
    ops::Range,
    sync::{Arc, atomic::Ordering::Relaxed},
    time::{Duration, Instant},
};

use triple_buffer::Input;

use super::{List, Subscriber, Version};

/// Most receivers at a time.
pub(super) const MOST: usize = 8;
/// A receiver that this many checks in a row found away is dropped.
const PATIENCE: u32 = 6;
/// A receiver that has not asked for this long may lose its place to a newcomer.
pub(super) const RECENT: Duration = Duration::from_mins(1);
/// Most lines in a period. The last of them says that the log will be silent.
pub(super) const MOST_LINES: u32 = 20;
/// Length of a period, from its first line on.
pub(super) const PERIOD: Duration = Duration::from_mins(10);

/// A receiver that has a place.
pub(super) struct Place {
    pub(super) receiver: SocketAddr,
    subscriber: Arc<Subscriber>,
    asked: Instant,
    /// The number of checks in a row that found it away.
    away: u32,
}

/// The places for receivers.
pub(super) struct Places {
    pub(super) list: Vec<Place>,
    newest: Input<List>,
    log: Log,
}

impl Places {
    pub(super) fn new(newest: Input<List>) -> Self {
        Self { list: Vec::new(), newest, log: Log::default() }
    }

    /// Gives a receiver that asks at `now` a place, if one is free.
    pub(super) fn take(&mut self, receiver: SocketAddr, version: Version, now: Instant) {
        if let Some(place) = self.list.iter_mut().find(|place| place.receiver == receiver) {
            place.asked = now;
            place.subscriber.choose(version);
            return;
        }
        let Some(taken) = self.replaceable(now) else { return };
        // A receiver that this machine cannot reach gets no place.
        let Ok(subscriber) = Subscriber::open(receiver, version) else { return };
        self.log.tell(now, format_args!("{receiver} asks for the face and gets it"));
        self.list.drain(taken);
        self.list.push(Place { receiver, subscriber: Arc::new(subscriber), asked: now, away: 0 });
        self.publish();
    }

    /// Returns the part of the list that a newcomer replaces, which is empty if a place is free. Returns `None` if
    /// there is no place for a newcomer.
    fn replaceable(&self, now: Instant) -> Option<Range<usize>> {
        if self.list.len() < MOST {
            return Some(0..0);
        }
        let (index, oldest) = self.list.iter().enumerate().min_by_key(|(_, place)| place.asked)?;
        (now.saturating_duration_since(oldest.asked) > RECENT).then_some(index..index + 1)
    }

    /// Drops receivers that have been away for long.
    pub(super) fn look(&mut self, now: Instant) {
        let before = self.list.len();
        for place in &mut self.list {
            let is_away = place.subscriber.refusals.swap(0, Relaxed) > 0;
            place.away = if is_away { place.away + 1 } else { 0 };
        }
        self.list.retain(|place| {
            let stays = place.away < PATIENCE;
            if !stays {
                self.log.tell(now, format_args!("{} is away, and no longer gets the face", place.receiver));
            }
            stays
        });
        if self.list.len() < before {
            self.publish();
        }
    }

    fn publish(&mut self) {
        self.newest.write(self.list.iter().map(|place| Arc::clone(&place.subscriber)).collect());
    }
}

/// Lines about receivers.
#[derive(Debug, Default)]
struct Log {
    /// When the period began.
    begun: Option<Instant>,
    /// How many lines the log got in the period.
    lines: u32,
}

impl Log {
    /// Writes the line, unless the log got its share of this period.
    fn tell(&mut self, now: Instant, line: fmt::Arguments<'_>) {
        if self.begun.is_none_or(|begun| now.saturating_duration_since(begun) >= PERIOD) {
            (self.begun, self.lines) = (Some(now), 0);
        }
        self.lines = self.lines.saturating_add(1);
        if self.lines < MOST_LINES {
            tracing::info!("iFacialMocap: {line}");
        } else if self.lines == MOST_LINES {
            let minutes = PERIOD.as_secs() / 60;
            tracing::warn!(
                "iFacialMocap: {line}; so many come and go that the log is silent about them for {minutes} minutes"
            );
        }
    }
}
