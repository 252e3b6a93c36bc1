//! A socket at which the control thread accepts clients: the control socket, or the address of the metrics.

use std::fs::{DirBuilder, Permissions, set_permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::time::{Duration, Instant};

use super::client::{Client, Speaks};
use crate::config::Listen;
use crate::listener::{Listener, is_shared};

/// Delay before the next attempt after listening or accepting a client has failed.
const RETRY_DELAY: Duration = Duration::from_secs(1);

pub(super) struct Endpoint {
    pub(super) listen: Listen,
    pub(super) speaks: Speaks,
    pub(super) listener: Option<Listener>,
    /// Until when it is left alone, because listening or accepting a client has failed.
    rests_until: Option<Instant>,
}

impl Endpoint {
    pub(super) fn new(listen: Listen, speaks: Speaks) -> Self {
        Self { listen, speaks, listener: None, rests_until: None }
    }

    pub(super) fn rests(&self) -> bool {
        self.rests_until.is_some_and(|until| Instant::now() < until)
    }

    fn bind(&self) -> io::Result<Listener> {
        let (Listen::Unix(path), Speaks::Requests) = (&self.listen, self.speaks) else {
            return Listener::bind(&self.listen);
        };
        if let Some(folder) = path.parent() {
            DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        }
        let listener = Listener::bind(&self.listen)?;
        if !is_shared(path) {
            set_permissions(path, Permissions::from_mode(0o600))?;
        }
        Ok(listener)
    }

    /// Opens the socket if it is not open yet. A failure is told once, and tried again every second.
    pub(super) fn open(&mut self) {
        if self.listen == Listen::Off || self.listener.is_some() || self.rests() {
            return;
        }
        let (what, remedy) = match self.speaks {
            Speaks::Requests => ("control socket", "end the service that uses it, or make its folder writable"),
            Speaks::Http => ("metrics", "free the address or change metrics.listen"),
        };
        match self.bind() {
            Ok(listener) => {
                tracing::info!("{what} at {}", self.listen);
                self.listener = Some(listener);
            }
            Err(error) => {
                if self.rests_until.is_none() {
                    tracing::warn!("no {what} at {} ({error}): {remedy}; trying again every second", self.listen);
                }
                self.rest();
            }
        }
    }

    /// Returns a client that waits at the socket.
    pub(super) fn accept(&mut self) -> Option<Client> {
        match self.listener.as_ref()?.accept() {
            Ok(stream) => return Some(Client::new(stream.into(), self.speaks)),
            // Without memory or file descriptors the client stays in the queue, and the loop would spin.
            Err(error) if error.kind() != ErrorKind::WouldBlock => self.rest(),
            Err(_) => {}
        }
        None
    }

    fn rest(&mut self) {
        self.rests_until = Some(Instant::now() + RETRY_DELAY);
    }
}
