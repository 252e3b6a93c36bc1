//! A calibration that a client has asked for.

use super::client::Client;
use super::protocol::Reply;
use crate::calibration::{Calibration, Guide, Observation, Progress, Refusal, WearerName};
use crate::solve::Model;

/// Time without a frame after which the guide is told that no picture comes, microseconds.
const SILENT_US: u64 = 500_000;
/// Least time between two messages in which only measures have changed, microseconds.
const PERIOD_US: u64 = 60_000;

/// A calibration in progress, and the client that has asked for it.
pub(super) struct Session {
    pub(super) client: Client,
    pub(super) name: WearerName,
    guide: Guide,
    /// When the last observation came, or the guide was told that none comes.
    observed_us: u64,
    /// What the client was told last, and when.
    told: Option<(Progress, u64)>,
    has_gone: bool,
}

impl Session {
    pub(super) fn new(client: Client, name: WearerName, model: Model, now_us: u64) -> Self {
        Self { client, name, guide: Guide::new(model), observed_us: now_us, told: None, has_gone: false }
    }

    /// Whether the client has closed the connection, or does not read what it asked for.
    pub(super) fn client_has_gone(&mut self) -> bool {
        self.has_gone || self.client.has_gone()
    }

    /// Takes in an observation if there is a new one, and tells the client.
    pub(super) fn step(&mut self, observation: Option<&Observation>, now_us: u64) {
        match observation {
            Some(observation) => self.guide.update(observation),
            None if now_us.saturating_sub(self.observed_us) > SILENT_US => {
                self.guide.update(&Observation::nothing(now_us));
            }
            None => return,
        }
        self.observed_us = now_us;
        self.tell(now_us);
    }

    /// What the calibration has found, or `None` while it goes on.
    pub(super) fn outcome(&self) -> Option<Result<Calibration, Refusal>> {
        self.guide.outcome()
    }

    fn tell(&mut self, now_us: u64) {
        let progress = self.guide.progress();
        if let Some((told, told_us)) = &self.told
            && now_us.saturating_sub(*told_us) < PERIOD_US
            && told.says_the_same(&progress)
        {
            return;
        }
        self.has_gone = self.client.send(&Reply::Progress(progress.clone())).is_err();
        self.told = Some((progress, now_us));
    }
}
