//! The task of a client that records: it is sent what each frame shows. One recording runs at a time.

use std::io;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_packet::Reason;
use facewire_packet::control::Reply;

use super::client::Client;
use crate::clock::monotonic_us;
use crate::recording::Recorded;
use crate::service::observer::Observed;

/// Time without a frame after which a client that records is told of lost frames or a missing camera, microseconds.
const QUIET_US: u64 = 1_000_000;

#[derive(Default)]
pub(super) struct Recording {
    sent_us: u64,
    last: Option<Entry>,
    /// Frames that the client did not take in time, and all that were lost, as the client was told.
    pub(super) refused: u64,
    lost: u64,
}

/// The last entry of a recording.
#[derive(Clone, Copy)]
struct Entry {
    /// On the clock of the frames.
    time_us: u64,
    /// When it was made.
    made_us: u64,
    is_frame: bool,
}

impl Recording {
    pub(super) fn begin() -> Self {
        tracing::info!("recording begins");
        Self { sent_us: monotonic_us(), ..Self::default() }
    }

    pub(super) fn end(&self) {
        tracing::info!("recording ended, {} frames lost", self.lost);
    }

    /// Sends what the new frames show, how many were lost, and once a second that no camera is open.
    pub(super) fn step(
        &mut self,
        client: &mut Client,
        frames: &mut Observed<Recorded>,
        is_camera_open: bool,
        now_us: u64,
    ) -> io::Result<()> {
        while let Some(mut frame) = frames.take() {
            // The entry for a missing camera may be later than the capture of the frame that follows.
            if let Some(Entry { time_us, is_frame: false, .. }) = self.last {
                frame.time_us = frame.time_us.max(time_us + 1);
            }
            self.last = Some(Entry { time_us: frame.time_us, made_us: now_us, is_frame: true });
            self.send(client, &frame, now_us)?;
        }
        let is_quiet = now_us.saturating_sub(self.sent_us) >= QUIET_US;
        if is_quiet && !is_camera_open {
            // In the clock of the frames, so that a replay shows it when it happened.
            let time_us = self.last.map_or(now_us, |last| last.time_us + now_us.saturating_sub(last.made_us));
            self.last = Some(Entry { time_us, made_us: now_us, is_frame: false });
            self.send(client, &Recorded::nothing(time_us, Reason::NoCamera), now_us)?;
        }
        let lost = frames.lost() + self.refused;
        if (lost != self.lost || (is_quiet && is_camera_open)) && !client.is_behind() {
            self.lost = lost;
            self.sent_us = now_us;
            client.send(&Reply::Lost(lost))?;
        }
        Ok(())
    }

    fn send(&mut self, client: &mut Client, frame: &Recorded, now_us: u64) -> io::Result<()> {
        if client.is_behind() {
            self.refused += 1;
            return Ok(());
        }
        self.sent_us = now_us;
        client.send(&Reply::Frame(BASE64_STANDARD.encode(frame.to_bytes())))
    }
}
