//! `facewire-console`: shows the packets of facewire live in a browser, and operates a service.
//!
//! Role: a page for two uses. With `--config` it is the console of the service on this machine ([`console`]), with which it
//! speaks by the control socket alone ([`control`]), and whose settings file it edits ([`settings`]). Otherwise a thread
//! receives packets by UDP or from a serial port ([`source`]) and keeps the newest in a [`Snapshot`]. One more thread
//! serves the page ([`web`]), and the main thread answers what needs time ([`api`]).
//! Contract: whatever arrives on the port or from a browser, memory and the number of connections stay bounded, and a
//! browser that reads slowly misses snapshots and delays nobody. Who may change what, [`access`] decides.

mod access;
mod addresses;
mod api;
mod args;
mod console;
mod control;
mod files;
mod hint;
mod picture;
mod program;
mod recordings;
mod report;
mod servos;
mod settings;
mod snapshot;
mod source;
mod status;
mod vrchat;
mod web;

use std::{
    io::{self, IsTerminal as _, Write as _},
    net::SocketAddr,
    path::Path,
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use clap::Parser as _;
use tokio::{
    runtime::{self, Runtime},
    select,
    signal::unix::{SignalKind, signal},
    sync::watch,
};

use self::{
    args::Args,
    console::Console,
    hint::Hint,
    snapshot::Snapshot,
    source::{PacketCounter, Source},
    web::{Site, Token},
};

const EX_FAILED: u8 = 1;
const EX_IOERR: u8 = 74;
/// How long a file that is being written may take after the signal to end.
const END_PATIENCE: Duration = Duration::from_secs(1);

/// Why the program fails.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// The UDP port is in use, or the address does not belong to this machine.
    #[error("cannot receive packets at {address} ({error}); end what uses the port, or give --udp another address")]
    Receive { address: SocketAddr, error: io::Error },
    /// The interface of `--interface` does not exist.
    #[error("there is no network interface {0}; `ip link` lists them")]
    Interface(String),
    /// The port of the page is in use, or the address does not belong to this machine.
    #[error("cannot serve the page at {address} ({error}); end what uses the port, or give --listen another address")]
    Serve { address: SocketAddr, error: io::Error },
    /// The system has no random numbers, or refuses a thread or a signal.
    #[error("the system refuses {what} ({error}); try again when it has resources to spare")]
    System { what: &'static str, error: io::Error },
    /// The folder of the state cannot be made, or holds what this program has not written.
    #[error("cannot use the folder of passwords and recordings ({error}); give --state another folder")]
    State { error: io::Error },
    /// Standard output cannot be written to.
    #[error("cannot write the output ({0}); check where it goes")]
    Output(io::Error),
}

impl Failure {
    fn status(&self) -> u8 {
        match self {
            Self::Output(_) => EX_IOERR,
            _ => EX_FAILED,
        }
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // Standard error may be closed.
            let _ = writeln!(io::stderr(), "facewire-console: {failure}");
            ExitCode::from(failure.status())
        }
    }
}

