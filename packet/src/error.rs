//! The errors of decoding.

use core::fmt;

use crate::{PACKET_BYTES, VERSION};

/// The reason why a byte sequence is not a valid packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecodeError {
    /// The packet has this many bytes instead of 132.
    Length(usize),
    /// The first two bytes are not "FW".
    Magic,
    /// The version is not 1, but this number.
    Version(u8),
    /// The checksum does not match, because bytes were damaged in transit.
    Checksum,
    /// The serial frame ends before its last COBS block is complete.
    Cut,
    /// The reason has a number that version 1 does not define.
    Reason(u8),
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(bytes) => write!(
                f,
                "{bytes} bytes instead of the {PACKET_BYTES} of a packet: check that only facewire sends to this port"
            ),
            Self::Magic => {
                f.write_str("the bytes do not begin with \"FW\": check that only facewire sends to this port")
            }
            Self::Version(version) => {
                write!(f, "the packet has version {version}, but this receiver knows {VERSION}: update the older side")
            }
            Self::Checksum => f.write_str("the checksum does not match: check the cable and the baud rate"),
            Self::Cut => f.write_str("the frame is incomplete: check the cable and the baud rate"),
            Self::Reason(reason) => write!(
                f,
                "the packet gives reason {reason}, which version {VERSION} does not define: update the receiver"
            ),
        }
    }
}

impl core::error::Error for DecodeError {}
