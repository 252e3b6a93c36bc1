//! Packets on a serial line, whose port may come and go.

use std::{
    io::{self, ErrorKind, Read as _},
    path::Path,
    thread,
    time::Duration,
};

use facewire_packet::FrameReader;
use serialport::TTYPort;

use super::PacketCounter;
use crate::snapshot::Sender;

/// Time between two attempts to open the port.
const RETRY: Duration = Duration::from_millis(500);
/// How long a read waits. Silence is no error.
const PATIENCE: Duration = Duration::from_secs(1);

/// Opens the port whenever it is plugged in, and reads it until it goes away.
pub fn read(device: &Path, baud: u32, mut counter: PacketCounter) {
    loop {
        let trouble = match serialport::new(device.to_string_lossy(), baud).timeout(PATIENCE).open_native() {
            Ok(port) => {
                counter.tell(None);
                let error = drain(port, &mut counter);
                format!("{} went away ({error}); check its cable, and plug it in again", device.display())
            }
            Err(error) => format!("{}: {}", device.display(), remedy(&error)),
        };
        counter.tell(Some(&trouble));
        thread::sleep(RETRY);
    }
}

/// Reads until the port fails.
fn drain(mut port: TTYPort, counter: &mut PacketCounter) -> io::Error {
    let (mut frames, mut bytes) = (FrameReader::default(), [0; 512]);
    // The first frame is usually incomplete, which is not a fault.
    let mut is_synchronised = false;
    loop {
        let length = match port.read(&mut bytes) {
            Ok(0) => return ErrorKind::UnexpectedEof.into(),
            Ok(length) => length,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => continue,
            Err(error) => return error,
        };
        for received in bytes.iter().take(length).filter_map(|byte| frames.push(*byte)) {
            if received.is_ok() || is_synchronised {
                counter.take(received, Sender::Line);
            }
            is_synchronised = true;
        }
    }
}

/// Says why the port does not open, and what to do. `serialport` reports the lock of another program as `NoDevice`.
fn remedy(error: &serialport::Error) -> String {
    match error.kind {
        serialport::ErrorKind::Io(ErrorKind::NotFound) => {
            "there is no such serial port; plug it in, or give --serial another".to_owned()
        }
        serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
            "this user may not open it; add the user to the group dialout and log in again".to_owned()
        }
        serialport::ErrorKind::NoDevice => {
            "another program has it open; end that program, or give --serial another".to_owned()
        }
        _ => format!("cannot be opened ({}); check its cable, and plug it in again", error.description),
    }
}
