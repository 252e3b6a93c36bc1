//! The connection to the broker.
//!
//! rumqttc keeps what it could not send, and sends it before anything newer when it connects again. It also keeps a collision
//! of acknowledgements after the session is lost, which blocks its queue for ever. Therefore each connection has a client of
//! its own, only the farewell waits for an acknowledgement, and each connect sends everything that is retained again.

mod topics;

use std::{
    collections::hash_map::RandomState,
    hash::BuildHasher as _,
    sync::Arc,
    time::{Duration, Instant},
};

use rumqttc::{
    AsyncClient, ConnectReturnCode, ConnectionError, Event, EventLoop, LastWill, MqttOptions, Packet, QoS,
    TlsConfiguration, Transport,
};
use tokio::{
    select,
    sync::{mpsc, watch},
    task::JoinHandle,
    time::{self, MissedTickBehavior},
};

use crate::{
    fleet::Shared,
    mqtt::topics::Publisher,
    say,
    settings::{self, Broker, Fault, Mqtt},
};

const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// How often changes are looked for.
const LOOK: Duration = Duration::from_millis(100);
/// What rumqttc may hold before it is on its way. What finds no room is tried again at the next look.
const QUEUE: usize = 256;
/// The longest packet. All messages here fit rumqttc's default of 10 kB, but those of a broker may be longer.
const MOST_BYTES: usize = 64 * 1024;
/// The time to the next attempt grows from the first to the second.
const BACKOFF: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(10)];
/// How long the farewell may take.
const FAREWELL: Duration = Duration::from_secs(1);

/// A client that connects again and again.
pub struct Client {
    options: MqttOptions,
    settings: Mqtt,
    namespace: String,
    broker: Broker,
}

/// What the connection tells.
enum News {
    Connected,
    /// Home Assistant has started.
    Birth,
    /// The farewell has arrived.
    Acknowledged,
    Lost(ConnectionError),
}

impl Client {
    pub fn new(settings: &Mqtt, namespace: &str) -> Result<Self, Fault> {
        let broker = settings.address()?;
        let password = settings.password()?;
        let id = format!("facewire-{:08x}", RandomState::new().hash_one(std::process::id()) >> 32);
        let mut options = MqttOptions::new(id, &broker.host, broker.port);
        options.set_keep_alive(KEEP_ALIVE).set_max_packet_size(MOST_BYTES, MOST_BYTES);
        match (&broker.user, password) {
            (Some(user), password) => drop(options.set_credentials(user, password.unwrap_or_default())),
            (None, Some(_)) => {
                return Err(Fault("there is a password for the broker but no user: write --mqtt USER@HOST".to_owned()));
            }
            (None, None) => {}
        }
        if broker.is_tls {
            let ca = settings::read(&settings.ca_file, "the certificates to trust")?.into_bytes();
            options.set_transport(Transport::tls_with_config(TlsConfiguration::Simple {
                ca,
                alpn: None,
                client_auth: None,
            }));
        }
        let will = topics::bridge_availability(namespace);
        options.set_last_will(LastWill::new(will, topics::OFFLINE, QoS::AtLeastOnce, true));
        Ok(Self { options, settings: settings.clone(), namespace: namespace.to_owned(), broker })
    }

    /// Publishes until it is stopped.
    pub async fn run(self, shared: Arc<Shared>, mut stopped: watch::Receiver<bool>) {
        let mut publisher = Publisher::new(&self.namespace, self.settings.home_assistant);
        let (mut told, mut pause) = (String::new(), BACKOFF[0]);
        while !*stopped.borrow() {
            let error = self.connect_once(&mut publisher, &shared, &mut stopped, &mut told, &mut pause).await;
            let Some(error) = error else { return };
            let why = format!("{}: {error}; {}", self.place(), remedy(&error));
            // A broker that stays away is told once.
            if told != why {
                say(&format!("no broker at {why}. Trying again"));
                told = why;
            }
            select! {
                () = time::sleep(pause) => {}
                _ = stopped.changed() => {}
            }
            pause = (pause * 2).min(BACKOFF[1]);
        }
    }

    fn place(&self) -> String {
        format!("{}:{}", self.broker.host, self.broker.port)
    }

