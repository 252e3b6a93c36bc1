//! A carrier that may wait: one thread, one device, and the newest message.
//!
//! Role: takes messages to a device that may block, be missing or disappear, such as a serial port.
//! Contract: [`Background::send`](Carrier::send) hands the message to the device's own thread through a triple buffer,
//! where the newest message wins, so it never waits. A device that is missing or disappears is opened again, after
//! 100 ms at first and at most 1 s later. Every message is counted as sent or dropped.

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

use super::{Carrier, LinkError, Traffic};
use crate::retry::Retry;

/// Longest message, bytes. A line of JSON with all coefficients takes about 1500.
const MESSAGE_BYTES: usize = 2048;
/// How long a busy device is offered the last message again.
const LAST_MESSAGE_PATIENCE: Duration = Duration::from_millis(100);
/// Time between two attempts to write the last message.
const RETRY_PERIOD: Duration = Duration::from_millis(2);
/// Longest sleep. Every message ends it.
const IDLE: Duration = Duration::from_millis(100);

/// The encoded bytes of one message.
type Message = heapless::Vec<u8, MESSAGE_BYTES>;

/// A device with a thread of its own, on which it may block, allocate and log.
pub trait Device: Debug + Send + 'static {
    /// Opens the device. Returns whether it is open; if not, the thread tries again later and logs nothing.
    ///
    /// # Errors
    /// Says what is missing. The log gets each reason once.
    fn open(&mut self, shared: &Shared) -> Result<bool, LinkError>;

    /// Writes the message. Returns whether the device took it.
    ///
    /// # Errors
    /// Says why the device must be opened again.
    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError>;

    /// Looks after the open device. Called after each message, and at least every 100 ms.
    ///
    /// # Errors
    /// Says why the device must be opened again.
    fn attend(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    /// Closes the device if it is open: after an error, and at the end.
    fn close(&mut self);
}

/// State that the carrier and its thread share.
#[derive(Debug, Default)]
pub struct Shared {
    stop: AtomicBool,
    open: AtomicBool,
    /// Whether the receiver is known. One that was found once is known even while it is away.
    has_receiver: AtomicBool,
    /// Whether a message was handed over since the device last took one.
    waits: AtomicBool,
    traffic: Arc<Traffic>,
}

impl Shared {
    /// Whether the thread is to end.
    pub fn stopping(&self) -> bool {
        self.stop.load(Acquire)
    }

    /// Notes that the receiver is known.
    pub fn note_receiver(&self) {
        self.has_receiver.store(true, Relaxed);
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
    ///
    /// # Errors
    /// Returns an error if the system refuses a thread. `link` names the link in it.
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
        let thread = thread.map_err(|error| LinkError::Thread { link, error })?;
        Ok(Self { newest, shared, thread })
    }
}

impl Carrier for Background {
    /// Hands the message to the thread. It replaces a message that was not written yet.
    fn send(&mut self, message: &[u8]) {
        let buffer = self.newest.input_buffer_mut();
        buffer.clear();
        self.shared.waits.store(true, Relaxed);
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

    fn took_last(&self) -> bool {
        !self.shared.waits.load(Relaxed)
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
        while !self.shared.stopping() {
            let ended = self.session();
            self.shared.open.store(false, Relaxed);
            self.device.close();
            if let Err(error) = ended {
                self.tell(&error);
            }
            let wait = self.retry.wait();
            self.pause(wait);
        }
        // A message that came while there was no device is dropped.
        if self.newest.update() {
            self.shared.drop_one();
        }
    }

    /// Logs why the device is not open, once for each reason. A receiver that is not there yet is no fault, and is
    /// logged as information.
    fn tell(&mut self, error: &LinkError) {
        if !error.is_patient() {
            self.retry.warn(error);
        } else if self.retry.logged.is_new(&error.to_string()) {
            tracing::info!("{error}");
        }
    }

    /// Runs from opening the device to the first error, or to the end.
    fn session(&mut self) -> Result<(), LinkError> {
        if !self.device.open(&self.shared)? {
            return Ok(());
        }
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
        let end = Instant::now() + LAST_MESSAGE_PATIENCE;
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
            self.shared.waits.store(false, Relaxed);
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
#[allow(clippy::unwrap_used)]
mod tests {
    use std::{mem, sync::mpsc};

    use super::*;

    /// A device that reports each message to the test, and blocks until the test lets it go on, like a bus that hangs.
    #[derive(Debug)]
    struct Hanging {
        given: mpsc::Sender<Vec<u8>>,
        go_on: mpsc::Receiver<()>,
    }

    impl Device for Hanging {
        fn open(&mut self, _shared: &Shared) -> Result<bool, LinkError> {
            Ok(true)
        }

        fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
            let _ = self.given.send(message.to_vec());
            Ok(self.go_on.recv().is_ok())
        }

        fn close(&mut self) {}
    }

    /// A device that is busy once, and then reports each message to the test.
    #[derive(Debug)]
    struct Busy {
        is_busy: bool,
        given: mpsc::Sender<Vec<u8>>,
    }

    impl Device for Busy {
        fn open(&mut self, _shared: &Shared) -> Result<bool, LinkError> {
            Ok(true)
        }

        fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
            Ok(!mem::take(&mut self.is_busy) && self.given.send(message.to_vec()).is_ok())
        }

        fn close(&mut self) {}
    }

    #[test]
    fn a_carrier_that_is_dropped_writes_its_last_message_even_if_the_device_is_busy() {
        let ((given, written), traffic) = (mpsc::channel(), Arc::<Traffic>::default());
        let device = Busy { is_busy: true, given };
        let mut carrier = Background::start("test".to_owned(), "fw-test", device, true, Arc::clone(&traffic)).unwrap();
        while !carrier.is_open() {
            thread::yield_now();
        }
        carrier.send(&[7]);
        drop(carrier);
        assert_eq!(written.iter().collect::<Vec<_>>(), [[7]]);
        let [sent, dropped] = [&traffic.sent, &traffic.dropped].map(|counter| counter.load(Relaxed));
        assert_eq!((sent, dropped), (0, 1), "each message is counted once");
    }

    #[test]
    fn a_device_that_hangs_delays_no_sender_and_then_gets_the_newest_message() {
        let ((given, written), (release, go_on)) = (mpsc::channel(), mpsc::channel());
        let traffic = Arc::<Traffic>::default();
        let device = Hanging { given, go_on };
        let mut carrier = Background::start("test".to_owned(), "fw-test", device, true, Arc::clone(&traffic)).unwrap();
        assert!(carrier.took_last());
        carrier.send(&[0]);
        assert_eq!(written.recv().unwrap(), [0]);
        // The thread hangs. If a sender waited for it, this would not end.
        (1..=100).for_each(|number| carrier.send(&[number]));
        assert!(!carrier.took_last());
        assert_eq!(traffic.dropped.load(Relaxed), 99);
        carrier.stop();
        assert!(!carrier.has_ended());
        (0..2).for_each(|_| release.send(()).unwrap());
        assert_eq!(written.recv().unwrap(), [100]);
        while !carrier.has_ended() {
            thread::yield_now();
        }
        assert_eq!(traffic.sent.load(Relaxed), 2);
        assert!(carrier.took_last());
    }
}
