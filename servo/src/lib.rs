//! Servos: what the channels of a servo board do while a face moves, and the commands of boards.
//!
//! Role: a [`Channel`] turns the face into the position of one servo, from 0 to 1, and the position into a place: a pulse
//! width in microseconds, or for a bus servo its position in steps. A [`Board`] has several channels, and an [`Operator`]
//! may take all pulses away, or jog single channels in place of the face. [`maestro`], [`pca9685`], [`bus`] and [`dmx`]
//! know what boards are told, and [`check`] what they cannot follow; the caller carries the bytes.
//! Contract: whatever comes in, a position stays within 0 to 1, and a motion keeps its limits of speed and
//! acceleration. A value that is not a number leaves the servo where it is. A step of a board neither allocates nor reads a
//! clock: its time is an argument.
//! Limits: nobody knows where a servo stands that gets no pulses. Its first pulse is that of where it was left, or of its
//! neutral position, and moves it there as fast as it can.

mod board;
pub mod bus;
mod channel;
pub mod check;
pub mod dmx;
pub mod finder;
pub mod maestro;
mod motion;
pub mod pca9685;

pub use self::board::{Board, Dial, Dials, Number, Operator};
pub use self::channel::{AtLoss, Channel, ChannelSettings, SOURCE_COUNT, SOURCE_NAMES, Sources};
pub use self::motion::Limits;