fn run(args: &Args) -> Result<(), Failure> {
    let refused = |what| move |error| Failure::System { what, error };
    let runtime = runtime::Builder::new_current_thread().enable_all().build().map_err(refused("to start"))?;
    let done = runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt()).map_err(refused("a signal handler"))?;
        let mut terminate = signal(SignalKind::terminate()).map_err(refused("a signal handler"))?;
        let source = if args.config.is_none() { Some(Source::open(args)?) } else { None };
        let listener = web::listen(args.listen)?;
        let address = listener.local_addr().map_err(|error| Failure::Serve { address: args.listen, error })?;
        let token = if address.ip().is_loopback() { None } else { Some(Token::random().map_err(refused("a token"))?) };
        let (publish, snapshots) = watch::channel(Snapshot::default());
        let site = match (source, &args.config) {
            (Some(source), _) => {
                let hint = Hint::of(&source);
                let urls =
                    addresses::urls(address, &token.as_ref().map_or_else(String::new, |token| format!("{token}/")));
                announce(&urls, token.is_some(), &format!("Waiting for packets at {}. Ctrl-C ends.", hint.place))?;
                source.start(publish).map_err(refused("a thread"))?;
                Site::of_packets(token, &hint, snapshots)
            }
            (None, config) => {
                let config = config.as_deref().unwrap_or(Path::new(""));
                let token = token.map_or_else(Token::random, Ok).map_err(refused("a token"))?;
                // The log of a unit is read by others than the owner of the terminal.
                let is_terminal = io::stdout().is_terminal() && !address.ip().is_loopback();
                let path = if is_terminal { format!("#token={token}") } else { String::new() };
                let console = Console::new(args, config, token).map_err(|error| Failure::State { error })?;
                let urls = addresses::urls(address, &path);
                announce(&urls, is_terminal, &format!("Operating the service of {}. Ctrl-C ends.", config.display()))?;
                let console = Arc::new(console);
                let [status, face, vrchat] = [(); 3].map(|()| Arc::clone(&console));
                tokio::spawn(async move { status.watch_status().await });
                tokio::spawn(async move { face.watch_face(PacketCounter::new(publish)).await });
                tokio::spawn(async move { vrchat.watch_vrchat().await });
                Site::of_service(console, snapshots)
            }
        };
        select! {
            _ = web::serve(listener, site).map_err(refused("a thread"))? => {}
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        Ok(())
    });
    end(runtime);
    done
}

/// Ends what still runs, when files that are being written are complete. Nobody waits for a resolver that does not answer.
fn end(runtime: Runtime) {
    runtime.shutdown_timeout(END_PATIENCE);
}

/// Prints the addresses to open, and what the program does.
fn announce(urls: &[String], is_for_phones: bool, what: &str) -> Result<(), Failure> {
    let mut lines = Vec::new();
    if let (Some(url), true) = (urls.first(), is_for_phones && io::stdout().is_terminal()) {
        lines.push(qr_code(url));
    }
    lines.extend(urls.iter().map(|url| format!("Open {url} in a browser.")));
    lines.push(what.to_owned());
    let text = lines.join("\n") + "\n";
    match io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Output(error)),
        _ => Ok(()),
    }
}

/// Draws the address for the camera of a phone: black on white, whatever the colours of the terminal are.
fn qr_code(url: &str) -> String {
    let Ok(code) = qrcode::QrCode::with_error_correction_level(url, qrcode::EcLevel::L) else {
        return String::new();
    };
    let picture = code.render::<qrcode::render::unicode::Dense1x2>().quiet_zone(true).build();
    let lines: Vec<String> = picture.lines().map(|line| format!("\x1b[30;107m{line}\x1b[0m")).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use std::{
        sync::{
            atomic::{AtomicBool, Ordering::SeqCst},
            mpsc,
        },
        thread,
    };

    use super::*;

    #[test]
    fn the_end_waits_for_a_file_that_is_being_written_and_not_for_a_resolver_that_hangs() {
        let runtime = runtime::Builder::new_current_thread().build().unwrap();
        let (started, starts) = mpsc::channel();
        let has_written = Arc::new(AtomicBool::new(false));
        let (written, begun) = (Arc::clone(&has_written), started.clone());
        let (ending, is_ending) = mpsc::channel();
        runtime.spawn_blocking(move || {
            begun.send(()).unwrap();
            is_ending.recv().unwrap();
            (0..20).for_each(|_| thread::yield_now());
            written.store(true, SeqCst);
        });
        let (_hold, held) = mpsc::channel::<()>();
        runtime.spawn_blocking(move || {
            started.send(()).unwrap();
            held.recv()
        });
        assert_eq!(starts.iter().take(2).count(), 2);
        let (ended, ends) = mpsc::channel();
        thread::spawn(move || {
            ending.send(()).unwrap();
            end(runtime);
            ended.send(()).unwrap();
        });
        assert_eq!(ends.recv_timeout(Duration::from_secs(20)), Ok(()), "the end waits for the resolver");
        assert!(has_written.load(SeqCst));
    }
}
