//! ROS 2 by Zenoh, for nodes with `rmw_zenoh_cpp`.
//!
//! The session is a client of one router, which carries everything to the nodes, and which Zenoh connects to again after a
//! loss. Where the connection is too slow, Zenoh drops messages, as it does for writers of ROS that keep their last ones.

use std::{
    sync::mpsc::{RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant, SystemTime},
};

use serde::Serialize;
use serde_json::json;
use zenoh::{Config, Session, Wait as _, liveliness::LivelinessToken};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig, MissDetectionConfig};

use super::{Failed, Kind, LOOK, SECOND, rmw_zenoh};
use crate::{fleet::Shared, say, settings::Ros};

/// How soon a reader that keeps the last message learns that it lost it: as in rmw_zenoh.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// This program's node.
pub struct Node {
    session: Session,
    session_id: String,
    router: String,
    domain: u16,
    /// The number of the newest writer.
    writers: u64,
    is_connected: bool,
    _token: LivelinessToken,
}

impl Node {
    /// Waits for the router, until the program ends.
    pub fn open(settings: &Ros, endpoint: String, shared: &Shared) -> Result<Self, Failed> {
        let mut config = Config::default();
        for (key, value) in [
            ("mode", json!("client")),
            ("connect/endpoints", json!([endpoint])),
            // Tries for ever.
            ("connect/timeout_ms", json!(-1)),
            ("scouting/multicast/enabled", json!(false)),
            // Readers that ask for earlier messages go by their times.
            ("timestamping/enabled", json!(true)),
        ] {
            config.insert_json5(key, &value.to_string())?;
        }
        let (sender, opened) = channel();
        // Looking up a name and connecting may take long, and cannot be interrupted.
        thread::Builder::new().name("zenoh".to_owned()).spawn(move || sender.send(zenoh::open(config).wait()))?;
        let mut tells_at = Some(Instant::now() + SECOND);
        let session = loop {
            match opened.recv_timeout(LOOK) {
                Ok(session) => break session?,
                Err(RecvTimeoutError::Timeout) if !shared.is_stopped() => {}
                Err(error) => return Err(error.into()),
            }
            if tells_at.take_if(|at| Instant::now() > *at).is_some() {
                say(&format!(
                    "no Zenoh router at {endpoint}; check its address, that it runs (ros2 run rmw_zenoh_cpp rmw_zenohd), and \
                     the firewall. Trying again"
                ));
            }
        };
        let (domain, session_id) = (settings.domain(), session.zid().to_string());
        let token = session.liveliness().declare_token(rmw_zenoh::node_token(domain, &session_id)).wait()?;
        let mut node =
            Self { session, session_id, router: endpoint, domain, writers: 0, is_connected: false, _token: token };
        node.watch();
        Ok(node)
    }

    pub fn writer(&mut self, topic: &str, kind: &Kind) -> Result<Writer, Failed> {
        self.writers += 1;
        let key = rmw_zenoh::key(self.domain, topic, kind);
        let token = rmw_zenoh::writer_token(self.domain, &self.session_id, self.writers, topic, kind);
        let publisher = self.session.declare_publisher(key);
        let publisher = if kind.is_latched {
            publisher
                .cache(CacheConfig::default().max_samples(kind.depth()))
                .publisher_detection()
                .sample_miss_detection(MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT))
        } else {
            publisher.advanced()
        };
        let (publisher, gid) = (publisher.wait()?, rmw_zenoh::gid(&token));
        let token = self.session.liveliness().declare_token(token).wait()?;
        Ok(Writer { publisher, gid, written: 0, _token: token })
    }

    /// Says whether the router came or went.
    pub fn watch(&mut self) {
        let info = self.session.info();
        let is_connected = info.routers_zid().wait().chain(info.peers_zid().wait()).next().is_some();
        if std::mem::replace(&mut self.is_connected, is_connected) != is_connected {
            let what = if is_connected { "connected to" } else { "waiting for" };
            say(&format!("{what} the Zenoh router at {}", self.router));
        }
    }
}

/// A writer of one topic.
pub struct Writer {
    publisher: AdvancedPublisher<'static>,
    gid: [u8; 16],
    /// The number of messages so far.
    written: i64,
    _token: LivelinessToken,
}

impl Writer {
    pub fn publish(&mut self, message: &impl Serialize) -> Result<(), Failed> {
        let payload = rmw_zenoh::payload(message)?;
        self.written += 1;
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
        let attachment = rmw_zenoh::attachment(self.written, i64::try_from(since_1970.as_nanos())?, self.gid);
        self.publisher.put(payload).attachment(attachment).wait()
    }
}
