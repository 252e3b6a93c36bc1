//! Receiving packets from a UDP port or a serial line.

use std::{
    fmt,
    io::{self, BufRead as _, BufReader, ErrorKind},
    net::{SocketAddr, UdpSocket},
    path::{Path, PathBuf},
    time::Duration,
};

use facewire_packet::{DecodeError, FrameReader, PACKET_BYTES, Packet};
use serialport::{SerialPort as _, TTYPort};

use super::{MonitorArgs, MonitorError};
use facewire::link::{lost, open_port};

/// The source or the destination of packets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Endpoint {
    /// Address and port.
    Udp(SocketAddr),
    /// A serial port.
    Serial(PathBuf),
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp(address) => address.fmt(f),
            Self::Serial(device) => device.display().fmt(f),
        }
    }
}

impl MonitorArgs {
    /// Where the monitor listens.
    pub fn endpoint(&self) -> Endpoint {
        self.serial.clone().map_or(Endpoint::Udp(self.listen), Endpoint::Serial)
    }
}

/// A packet with its sender, or a fault of it; `None` if nothing came.
type Received = Option<Result<(Packet, Endpoint), DecodeError>>;

/// A socket or a port to listen on.
pub enum Receiver {
    Udp(UdpSocket),
    Serial(Box<Line>),
}

impl Receiver {
    /// Starts to listen.
    pub fn open(args: &MonitorArgs) -> Result<Self, MonitorError> {
        let Some(device) = &args.serial else {
            let cannot_listen = |error| MonitorError::Listen { listen: args.listen, error };
            return UdpSocket::bind(args.listen).map(Self::Udp).map_err(cannot_listen);
        };
        let port = open_port(device, args.baud, Duration::ZERO)?;
        Ok(Self::Serial(Box::new(Line::new(device, port))))
    }

    /// Waits for the next packet for `wait` at most.
    pub fn next(&mut self, wait: Duration) -> Result<Received, MonitorError> {
        let wait = wait.max(Duration::from_millis(1));
        match self {
            Self::Udp(socket) => Ok(datagram(socket, wait)?),
            Self::Serial(line) => line.next(wait),
        }
    }
}

fn datagram(socket: &UdpSocket, wait: Duration) -> io::Result<Received> {
    // One byte more than a packet, so that longer datagrams are refused.
    let mut bytes = [0; PACKET_BYTES + 1];
    socket.set_read_timeout(Some(wait))?;
    match socket.recv_from(&mut bytes) {
        Ok((length, from)) => {
            let packet = Packet::decode(bytes.get(..length).unwrap_or_default());
            Ok(Some(packet.map(|packet| (packet, Endpoint::Udp(from)))))
        }
        Err(error) if is_timeout(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Whether the error only means that nothing came in time.
fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// A serial line.
pub struct Line {
    device: PathBuf,
    port: BufReader<TTYPort>,
    frames: FrameReader,
    /// Whether the end of a frame has been seen. The first frame is usually incomplete, which is not a fault.
    is_synchronised: bool,
}

impl Line {
    fn new(device: &Path, port: TTYPort) -> Self {
        let frames = FrameReader::default();
        Self { device: device.to_owned(), port: BufReader::new(port), frames, is_synchronised: false }
    }

    fn next(&mut self, wait: Duration) -> Result<Received, MonitorError> {
        let lost = |error: io::Error| lost(&self.device, error);
        self.port.get_mut().set_timeout(wait).map_err(|error| lost(error.into()))?;
        let bytes = match self.port.fill_buf() {
            Ok([]) => return Err(lost(ErrorKind::UnexpectedEof.into()).into()),
            Ok(bytes) => bytes,
            Err(error) if is_timeout(&error) => return Ok(None),
            Err(error) => return Err(lost(error).into()),
        };
        let mut ended = None;
        let mut used = 0;
        for byte in bytes {
            used += 1;
            ended = self.frames.push(*byte);
            if ended.is_some() {
                break;
            }
        }
        self.port.consume(used);
        Ok(self.received(ended))
    }

    /// Turns the end of a frame into what was received.
    fn received(&mut self, ended: Option<Result<Packet, DecodeError>>) -> Received {
        let is_incomplete = !self.is_synchronised && ended.as_ref().is_some_and(Result::is_err);
        self.is_synchronised |= ended.is_some();
        let from = || Endpoint::Serial(self.device.clone());
        ended.filter(|_| !is_incomplete).map(|result| result.map(|packet| (packet, from())))
    }
}
