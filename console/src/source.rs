//! Where packets come from: a UDP port or a serial line, read by a thread of its own.

mod serial;
mod udp;

use std::{
    io,
    net::{SocketAddr, UdpSocket},
    path::PathBuf,
    thread,
    time::Instant,
};

use facewire_packet::{DecodeError, Packet};
use tokio::sync::watch;

use crate::{
    Failure,
    args::Args,
    snapshot::{Sender, Snapshot, Tally},
};

/// A source of packets, before it is read.
#[derive(Debug)]
pub enum Source {
    /// A UDP port.
    Udp {
        /// The bound socket.
        socket: UdpSocket,
        /// Its address, or the multicast group.
        address: SocketAddr,
    },
    /// A serial port, which need not exist yet.
    Serial {
        /// The path of the device.
        device: PathBuf,
        /// The baud rate.
        baud: u32,
    },
}

impl Source {
    /// Binds the UDP port. A serial port is opened later, whenever it is plugged in.
    pub fn open(args: &Args) -> Result<Self, Failure> {
        if let Some(device) = args.serial.clone() {
            return Ok(Self::Serial { device, baud: args.baud });
        }
        let (socket, address) = udp::bind(args.udp, args.interface.as_deref())?;
        Ok(Self::Udp { socket, address })
    }

    /// Starts to read.
    pub fn start(self, publish: watch::Sender<Snapshot>) -> io::Result<()> {
        let counter = PacketCounter::new(publish);
        thread::Builder::new().name("source".to_owned()).spawn(|| match self {
            Self::Udp { socket, .. } => udp::read(&socket, counter),
            Self::Serial { device, baud } => serial::read(&device, baud, counter),
        })?;
        Ok(())
    }
}

/// Counts what arrives and publishes it.
#[derive(Debug)]
pub struct PacketCounter {
    tally: Tally,
    publish: watch::Sender<Snapshot>,
}

impl PacketCounter {
    pub fn new(publish: watch::Sender<Snapshot>) -> Self {
        Self { tally: Tally::default(), publish }
    }

    /// Takes a packet, or what was wrong with it.
    pub fn take(&mut self, received: Result<Packet, DecodeError>, from: Sender) {
        let now = Instant::now();
        match received {
            Ok(packet) => self.tally.count(&packet, from, now),
            Err(fault) => self.tally.refuse(fault),
        }
        self.publish.send_replace(Snapshot::of(&self.tally, now));
    }

    /// Publishes why nothing can arrive, or that the trouble is over.
    pub fn tell(&self, trouble: Option<&str>) {
        let now = Instant::now();
        self.publish.send_replace(Snapshot::of(&self.tally, now).with_trouble(trouble));
    }
}
