//! The stream of snapshots for an open page, as server-sent events.
//!
//! The stream takes the newest snapshot whenever the client has room for one, so that what a slow client misses is
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
use serde_json::json;
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    time::{sleep_until, timeout},
};

use super::{Body, Refusal};
use crate::{hint::Hint, snapshot::Snapshot};

/// Least time between two snapshots: browsers draw 60 pictures a second.
const PERIOD: Duration = Duration::from_nanos(16_666_667);
/// Greatest time between two snapshots, so that a page can tell silence from a lost connection.
const KEEP_ALIVE: Duration = Duration::from_millis(500);

const FULL: Refusal = Refusal(
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
    pub fn new(hint: &Hint, snapshots: watch::Receiver<Snapshot>, most: usize) -> Self {
        let hello = json!({
            "names": BLENDSHAPES.as_slice(),
            "silence_ms": SILENCE_MS,
            "hint": hint,
        });
        let hello = format!("retry: 1000\nevent: hello\ndata: {hello}\n\n");
        Self { hello, snapshots, places: Arc::new(Semaphore::new(most)), start: Instant::now() }
    }

    /// Opens a stream, if there is a place for one more.
    pub fn open(&self) -> Result<Response<Body>, Refusal> {
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| FULL)?;
        let (sender, body) = Channel::new(1);
        let stream = Stream { sender, snapshots: self.snapshots.clone(), start: self.start, _place: place };
        tokio::spawn(stream.run(self.hello.clone()));
        let mut response = Response::new(body.boxed());
        response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
        Ok(response)
    }
}

/// One open stream.
struct Stream {
    sender: Sender<Bytes>,
    snapshots: watch::Receiver<Snapshot>,
    start: Instant,
    _place: OwnedSemaphorePermit,
}

impl Stream {
    /// Sends snapshots until the client goes away.
    async fn run(mut self, hello: String) {
        let mut event = hello;
        let mut due = tokio::time::Instant::now();
        while self.sender.send_data(event.into()).await.is_ok() {
            sleep_until(due).await;
            // Either a new snapshot has come, or it is time for the same again.
            let _ = timeout(KEEP_ALIVE, self.snapshots.changed()).await;
            event = self.newest();
            // A period is counted from the time at which the last snapshot was due, so that late wake-ups do not add up.
            due = (due + PERIOD).max(tokio::time::Instant::now());
        }
    }

    fn newest(&mut self) -> String {
        let json = self.snapshots.borrow_and_update().to_json(self.start, Instant::now());
        format!("data: {json}\n\n")
    }
}
