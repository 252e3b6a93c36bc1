//! A carrier that may wait: one thread, one device, and the newest message.
//!
//! [`Background::send`] hands the message to the device's own thread through a triple buffer, where the
//! newest message wins, so it never waits. A device that is missing or disappears is opened again, after 100 ms at first
//! and at most 1 s later; the waits begin at 100 ms again once it has worked for a second. A device that the link of a former configuration still has is waited for in silence.

use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Acquire, Ordering::Relaxed, Ordering::Release};
use std::thread::{self, Builder, JoinHandle};
use std::time::{Duration, Instant};

use triple_buffer::{Input, Output as Newest, triple_buffer};

use super::{LINK_STACK_BYTES, LinkError, LinkErrorKind, PANIC_PAUSE, Panel, panics};
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

type Message = heapless::Vec<u8, MESSAGE_BYTES>;

/// A device with a thread of its own, on which it may block, allocate and log.
pub(super) trait Device: Send + 'static {
    /// The open device, which closes when this is dropped: after an error of one of the methods, and at the end.
    type Open;

    fn open(&mut self) -> Result<Self::Open, LinkError>;

    /// Logs that the device is open, and begins to log anew. A device that opens and fails, again and again, does so once.
    fn log_opened(&mut self, _open: &Self::Open) {}

    /// Writes the message. Returns whether the device took it.
    fn write(&mut self, open: &mut Self::Open, message: &[u8]) -> Result<bool, LinkError>;

    /// Looks after the device. Called after each message, and at least every 100 ms.
    fn attend(&mut self, _open: &mut Self::Open) -> Result<(), LinkError> {
        Ok(())
    }

    /// Whether the receiver is known. Until then nothing is sent or counted.
    fn has_receiver(&self) -> bool {
        true
    }

    /// Lets go of what the device moves, before it is closed for good. A device that another link opens at once is left as it is.
    fn let_go(&mut self, _open: &mut Self::Open) -> Result<(), LinkError> {
        Ok(())
    }
}

#[derive(Debug, Default)]
struct Shared {
    /// Whether the thread is to end.
    stop: AtomicBool,
    /// Whether another link opens the device at once.
    hands_over: AtomicBool,
    open: AtomicBool,
    has_receiver: AtomicBool,
    panel: Arc<Panel>,
}

