//! Servos: what a channel of a servo board does while a face moves.
//!
//! Role: a [`Channel`] turns the face into the position of one servo, from 0 to 1, and the position into a pulse width.
//! Contract: whatever comes in, a position stays within 0 to 1, and a [`Motion`] keeps its limits of speed and
//! acceleration. A value that is not a number leaves the servo where it is. Nothing here allocates or reads a clock: the
//! time since the last step is an argument.
//! Limits: nobody knows where a servo stands when it gets its first pulse. It then moves to its neutral position as
//! fast as it can.

mod channel;
mod motion;
mod sources;

pub use channel::{AtLoss, Channel, Ends, Mapping, Step};
pub use motion::{LONGEST_STEP_S, Limits, Motion};
pub use sources::{Gains, SOURCE_COUNT, SOURCE_NAMES, values};
