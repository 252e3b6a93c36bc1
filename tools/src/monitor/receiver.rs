//! Receiving packets from a UDP port or a serial line.

use std::io::{self, BufRead as _, BufReader, ErrorKind};
use std::net::UdpSocket;
use std::path::PathBuf;
use std::time::Duration;

use facewire_packet::{DecodeError, FrameReader, PACKET_BYTES, Packet};
use serialport::SerialPort as _;

use super::MonitorArgs;
use facewire::cli::Failure;
use facewire::link::{LinkError, lost, open_port};

/// A packet with the name of its sender, or a fault of it; `None` if nothing came.
type Received = Option<Result<(Packet, String), DecodeError>>;

/// Waits for the next packet for this time at most.
pub type Receive = Box<dyn FnMut(Duration) -> Result<Received, Failure>>;

pub fn open(args: &MonitorArgs) -> Result<Receive, Failure> {
    if let Some(device) = args.serial.clone() {
        return read_line(device, args.baud);
    }
    let remedy = "end what uses the port, or give --listen another address";
    let refused = |error| Failure::failed(format!("cannot listen to {} ({error}); {remedy}", args.listen));
    let socket = UdpSocket::bind(args.listen).map_err(refused)?;
    Ok(Box::new(move |wait| {
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
    }))
}

fn read_line(device: PathBuf, baud: u32) -> Result<Receive, Failure> {
    let unheard = |error: LinkError| Failure::unavailable(format!("cannot listen to {}", error.message));
    let mut port = BufReader::new(open_port(&device, baud, Duration::ZERO).map_err(unheard)?);
    let mut frames = FrameReader::default();
    // The first frame is usually incomplete, which is not a fault.
    let mut is_first = true;
    Ok(Box::new(move |wait| {
        let lost = |error| unheard(lost(&device, error));
        port.get_mut().set_timeout(wait).map_err(|error| lost(error.into()))?;
        let bytes = match port.fill_buf() {
            Ok([]) => return Err(lost(ErrorKind::UnexpectedEof.into())),
            Ok(bytes) => bytes,
            Err(error) if is_timeout(&error) => return Ok(None),
            Err(error) => return Err(lost(error)),
        };
        let ended = (1..).zip(bytes).find_map(|(used, byte)| Some((used, frames.push(*byte)?)));
        let used = ended.as_ref().map_or(bytes.len(), |(used, _)| *used);
        port.consume(used);
        let Some((_, frame)) = ended else { return Ok(None) };
        let was_first = std::mem::take(&mut is_first);
        Ok((!was_first || frame.is_ok()).then(|| frame.map(|packet| (packet, device.display().to_string()))))
    }))
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
