//! The stream of news for an open page, as server-sent events: `hello` once, then `face`, and of a service `status`,
//! `calibration` and `recording`.
//!
//! The stream takes the newest of each kind whenever the client has room for it, so that what a slow client misses is
//! never kept. Source: <https://html.spec.whatwg.org/multipage/server-sent-events.html>

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use facewire_packet::{BLENDSHAPES, SILENCE_MS};
use http_body_util::{
    BodyExt as _,
    channel::{Channel, Sender},
};
use hyper::{
    Response, StatusCode,
    body::Bytes,
    header::{CONTENT_TYPE, HeaderValue},
};
use serde_json::{Value, json};
use tokio::{
    runtime::Handle,
    select,
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    time::{sleep_until, timeout},
};

use super::{Answer, Refusal};
use crate::{
    access::{Caller, Role},
    console::{Console, News},
    hint::Hint,
    snapshot::Snapshot,
};

/// Least time between two snapshots: browsers draw 60 pictures a second.
const PERIOD: Duration = Duration::from_nanos(16_666_667);
/// Streams that those who may only look leave to operators.
const OPERATORS_STREAMS: usize = 4;
/// Greatest time between two snapshots, so that a page can tell silence from a lost connection.
const KEEP_ALIVE: Duration = Duration::from_millis(500);

const FULL: Refusal = Refusal::fixed(
    StatusCode::SERVICE_UNAVAILABLE,
    "As many pages as facewire-console serves at a time are open. Close one of them.\n",
);

/// Opens streams.
#[derive(Debug)]
pub struct Events {
    /// The first event: what does not change.
    hello: String,
    snapshots: watch::Receiver<Snapshot>,
    places: Arc<Semaphore>,
    start: Instant,
}

impl Events {
    /// Without a hint, the packets are those of a service.
    pub fn new(hint: Option<&Hint>, snapshots: watch::Receiver<Snapshot>, most: usize) -> Self {
        let hello = json!({
            "names": BLENDSHAPES.as_slice(),
            "silence_ms": SILENCE_MS,
            "hint": hint,
        });
        let hello = format!("retry: 1000\nevent: hello\ndata: {hello}\n\n");
        Self { hello, snapshots, places: Arc::new(Semaphore::new(most)), start: Instant::now() }
    }

    /// Opens a stream, if there is a place for one more. Its events are made in the workshop.
    pub fn open(&self, service: Option<(&Arc<Console>, Caller)>, workshop: &Handle) -> Answer {
        let may_only_look =
            service.as_ref().is_some_and(|(console, caller)| console.access.must(caller, Role::Operate).is_err());
        if may_only_look && self.places.available_permits() <= OPERATORS_STREAMS {
            return Err(FULL);
        }
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| FULL)?;
        let (sender, body) = Channel::new(1);
        let news = service.map(|(console, caller)| Subscription::new(console, caller));
        let stream = Stream { sender, snapshots: self.snapshots.clone(), news, start: self.start, _place: place };
        workshop.spawn(stream.run(self.hello.clone()));
        let mut response = Response::new(body.boxed());
        response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
        Ok(response)
    }
}

/// One open stream.
struct Stream {
    sender: Sender<Bytes>,
    snapshots: watch::Receiver<Snapshot>,
    news: Option<Subscription>,
    start: Instant,
    _place: OwnedSemaphorePermit,
}

impl Stream {
    /// Sends news until the client goes away, or may not look any more.
    async fn run(mut self, hello: String) {
        let mut event = hello;
        let mut due = tokio::time::Instant::now();
        while self.may_look() && self.sender.send_data(event.into()).await.is_ok() {
            sleep_until(due).await;
            // Either something new has come, or it is time for the same snapshot again.
            let is_quiet = timeout(KEEP_ALIVE, self.changed()).await.is_err();
            event = self.newest(is_quiet);
            // A period is counted from the time at which the last snapshot was due, so that late wake-ups do not add up.
            due = (due + PERIOD).max(tokio::time::Instant::now());
        }
    }

    /// Whether the session that has opened the stream still goes on. Packets are shown to whoever has found the page.
    fn may_look(&self) -> bool {
        self.news
            .as_ref()
            .is_none_or(|Subscription { console, caller, .. }| console.access.must(caller, Role::Look).is_ok())
    }

    /// Waits for something new, and leaves it marked as new.
    async fn changed(&mut self) {
        let Some(Subscription { news: [(_, status), (_, calibration), (_, recording)], .. }) = &mut self.news else {
            let _ = self.snapshots.changed().await;
            return self.snapshots.mark_changed();
        };
        select! {
            _ = self.snapshots.changed() => self.snapshots.mark_changed(),
            _ = status.changed() => status.mark_changed(),
            _ = calibration.changed() => calibration.mark_changed(),
            _ = recording.changed() => recording.mark_changed(),
        }
    }

    /// Returns the events of what is new.
    fn newest(&mut self, is_quiet: bool) -> String {
        let mut events = String::new();
        if is_quiet || self.snapshots.has_changed().unwrap_or(true) {
            let json = self.snapshots.borrow_and_update().to_json(self.start, Instant::now());
            events = format!("event: face\ndata: {json}\n\n");
        }
        for event in self.news.iter_mut().flat_map(Subscription::events) {
            events += &event;
        }
        events
    }
}

/// What a page is told of a service. The service is asked for it while a page is open.
struct Subscription {
    console: Arc<Console>,
    caller: Caller,
    news: [(&'static str, watch::Receiver<Value>); 3],
}

impl Subscription {
    fn new(console: &Arc<Console>, caller: Caller) -> Self {
        let News { status, calibration, recording } = &console.news;
        let mut news = [
            ("status", status.subscribe()),
            ("calibration", calibration.subscribe()),
            ("recording", recording.subscribe()),
        ];
        // The last status is told at once. Of calibrations only what comes from now on.
        news[0].1.mark_changed();
        console.pages.send_modify(|pages| *pages += 1);
        Self { console: Arc::clone(console), caller, news }
    }

    fn events(&mut self) -> Vec<String> {
        let Self { console, caller, news } = self;
        let changed = news.iter_mut().filter(|(_, value)| value.has_changed().unwrap_or(false));
        let events = changed.filter_map(|(name, value)| {
            let mut value = value.borrow_and_update().clone();
            if *name == "status" {
                *value.get_mut("operator")? = console.servos.operator(caller);
            }
            Some(format!("event: {name}\ndata: {value}\n\n"))
        });
        events.collect()
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.console.pages.send_modify(|pages| *pages -= 1);
    }
}
