//! `facewire-bridge`: publishes the faces of any number of boards by MQTT and to ROS 2.
//!
//! Role: a thread receives packets ([`receive`]) into the [`fleet`], which holds the newest face of each board. The main
//! thread publishes them by MQTT ([`mqtt`]), and another one to ROS 2 ([`ros`]).
//! Contract: nothing is queued without bound. Whatever an output cannot take is replaced by newer state, and counted. A broker
//! or network that is away is waited for.

mod args;
mod fleet;
mod mqtt;
mod receive;
mod ros;
mod settings;
mod trigger;

use std::{
    io::{self, Write as _},
    net::SocketAddr,
    process::ExitCode,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use clap::Parser as _;
use tokio::{
    runtime, select,
    signal::unix::{SignalKind, signal},
    sync::watch,
};

use self::{
    args::Args,
    fleet::{Fleet, Shared},
    settings::{Fault, Settings},
};

const EX_FAILED: u8 = 1;
const EX_CONFIG: u8 = 78;

/// Why the program fails.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// The settings are at fault.
    #[error(transparent)]
    Settings(#[from] Fault),
    /// The UDP port is in use.
    #[error("cannot receive packets at {address} ({error}); end what uses the port, or give --udp another address")]
    Receive { address: SocketAddr, error: io::Error },
    /// The system refuses a thread or a signal.
    #[error("the system refuses {what} ({error}); try again when it has resources to spare")]
    System { what: &'static str, error: io::Error },
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            say(&failure.to_string());
            ExitCode::from(if matches!(failure, Failure::Settings(_)) { EX_CONFIG } else { EX_FAILED })
        }
    }
}

/// Tells the user. Standard error may be closed.
fn say(text: &str) {
    let _ = writeln!(io::stderr(), "facewire-bridge: {text}");
}

fn run(args: &Args) -> Result<(), Failure> {
    let settings = Settings::load(args)?;
    let client = settings.mqtt.as_ref().map(|mqtt| mqtt::Client::new(mqtt, &settings.namespace)).transpose()?;
    let refused = |what| move |error| Failure::System { what, error };
    let runtime = runtime::Builder::new_current_thread().enable_all().build().map_err(refused("an event loop"))?;
    runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt()).map_err(refused("a signal handler"))?;
        let mut terminate = signal(SignalKind::terminate()).map_err(refused("a signal handler"))?;
        let (shared, rings) = Shared::new(Fleet::new(&settings, Instant::now()));
        let shared = Arc::new(shared);
        receive::start(&settings, Arc::clone(&shared))?;
        let graph = settings.ros.as_ref().map(|ros| ros::start(ros, &settings.namespace, Arc::clone(&shared), rings));
        let graph = graph.transpose().map_err(refused("a thread"))?;
        let (stop, stopped) = watch::channel(false);
        let publishes = client.map(|client| tokio::spawn(client.run(Arc::clone(&shared), stopped)));
        select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        stop.send_replace(true);
        shared.is_stopped.store(true, Ordering::Relaxed);
        // Each output limits the time of its own farewell.
        if let Some(publishes) = publishes {
            let _ = publishes.await;
        }
        graph.iter().for_each(ros::finish);
        Ok(())
    })
}
