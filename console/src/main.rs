//! `facewire-console`: shows the packets of facewire live in a browser.
//!
//! Role: a receiver with a page. A thread of its own receives packets by UDP or from a serial port ([`source`]) and
//! keeps the newest in a [`Snapshot`]; the main thread serves the page, and sends each open page the newest snapshot
//! ([`web`]).
//! Contract: it only listens. Whatever arrives on the port or from a browser, memory and the number of connections stay
//! bounded, and a browser that reads slowly misses snapshots and delays nobody.
//! Limits: one source at a time. What a page records stays in the browser.

mod addresses;
mod args;
mod hint;
mod snapshot;
mod source;
mod web;

use std::{
    io::{self, IsTerminal as _, Write as _},
    net::SocketAddr,
    process::ExitCode,
    sync::Arc,
};

use clap::Parser as _;
use tokio::{
    runtime, select,
    signal::unix::{SignalKind, signal},
    sync::watch,
};

use self::{
    args::Args,
    hint::Hint,
    snapshot::Snapshot,
    source::Source,
    web::{Site, Token},
};

const EX_FAILED: u8 = 1;
const EX_IOERR: u8 = 74;

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
    runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt()).map_err(refused("a signal handler"))?;
        let mut terminate = signal(SignalKind::terminate()).map_err(refused("a signal handler"))?;
        let source = Source::open(args)?;
        let hint = Hint::of(&source);
        let listener = web::listen(args.listen)?;
        let address = listener.local_addr().map_err(|error| Failure::Serve { address: args.listen, error })?;
        let token = if address.ip().is_loopback() { None } else { Some(Token::random().map_err(refused("a token"))?) };
        announce(address, token.as_ref(), &hint)?;
        let (publish, snapshots) = watch::channel(Snapshot::default());
        source.start(publish).map_err(refused("a thread"))?;
        let site = Arc::new(Site::new(token, &hint, snapshots));
        select! {
            () = web::serve(listener, site) => {}
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        Ok(())
    })
}

/// Prints the addresses to open, and where packets are expected.
fn announce(address: SocketAddr, token: Option<&Token>, hint: &Hint) -> Result<(), Failure> {
    let urls = addresses::urls(address, token);
    let mut lines = Vec::new();
    if let (Some(url), true) = (urls.first(), token.is_some() && io::stdout().is_terminal()) {
        lines.push(qr_code(url));
    }
    lines.extend(urls.iter().map(|url| format!("Open {url} in a browser.")));
    lines.push(format!("Waiting for packets at {}. Ctrl-C ends.", hint.place));
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