    /// Connects, publishes until the connection is lost, and returns why. Returns nothing once it is stopped.
    async fn connect_once(
        &self,
        publisher: &mut Publisher,
        shared: &Shared,
        stopped: &mut watch::Receiver<bool>,
        told: &mut String,
        pause: &mut Duration,
    ) -> Option<ConnectionError> {
        let (client, events) = AsyncClient::new(self.options.clone(), QUEUE);
        let (sender, mut news) = mpsc::channel(16);
        let _driver = Driver(tokio::spawn(drive(events, sender)));
        let mut is_connected = false;
        let mut looks = ticks(LOOK);
        let stream_hz = u32::from(self.settings.stream_hz);
        let mut frames = ticks(stream_period(stream_hz));
        loop {
            select! {
                news = news.recv() => match news {
                    Some(News::Connected) => {
                        is_connected = true;
                        say(&format!("connected to the broker at {}", self.place()));
                        told.clear();
                        *pause = BACKOFF[0];
                        publisher.begin(&client);
                    }
                    Some(News::Birth) => publisher.forget(),
                    Some(News::Acknowledged) => {}
                    Some(News::Lost(error)) => return Some(error),
                    None => return Some(ConnectionError::RequestsDone),
                },
                _ = looks.tick(), if is_connected => publisher.publish_changes(shared, &client, Instant::now()),
                _ = frames.tick(), if is_connected && stream_hz > 0 => publisher.stream(shared, &client, Instant::now()),
                _ = stopped.changed() => {
                    if is_connected {
                        self.farewell(&client, &mut news).await;
                    }
                    return None;
                }
            }
        }
    }

    /// Says that the bridge is offline, which the broker would not say after an orderly end. Waits for [`FAREWELL`] at most.
    async fn farewell(&self, client: &AsyncClient, news: &mut mpsc::Receiver<News>) {
        let topic = topics::bridge_availability(&self.namespace);
        let said = async {
            if client.publish(topic, QoS::AtLeastOnce, true, topics::OFFLINE).await.is_ok() {
                while !matches!(news.recv().await, Some(News::Acknowledged | News::Lost(_)) | None) {}
                let _ = client.disconnect().await;
                while !matches!(news.recv().await, Some(News::Lost(_)) | None) {}
            }
        };
        let _ = time::timeout(FAREWELL, said).await;
    }
}

/// The task that drives a connection, which ends with it.
struct Driver(JoinHandle<()>);

impl Drop for Driver {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Drives a connection until it is lost. It is a task of its own, because a poll that is abandoned may lose a message.
async fn drive(mut events: EventLoop, news: mpsc::Sender<News>) {
    loop {
        let told = match events.poll().await {
            Ok(Event::Incoming(Packet::ConnAck(_))) => News::Connected,
            // A retained one is no news: after a connect everything is sent anyway.
            Ok(Event::Incoming(Packet::Publish(message))) if !message.retain && *message.payload == *b"online" => {
                News::Birth
            }
            Ok(Event::Incoming(Packet::PubAck(_))) => News::Acknowledged,
            Ok(_) => continue,
            Err(error) => {
                let _ = news.send(News::Lost(error)).await;
                return;
            }
        };
        if news.send(told).await.is_err() {
            return;
        }
    }
}

fn stream_period(stream_hz: u32) -> Duration {
    Duration::from_secs(1) / stream_hz.max(1)
}

/// Ticks at once and then in each period. A tick that comes late moves all later ones.
fn ticks(period: Duration) -> time::Interval {
    let mut ticks = time::interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// What to do about a lost connection.
fn remedy(error: &ConnectionError) -> &'static str {
    match error {
        ConnectionError::ConnectionRefused(
            ConnectReturnCode::BadUserNamePassword | ConnectReturnCode::NotAuthorized,
        ) => "check the user in --mqtt USER@HOST and the password",
        ConnectionError::Tls(_) => "check the host name and --mqtt-ca",
        _ => "check its address, that it runs, and the firewall",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The clock goes to the next tick whenever nothing else is to be done.
    #[tokio::test(start_paused = true)]
    async fn the_stream_has_the_rate_that_was_asked_for_and_never_catches_up() {
        for stream_hz in [1, 10, 60] {
            let mut frames = ticks(stream_period(stream_hz));
            frames.tick().await;
            let begun = time::Instant::now();
            for _ in 0..stream_hz {
                frames.tick().await;
            }
            let took_s = begun.elapsed().as_secs_f64();
            assert!((took_s - 1.0).abs() < 0.07, "{stream_hz} frames in {took_s} s");
            time::advance(Duration::from_secs(5)).await;
            frames.tick().await;
            let late = time::Instant::now();
            frames.tick().await;
            assert!(late.elapsed() >= stream_period(stream_hz), "{:?}", late.elapsed());
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_broker_that_acknowledges_nothing_delays_the_end_by_a_second() {
        let settings = Mqtt { broker: "127.0.0.1".to_owned(), ..Mqtt::default() };
        let client = Client::new(&settings, "facewire").unwrap();
        // Nobody drives this connection.
        let (connection, _events) = AsyncClient::new(client.options.clone(), QUEUE);
        let (_sender, mut news) = mpsc::channel(16);
        let begun = time::Instant::now();
        client.farewell(&connection, &mut news).await;
        assert_eq!(begun.elapsed().as_secs(), 1);
    }
}
