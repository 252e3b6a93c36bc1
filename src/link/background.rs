//! A carrier that may wait: one thread, one device, and the newest message.
//!
//! Role: takes messages to a device that may block, be missing or disappear, such as a serial port.
//! Contract: [`Background::send`](Carrier::send) hands the message to the device's own thread through a triple buffer,
//! where the newest message wins, so it never waits. A device that is missing or disappears is opened again, after
//! 100 ms at first and at most 1 s later. A device that the link of a former configuration still has is waited for in
//! silence. Every message is counted as sent or dropped.

use std::{
    fmt::Debug,
    sync::{
        Arc,
        atomic::{
            AtomicBool,
            Ordering::{Acquire, Relaxed, Release},
        },
    },
    thread::{self, Builder, JoinHandle},
    time::{Duration, Instant},
};

use triple_buffer::{Input, Output as Newest, triple_buffer};

use super::{Carrier, LinkError, LinkErrorKind, Traffic};
use crate::retry::Retry;

/// Longest message, bytes. A line of JSON with all coefficients takes about 1500.
const MESSAGE_BYTES: usize = 2048;
/// How long a new link waits in silence for the link that it replaces to close the device.
const HANDOVER: Duration = Duration::from_secs(2);
/// How long a busy device is offered the last message again.
const LAST_MESSAGE_TIMEOUT: Duration = Duration::from_millis(100);
/// Time between two attempts to write the last message, or to open the device during a handover.
const RETRY_PERIOD: Duration = Duration::from_millis(2);
/// Longest sleep. Every message ends it.
const IDLE: Duration = Duration::from_millis(100);

/// The encoded bytes of one message.
type Message = heapless::Vec<u8, MESSAGE_BYTES>;

/// A device with a thread of its own, on which it may block, allocate and log. After an error of a method the device is
/// closed and opened again.
pub trait Device: Debug + Send + 'static {
    fn open(&mut self) -> Result<(), LinkError>;

    /// Writes the message. Returns whether the device took it.
    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError>;

    /// Looks after the open device. Called after each message, and at least every 100 ms.
    fn attend(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    /// Closes the device if it is open: after an error, and at the end.
    fn close(&mut self);
}

/// State that the carrier and its thread share.
#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    open: AtomicBool,
    /// Whether the receiver is known. One that was found once is known even while it is away.
    has_receiver: AtomicBool,
    traffic: Arc<Traffic>,
}

impl Shared {
    fn stopping(&self) -> bool {
        self.stop.load(Acquire)
    }

    fn drop_one(&self) {
        Traffic::count(&self.traffic.dropped);
    }
}

/// A device with its thread. When it is dropped, the thread writes the last message and ends by itself.
#[derive(Debug)]
pub struct Background {
    newest: Input<Message>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl Background {
    /// Starts the thread. The device may appear later. Until the receiver is found, nothing is sent or counted.
    pub fn start(
        link: String,
        name: &str,
        device: impl Device,
        is_found: bool,
        traffic: Arc<Traffic>,
    ) -> Result<Self, LinkError> {
        let (newest, output) = triple_buffer(&Message::new());
        let shared = Arc::new(Shared { traffic, has_receiver: is_found.into(), ..Shared::default() });
        let work =
            Work { device, newest: output, is_refused: false, shared: Arc::clone(&shared), retry: Retry::default() };
        let thread = Builder::new().name(name.to_owned()).spawn(move || work.run());
        let thread = thread.map_err(|error| LinkError::no_thread(link, error))?;
        Ok(Self { newest, shared, thread })
    }
}

impl Carrier for Background {
    /// Hands the message to the thread. It replaces a message that was not written yet.
    fn send(&mut self, message: &[u8]) {
        let buffer = self.newest.input_buffer_mut();
        buffer.clear();
        if buffer.extend_from_slice(message).is_err() || self.newest.publish() {
            self.shared.drop_one();
        }
        // A thread that waits to try again has no use for the message, which a newer one will replace.
        if self.is_open() {
            self.thread.thread().unpark();
        }
    }

    fn is_open(&self) -> bool {
        self.shared.open.load(Relaxed)
    }

    fn has_receiver(&self) -> bool {
        self.shared.has_receiver.load(Relaxed)
    }

    /// Asks the thread to write the message that it was given last, and to end.
    fn stop(&self) {
        self.shared.stop.store(true, Release);
        self.thread.thread().unpark();
    }

    fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The thread of a device.
struct Work<D> {
    device: D,
    newest: Newest<Message>,
    /// Whether the device was too busy for the message that it was given last.
    is_refused: bool,
    shared: Arc<Shared>,
    /// The attempts to open the device since the last message was written.
    retry: Retry,
}

impl<D: Device> Work<D> {
    /// Writes messages until it is told to stop. This thread also logs what happens to the device, because no message
    /// waits for it.
    fn run(mut self) {
        let handover_end = Instant::now() + HANDOVER;
        while !self.shared.stopping() {
            let ended = self.session();
            self.shared.open.store(false, Relaxed);
            self.device.close();
            match ended {
                Err(error) if error.kind == LinkErrorKind::Claimed && Instant::now() < handover_end => {
                    self.pause(RETRY_PERIOD);
                }
                ended => {
                    ended.err().iter().for_each(|error| self.log(error));
                    let wait = self.retry.wait();
                    self.pause(wait);
                }
            }
        }
        // A message that came while there was no device is dropped.
        if self.newest.update() {
            self.shared.drop_one();
        }
    }