/// A device with its thread. When it is dropped, the thread writes the last message and ends by itself.
pub struct Background {
    newest: Input<Message>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl Background {
    /// Starts the thread. The device may appear later.
    pub(super) fn start(
        link: impl Display,
        name: &str,
        device: impl Device,
        panel: Arc<Panel>,
    ) -> Result<Self, LinkError> {
        Self::start_within(HANDOVER, link, name, device, panel)
    }

    /// Starts the thread, which waits in silence for so long for the link that it replaces.
    fn start_within(
        handover: Duration,
        link: impl Display,
        name: &str,
        device: impl Device,
        panel: Arc<Panel>,
    ) -> Result<Self, LinkError> {
        let (newest, output) = triple_buffer(&Message::new());
        let shared = Arc::new(Shared { panel, has_receiver: device.has_receiver().into(), ..Shared::default() });
        let theirs = Arc::clone(&shared);
        let what = link.to_string();
        let mut device = device;
        let mut output = output;
        let thread = Builder::new().name(name.to_owned()).stack_size(LINK_STACK_BYTES).spawn(move || {
            // A panic leaves the loop with the device closed.
            while panics(&what, &theirs.panel, || run(&mut device, &mut output, &theirs, handover)) {
                theirs.open.store(false, Relaxed);
                sleep_unless_stopped(&theirs, PANIC_PAUSE);
            }
        });
        let thread = thread.map_err(|error| LinkError::no_thread(link, error))?;
        Ok(Self { newest, shared, thread })
    }

    /// Hands the message over or drops it, without waiting, and counts it.
    pub fn send(&mut self, message: &[u8]) {
        let buffer = self.newest.input_buffer_mut();
        buffer.clear();
        if buffer.extend_from_slice(message).is_err() || self.newest.publish() {
            self.shared.panel.count(false);
        }
        // A thread that waits to try again has no use for the message, which a newer one will replace.
        if self.is_open() {
            self.thread.thread().unpark();
        }
    }

    pub fn is_open(&self) -> bool {
        self.shared.open.load(Relaxed)
    }

    /// Whether the receiver is known. Until then nothing is sent or counted.
    pub(super) fn has_receiver(&self) -> bool {
        self.shared.has_receiver.load(Relaxed)
    }

    /// Asks the thread to write what it was given and end, without waiting for it.
    pub(super) fn stop(&self) {
        self.shared.stop.store(true, Release);
        self.thread.thread().unpark();
    }

    /// As [`Background::stop`], for a device that another link opens at once.
    pub(super) fn hand_over(&self) {
        self.shared.hands_over.store(true, Relaxed);
        self.stop();
    }

    pub(super) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Writes messages until it is told to stop, and logs what happens to the device: on this thread, that delays no sender.
fn run(device: &mut impl Device, newest: &mut Newest<Message>, shared: &Shared, handover: Duration) {
    let handover_end = Instant::now() + handover;
    let mut retry = Retry::default();
    while !shared.stop.load(Acquire) {
        let ended = session(device, newest, shared, &mut retry, &Instant::now);
        shared.open.store(false, Relaxed);
        shared.panel.dials.note_released(false);
        let mut is_handover = false;
        if let Err(error) = ended {
            shared.panel.note(Some(&error.message));
            match error.kind {
                LinkErrorKind::Claimed if Instant::now() < handover_end => is_handover = true,
                // A receiver that is not there yet is no fault.
                LinkErrorKind::Waiting => {
                    if retry.logged.is_new(&error.to_string()) {
                        tracing::info!("{error}");
                    }
                }
                _ => retry.warn(&error),
            }
        }
        let wait = if is_handover { RETRY_PERIOD } else { retry.back_off.wait() };
        sleep_unless_stopped(shared, wait);
    }
    // A message that came while there was no device is dropped.
    if newest.update() {
        shared.panel.count(false);
    }
}

fn sleep_unless_stopped(shared: &Shared, time: Duration) {
    let end = Instant::now() + time;
    while !shared.stop.load(Acquire) && Instant::now() < end {
        thread::park_timeout(end.saturating_duration_since(Instant::now()));
    }
}

/// Runs from opening the device to the first error, or to the end. `retry` starts anew with each message that is written once
/// the device has been open for a second.
fn session(
    device: &mut impl Device,
    newest: &mut Newest<Message>,
    shared: &Shared,
    retry: &mut Retry,
    now: &dyn Fn() -> Instant,
) -> Result<(), LinkError> {
    let opened = device.open();
    let opened_at = now();
    let mut is_refused = false;
    shared.has_receiver.store(device.has_receiver(), Relaxed);
    let mut open = opened?;
    shared.open.store(true, Relaxed);
    shared.panel.note(None);
    let mut is_logged = false;
    let mut is_to_be_logged = !std::mem::replace(&mut retry.has_logged_success, true);
    loop {
        if is_to_be_logged && !is_logged {
            device.log_opened(&open);
            is_logged = true;
        }
        // Read before the message, so that a message given before the end is still written.
        let is_stopping = shared.stop.load(Acquire);
        if newest.update() {
            let took = device.write(&mut open, newest.peek_output_buffer());
            let is_taken = matches!(took, Ok(true));
            is_refused = matches!(took, Ok(false));
            if is_taken {
                is_to_be_logged |= retry.succeed(now().saturating_duration_since(opened_at));
            }
            shared.panel.count(is_taken);
            took?;
            // Otherwise a device that is slower than the messages come would never be attended.
            if newest.updated() {
                device.attend(&mut open)?;
            }
        } else if is_stopping {
            // No newer message will come, so a busy device is offered this one again. It has already been counted.
            let end = Instant::now() + LAST_MESSAGE_TIMEOUT;
            while is_refused && Instant::now() < end {
                thread::sleep(RETRY_PERIOD);
                is_refused = !device.write(&mut open, newest.peek_output_buffer())?;
            }
            return if shared.hands_over.load(Relaxed) { Ok(()) } else { device.let_go(&mut open) };
        } else {
            device.attend(&mut open)?;
            shared.has_receiver.store(device.has_receiver(), Relaxed);
            thread::park_timeout(IDLE);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::sync::{Mutex, mpsc};

    use super::*;
    use crate::link::testing::{PATIENCE, counts, eventually};

    /// A device that reports each message to the test, and takes it once the test tells whether it does.
    struct Scripted {
        given: mpsc::Sender<Vec<u8>>,
        takes: mpsc::Receiver<bool>,
        /// How many times another link has the device.
        claimed: u32,
    }

    impl Device for Scripted {
        type Open = ();

        fn open(&mut self) -> Result<(), LinkError> {
            let is_claimed = self.claimed > 0;
            self.claimed = self.claimed.saturating_sub(1);
            if is_claimed { Err(LinkError::new(LinkErrorKind::Claimed, "test", "claimed")) } else { Ok(()) }
        }

        fn write(&mut self, (): &mut (), message: &[u8]) -> Result<bool, LinkError> {
            let _ = self.given.send(message.to_vec());
            Ok(self.takes.recv().unwrap_or(true))
        }
    }

    /// Starts a carrier and waits until its device is open. Returns also what the device is given, what it is told about
    /// each message, and the counters.
    fn start(claimed: u32) -> (Background, mpsc::Receiver<Vec<u8>>, mpsc::Sender<bool>, Arc<Panel>) {
        let (given, written) = mpsc::channel();
        let (takes, answers) = mpsc::channel();
        let panel = Arc::<Panel>::default();
        let device = Scripted { given, takes: answers, claimed };
        let carrier = Background::start_within(10 * PATIENCE, "test", "fw-test", device, Arc::clone(&panel)).unwrap();
        eventually("the device is open", || carrier.is_open());
        (carrier, written, takes, panel)
    }

    #[test]
    fn a_carrier_that_is_dropped_writes_its_last_message_even_if_the_device_is_busy() {
        let (mut carrier, given, takes, panel) = start(0);
        carrier.send(&[7]);
        [false, true].into_iter().for_each(|is_taken| takes.send(is_taken).unwrap());
        assert_eq!(given.recv().unwrap(), [7]);
        drop(carrier);
        assert_eq!(given.iter().collect::<Vec<_>>(), [[7]]);
        assert_eq!(counts(&panel), [0, 1], "each message is counted once");
    }

    #[test]
    fn a_device_that_hangs_delays_no_sender_and_then_gets_the_newest_message() {
        let (mut carrier, given, takes, panel) = start(0);
        carrier.send(&[0]);
        assert_eq!(given.recv().unwrap(), [0]);
        // The thread hangs. If a sender waited for it, this would not end.
        (1..=100).for_each(|number| carrier.send(&[number]));
        assert_eq!(counts(&panel), [0, 99]);
        carrier.stop();
        assert!(!carrier.has_ended());
        (0..2).for_each(|_| takes.send(true).unwrap());
        assert_eq!(given.iter().collect::<Vec<_>>(), [[100]]);
        assert_eq!(counts(&panel), [2, 99]);
    }

    /// A device whose driver panics at every other message.
    struct Panicking {
        messages: u32,
        given: mpsc::Sender<Vec<u8>>,
    }

    impl Device for Panicking {
        type Open = ();

        fn open(&mut self) -> Result<(), LinkError> {
            Ok(())
        }

        fn write(&mut self, (): &mut (), message: &[u8]) -> Result<bool, LinkError> {
            self.messages += 1;
            assert!(self.messages.is_multiple_of(2), "tried");
            let _ = self.given.send(message.to_vec());
            Ok(true)
        }
    }

    #[test]
    fn a_link_whose_thread_panics_is_shown_as_closed_with_its_trouble_and_then_comes_back() {
        let (given, written) = mpsc::channel();
        let panel = Arc::<Panel>::default();
        let device = Panicking { messages: 0, given };
        let mut carrier = Background::start("test", "fw-test", device, Arc::clone(&panel)).unwrap();
        eventually("the device is open", || carrier.is_open());
        panel.dials.note_released(true);
        carrier.send(&[1]);
        eventually("the link is closed", || !carrier.is_open());
        assert!(panel.trouble().is_some_and(|trouble| trouble.contains("fault of facewire")));
        assert!(!panel.dials.has_released(), "nobody knows what its servos do");
        eventually("the link is open again", || carrier.is_open());
        assert_eq!(panel.trouble(), None);
        carrier.send(&[2]);
        assert_eq!(written.recv().unwrap(), [2]);
    }

    /// A device that takes one message, as late as the test's clock says then, and fails at once.
    struct Flapping {
        clock: Arc<Mutex<Instant>>,
        works_for: Duration,
        logged: Cell<u32>,
    }

    impl Device for Flapping {
        type Open = ();

        fn open(&mut self) -> Result<(), LinkError> {
            Ok(())
        }

        fn log_opened(&mut self, (): &()) {
            self.logged.set(self.logged.get() + 1);
        }

        fn write(&mut self, (): &mut (), _: &[u8]) -> Result<bool, LinkError> {
            *self.clock.lock().unwrap() += self.works_for;
            Ok(true)
        }

        fn attend(&mut self, (): &mut ()) -> Result<(), LinkError> {
            Err(LinkError::new(LinkErrorKind::Other, "test", "went away"))
        }
    }

    #[test]
    fn a_device_that_takes_a_message_and_fails_again_and_again_is_opened_ever_more_rarely_until_it_works_for_a_second()
    {
        let clock = Arc::new(Mutex::new(Instant::now()));
        let mut device = Flapping { clock: Arc::clone(&clock), works_for: Duration::ZERO, logged: Cell::new(0) };
        let (mut newest, mut output) = triple_buffer(&Message::new());
        let mut retry = Retry::default();
        // Returns the wait after the failure in milliseconds, whether it is logged, and how many openings have been logged.
        let mut flap = |works_for_ms| {
            device.works_for = Duration::from_millis(works_for_ms);
            newest.write(Message::new());
            let now = || *clock.lock().unwrap();
            let error = session(&mut device, &mut output, &Shared::default(), &mut retry, &now).unwrap_err();
            let is_logged = retry.logged.is_new(&error.message);
            (retry.back_off.wait().as_millis(), is_logged, device.logged.get())
        };
        assert_eq!(flap(0), (100, true, 1));
        assert_eq!([0, 999, 0, 0].map(&mut flap), [200, 400, 800, 1000].map(|wait_ms| (wait_ms, false, 1)));
        assert_eq!(flap(1000), (100, true, 2), "that it works is logged late, because it seemed to go on failing");
        assert_eq!([0, 0].map(&mut flap), [(200, false, 3), (400, false, 3)]);
    }

    /// A device that gets the next message before it has written one, and fails when it is attended, or after a hundred.
    struct Slow {
        newest: Input<Message>,
        written: u32,
    }

    impl Device for Slow {
        type Open = ();

        fn open(&mut self) -> Result<(), LinkError> {
            Ok(())
        }

        fn write(&mut self, (): &mut (), _: &[u8]) -> Result<bool, LinkError> {
            self.newest.write(Message::new());
            self.written += 1;
            if self.written < 100 { Ok(true) } else { Err(LinkError::new(LinkErrorKind::Other, "test", "neglected")) }
        }

        fn attend(&mut self, (): &mut ()) -> Result<(), LinkError> {
            Err(LinkError::new(LinkErrorKind::Other, "test", "attended"))
        }
    }

    #[test]
    fn a_device_that_is_slower_than_its_messages_come_is_attended_after_each() {
        let (mut newest, mut output) = triple_buffer(&Message::new());
        newest.write(Message::new());
        let mut device = Slow { newest, written: 0 };
        let ended = session(&mut device, &mut output, &Shared::default(), &mut Retry::default(), &Instant::now);
        assert_eq!((ended.unwrap_err().message.as_str(), device.written), ("test: attended", 1));
    }

    #[test]
    fn a_device_that_the_replaced_link_still_has_is_opened_as_soon_as_it_is_free() {
        // A back-off would take longer than the test has patience.
        start(100);
    }
}
