//! Receiving packets from a UDP port or a serial line.

use std::io::{self, BufRead as _, BufReader, ErrorKind};
use std::net::UdpSocket;
use std::path::PathBuf;
use std::time::Duration;

use facewire_packet::{DecodeError, FrameReader, PACKET_BYTES, Packet};
use serialport::{SerialPort as _, TTYPort};

use super::MonitorArgs;
use facewire::cli::Failure;
use facewire::link::{LinkError, lost, open_port};

/// A packet with the name of its sender, or a fault of it; `None` if nothing came.
type Received = Option<Result<(Packet, String), DecodeError>>;

/// A socket or a port to listen on.
pub enum Receiver {
    Udp(UdpSocket),
    Serial(Box<Line>),
}

impl Receiver {
    pub fn open(args: &MonitorArgs) -> Result<Self, Failure> {
        let Some(device) = args.serial.clone() else {
            let remedy = "end what uses the port, or give --listen another address";
            let refused = |error| Failure::failed(format!("cannot listen to {} ({error}); {remedy}", args.listen));
            return UdpSocket::bind(args.listen).map(Self::Udp).map_err(refused);
        };
        let port = BufReader::new(open_port(&device, args.baud, Duration::ZERO).map_err(unheard)?);
        Ok(Self::Serial(Box::new(Line { device, port, frames: FrameReader::default(), is_synchronised: false })))
    }

    /// Waits for the next packet for `wait` at most.
    pub fn next(&mut self, wait: Duration) -> Result<Received, Failure> {
        let wait = wait.max(Duration::from_millis(1));
        let socket = match self {
            Self::Serial(line) => return line.next(wait),
            Self::Udp(socket) => socket,
        };
        // One byte more than a packet, so that longer datagrams are refused.
        let mut bytes = [0; PACKET_BYTES + 1];
        match socket.set_read_timeout(Some(wait)).and_then(|()| socket.recv_from(&mut bytes)) {
            Ok((length, from)) => {
                let packet = Packet::decode(bytes.get(..length).unwrap_or_default());
                Ok(Some(packet.map(|packet| (packet, from.to_string()))))
            }
            Err(error) if is_timeout(&error) => Ok(None),
            Err(error) => Err(Failure::failed(format!("cannot receive packets: {error}"))),
        }
    }
}

fn unheard(error: LinkError) -> Failure {
    Failure::unavailable(format!("cannot listen to {}", error.message))
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
    fn next(&mut self, wait: Duration) -> Result<Received, Failure> {
        let lost = |error: io::Error| unheard(lost(&self.device, error));
        self.port.get_mut().set_timeout(wait).map_err(|error| lost(error.into()))?;
        let bytes = match self.port.fill_buf() {
            Ok([]) => return Err(lost(ErrorKind::UnexpectedEof.into())),
            Ok(bytes) => bytes,
            Err(error) if is_timeout(&error) => return Ok(None),
            Err(error) => return Err(lost(error)),
        };
        let ended = (1..).zip(bytes).find_map(|(used, byte)| Some((used, self.frames.push(*byte)?)));
        let used = ended.as_ref().map_or(bytes.len(), |(used, _)| *used);
        self.port.consume(used);
        let Some((_, frame)) = ended else { return Ok(None) };
        let was_synchronised = std::mem::replace(&mut self.is_synchronised, true);
        Ok((was_synchronised || frame.is_ok()).then(|| frame.map(|packet| (packet, self.device.display().to_string()))))
    }
}
