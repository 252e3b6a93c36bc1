//! Why bytes are refused.

use core::fmt;

use crate::packet::{PACKET_BYTES, VERSION};

/// Why bytes are not a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecodeError {
    /// Not 132 bytes, but this many.
    Length(usize),
    /// The first two bytes are not "FW".
    Magic,
    /// A version other than 1.
    Version(u8),
    /// The checksum does not match: the bytes were damaged on the way.
    Checksum,
    /// A frame that ends before the place where its next 0 should stand.
    Cut,
    /// A reason that version 1 does not define.
    Reason(u8),
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(bytes) => write!(
                f,
                "{bytes} bytes are not a packet of {PACKET_BYTES}: check that only facewire sends to this port"
            ),
            Self::Magic => {
                f.write_str("the bytes do not begin with \"FW\": check that only facewire sends to this port")
            }
            Self::Version(version) => {
                write!(f, "the packet has version {version}, this receiver knows {VERSION}: update the older side")
            }
            Self::Checksum => f.write_str("the checksum does not match: check the cable and the baud rate"),
            Self::Cut => f.write_str("the frame lacks bytes: check the cable and the baud rate"),
            Self::Reason(reason) => write!(
                f,
                "the packet gives reason {reason}, which version {VERSION} does not define: update the receiver"
            ),
        }
    }
}

impl core::error::Error for DecodeError {}
