//! The address of a host name, looked up again and again on a thread of its own.
//!
//! A name may resolve only after the network has come up, and its address may change at any time. A look-up may take
//! seconds, so it never happens on the sender's thread: a triple buffer hands over each new destination.

use std::{
    io,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread::{self, Thread},
    time::Duration,
};

use triple_buffer::Input;

use super::{LinkError, udp::Destination};
use crate::config::Address;
use crate::retry::Retry;

/// The look-ups for one link. They end when this is dropped.
#[derive(Debug)]
pub struct Lookup {
    is_over: Arc<AtomicBool>,
    thread: Thread,
}

impl Lookup {
    /// Starts to look up `address` with `resolve`, and again after each `period`. Writes the results to `destination`.
    ///
    /// # Errors
    /// Returns an error if the system refuses a thread.
    pub fn start<R>(
        address: Address,
        resolve: R,
        period: Duration,
        destination: Input<Option<Destination>>,
    ) -> Result<Self, LinkError>
    where
        R: Fn(&Address) -> io::Result<Vec<SocketAddr>> + Send + 'static,
    {
        let (is_over, link) = (Arc::new(AtomicBool::new(false)), address.to_string());
        let lookups = Lookups { address, resolve, period, destination, current: None, is_over: Arc::clone(&is_over) };
        let thread = thread::Builder::new().name("fw-lookup".to_owned()).spawn(|| lookups.run());
        let thread = thread.map_err(|error| LinkError::Thread { link, error })?.thread().clone();
        Ok(Self { is_over, thread })
    }

    /// Makes the thread look up the address now.
    pub fn refresh(&self) {
        self.thread.unpark();
    }
}

impl Drop for Lookup {
    fn drop(&mut self) {
        self.is_over.store(true, Relaxed);
        self.thread.unpark();
    }
}

struct Lookups<R> {
    address: Address,
    resolve: R,
    period: Duration,
    destination: Input<Option<Destination>>,
    current: Option<SocketAddr>,
    is_over: Arc<AtomicBool>,
}

impl<R: Fn(&Address) -> io::Result<Vec<SocketAddr>>> Lookups<R> {
    fn run(mut self) {
        let mut retry = Retry::default();
        while !self.is_over.load(Relaxed) {
            let wait = match (self.look_up(), self.current) {
                (Ok(()), _) => {
                    retry = Retry::default();
                    self.period
                }
                (Err(error), Some(current)) => {
                    if retry.logged.is_new(&error.to_string()) {
                        tracing::warn!("{error}; packets still go to {current}");
                    }
                    self.period
                }
                (Err(error), None) => {
                    retry.warn(&error);
                    retry.wait()
                }
            };
            thread::park_timeout(wait);
        }
    }

    /// Looks the address up once. On an error the current destination stays.
    fn look_up(&mut self) -> Result<(), LinkError> {
        let found = (self.resolve)(&self.address);
        let receiver = choose(&self.address, found, self.current)?;
        if self.current != Some(receiver) {
            self.destination.write(Some(Destination::new(&self.address, receiver)?));
            tracing::info!("link {}: packets go to {receiver}", self.address);
            self.current = Some(receiver);
        }
        Ok(())
    }
}

/// Chooses one of the addresses found: the current one if it is among them, so that the order in which a name server
/// lists addresses does not matter; otherwise the first IPv4 address, because small receivers seldom listen to IPv6.
pub fn choose(
    address: &Address,
    found: io::Result<Vec<SocketAddr>>,
    current: Option<SocketAddr>,
) -> Result<SocketAddr, LinkError> {
    let unresolved = |reason| LinkError::Resolve { address: address.to_string(), reason };
    let found = found.map_err(|error| unresolved(error.to_string()))?;
    let kept = current.filter(|current| found.contains(current));
    let chosen = kept.or_else(|| found.into_iter().min_by_key(SocketAddr::is_ipv6));
    chosen.ok_or_else(|| unresolved("it has no address".to_owned()))
}
