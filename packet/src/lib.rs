//! The facewire packet, version 1: 52 blendshape coefficients and a head pose in 132 bytes.
//!
//! Role: the single definition of the wire format, for the sender and for receivers, microcontrollers included.
//! Contract: [`Packet::encode`] and [`Packet::decode`] neither panic nor allocate. A decoded packet had the right
//! length, magic number, version and checksum.
//! A UDP datagram holds exactly one packet. On a serial line, [`Packet::encode_frame`] and [`FrameReader`] mark where
//! packets begin and end. [`Receiver`] decides what to show. With the feature `std`, `Tally` counts
//! packets, losses and rates. With the feature `formats`, there is what other programs read in place of packets, and
//! with `control`, what goes over the control socket of a service.
//! Limits: packets are not resent; the next packet replaces a lost one.
//!
//! ```
//! use facewire_packet::{Packet, State};
//!
//! let mut packet = Packet { state: State::Live, sequence: 7, ..Packet::NEUTRAL };
//! packet.coefficients[17] = 0.5; // jawOpen
//! let received = Packet::decode(&packet.encode())?;
//! assert!((received.coefficients[17] - 0.5).abs() < 1.0 / 65535.0);
//! # Ok::<(), facewire_packet::DecodeError>(())
//! ```
#![cfg_attr(not(feature = "std"), no_std)]
#![warn(missing_docs, clippy::pedantic)]
#![allow(clippy::cast_precision_loss, reason = "what is converted is below the 2^24 that an f32 holds exactly")]

mod blendshapes;
#[cfg(feature = "control")]
pub mod control;
mod error;
mod field;
#[cfg(feature = "formats")]
pub mod formats;
mod frame;
mod packet;
mod pose;
mod quantise;
mod receiver;
mod state;
#[cfg(feature = "std")]
mod tally;
#[cfg(feature = "udp")]
pub mod udp;
mod visibility;

pub use blendshapes::{BLENDSHAPE_COUNT, BLENDSHAPES};
pub use error::DecodeError;
pub use field::PACKET_BYTES;
pub use frame::{FRAME_BYTES, FrameReader};
pub use packet::{Packet, SILENCE_MS, VERSION};
#[cfg(feature = "std")]
pub use pose::yaw_pitch_roll_deg;
pub use pose::{FULL_GAZE_DEG, Pose};
pub use receiver::{Face, LATE_MS, Receiver, TRAVEL_MS};
pub use state::{NeutralFace, Reason, State};
#[cfg(feature = "std")]
pub use tally::{Newest, Tally};
pub use visibility::Visibility;