    /// Logs why the device is not open, once for each reason. A receiver that is not there yet is no fault, and is
    /// logged as information.
    fn log(&mut self, error: &LinkError) {
        if error.kind != LinkErrorKind::Waiting {
            self.retry.warn(error);
        } else if self.retry.logged.is_new(&error.to_string()) {
            tracing::info!("{error}");
        }
    }

    /// Runs from opening the device to the first error, or to the end.
    fn session(&mut self) -> Result<(), LinkError> {
        let opened = self.device.open();
        if !opened.as_ref().is_err_and(|error| error.kind == LinkErrorKind::Waiting) {
            self.shared.has_receiver.store(true, Relaxed);
        }
        opened?;
        self.shared.open.store(true, Relaxed);
        loop {
            // Read before the message, so that a message given before the end is still written.
            let stopping = self.shared.stopping();
            if self.newest.update() {
                self.write()?;
            } else if stopping {
                return self.write_last_again();
            } else {
                self.device.attend()?;
                thread::park_timeout(IDLE);
            }
        }
    }

    /// Offers the device the last message again if it was too busy for it, because no newer message will come. The
    /// message has already been counted.
    fn write_last_again(&mut self) -> Result<(), LinkError> {
        let end = Instant::now() + LAST_MESSAGE_TIMEOUT;
        while self.is_refused && Instant::now() < end {
            thread::sleep(RETRY_PERIOD);
            self.is_refused = !self.device.write(self.newest.peek_output_buffer())?;
        }
        Ok(())
    }

    fn write(&mut self) -> Result<(), LinkError> {
        let took = self.device.write(self.newest.peek_output_buffer());
        self.is_refused = matches!(took, Ok(false));
        if matches!(took, Ok(true)) {
            self.retry = Retry::default();
            Traffic::count(&self.shared.traffic.sent);
        } else {
            self.shared.drop_one();
        }
        took.map(drop)
    }

    /// Waits, however many messages come meanwhile.
    fn pause(&self, wait: Duration) {
        let end = Instant::now() + wait;
        while !self.shared.stopping() && Instant::now() < end {
            thread::park_timeout(end.saturating_duration_since(Instant::now()));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    /// A device that reports each message to the test, and takes it once the test tells whether it does.
    #[derive(Debug)]
    struct Scripted {
        given: mpsc::Sender<Vec<u8>>,
        takes: mpsc::Receiver<bool>,
        /// How many times another link has the device.
        claimed: u32,
    }

    impl Device for Scripted {
        fn open(&mut self) -> Result<(), LinkError> {
            if self.claimed == 0 {
                return Ok(());
            }
            self.claimed -= 1;
            Err(LinkError::new(LinkErrorKind::Claimed, "test", "claimed"))
        }

        fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
            let _ = self.given.send(message.to_vec());
            Ok(self.takes.recv().unwrap_or(true))
        }

        fn close(&mut self) {}
    }

    struct Test {
        carrier: Background,
        given: mpsc::Receiver<Vec<u8>>,
        takes: mpsc::Sender<bool>,
        traffic: Arc<Traffic>,
    }

    impl Test {
        /// Starts a carrier and waits until its device is open.
        fn start(claimed: u32) -> Self {
            let ((given, written), (takes, answers)) = (mpsc::channel(), mpsc::channel());
            let (traffic, device) = (Arc::<Traffic>::default(), Scripted { given, takes: answers, claimed });
            let carrier = Background::start("test".to_owned(), "fw-test", device, true, Arc::clone(&traffic)).unwrap();
            while !carrier.is_open() {
                thread::yield_now();
            }
            Self { carrier, given: written, takes, traffic }
        }

        fn counts(&self) -> (u64, u64) {
            (self.traffic.sent.load(Relaxed), self.traffic.dropped.load(Relaxed))
        }
    }

    #[test]
    fn a_carrier_that_is_dropped_writes_its_last_message_even_if_the_device_is_busy() {
        let mut test = Test::start(0);
        test.carrier.send(&[7]);
        [false, true].into_iter().for_each(|takes| test.takes.send(takes).unwrap());
        assert_eq!(test.given.recv().unwrap(), [7]);
        test.carrier.stop();
        assert_eq!(test.given.iter().collect::<Vec<_>>(), [[7]]);
        assert_eq!(test.counts(), (0, 1), "each message is counted once");
    }

    #[test]
    fn a_device_that_hangs_delays_no_sender_and_then_gets_the_newest_message() {
        let mut test = Test::start(0);
        test.carrier.send(&[0]);
        assert_eq!(test.given.recv().unwrap(), [0]);
        // The thread hangs. If a sender waited for it, this would not end.
        (1..=100).for_each(|number| test.carrier.send(&[number]));
        assert_eq!(test.counts(), (0, 99));
        test.carrier.stop();
        assert!(!test.carrier.has_ended());
        (0..2).for_each(|_| test.takes.send(true).unwrap());
        assert_eq!(test.given.iter().collect::<Vec<_>>(), [[100]]);
        assert_eq!(test.counts(), (2, 99));
    }

    #[test]
    fn a_device_that_the_replaced_link_still_has_is_opened_as_soon_as_it_is_free() {
        let begun = Instant::now();
        Test::start(20);
        assert!(begun.elapsed() < HANDOVER, "a back-off would take 20 s: {:?}", begun.elapsed());
    }
}
