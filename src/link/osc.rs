//! Open Sound Control: messages in bundles that one Ethernet frame carries.
//!
//! The crate `rosc` encodes the messages. Its encoder only appends to the buffer, which has room for a bundle and one
//! message more from the start, so that nothing allocates.

use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType, encoder::encode_into};

/// Longest bundle, bytes: less than every network carries undivided, tunnels included. An Ethernet frame carries 1472, and
/// some receivers' buffers hold 1536.
pub const LONGEST: usize = 1200;
/// Size of the length before a message.
const LENGTH_BYTES: usize = 4;
/// Room for a message beyond the bundle that it does not fit into.
const LONGEST_MESSAGE: usize = 512;
/// The time tag that means "at once".
const AT_ONCE: OscTime = OscTime { seconds: 0, fractional: 1 };

/// Puts messages into bundles.
#[derive(Debug)]
pub struct Bundles {
    /// A bundle without messages; `None` if messages travel alone.
    head: Option<OscPacket>,
    bytes: Vec<u8>,
}

impl Bundles {
    pub fn new() -> Self {
        let head = OscPacket::Bundle(OscBundle { timetag: AT_ONCE, content: Vec::new() });
        Self { head: Some(head), bytes: Vec::with_capacity(LONGEST + LONGEST_MESSAGE) }
    }

    /// Each message in a datagram of its own.
    pub fn apart() -> Self {
        Self { head: None, ..Self::new() }
    }

    /// Adds a message. Sends the bundle so far if the message does not fit into it.
    pub fn add(&mut self, message: &OscPacket, send: &mut dyn FnMut(&[u8])) {
        if self.head.is_none() {
            let Ok(_) = encode_into(message, &mut self.bytes);
            self.flush(send);
        } else if !self.append(message) {
            self.flush(send);
            self.append(message);
        }
    }

    /// Sends the bundle if it contains a message, and begins a new one.
    pub fn flush(&mut self, send: &mut dyn FnMut(&[u8])) {
        if !self.bytes.is_empty() {
            send(&self.bytes);
            self.bytes.clear();
        }
    }

    /// Appends a message. Returns false if a bundle that is not empty would become too long; it is then as before.
    fn append(&mut self, message: &OscPacket) -> bool {
        let before = self.bytes.len();
        if let Some(head) = self.head.as_ref().filter(|_| before == 0) {
            let Ok(_) = encode_into(head, &mut self.bytes);
        }
        let start = self.bytes.len() + LENGTH_BYTES;
        self.bytes.resize(start, 0);
        let Ok(length) = encode_into(message, &mut self.bytes);
        if before > 0 && self.bytes.len() > LONGEST {
            self.bytes.truncate(before);
            return false;
        }
        let length = u32::try_from(length).unwrap_or(u32::MAX).to_be_bytes();
        if let Some(field) = self.bytes.get_mut(start - LENGTH_BYTES..start) {
            field.copy_from_slice(&length);
        }
        true
    }
}

/// Returns a message.
pub fn message(addr: impl Into<String>, args: Vec<OscType>) -> OscPacket {
    OscPacket::Message(OscMessage { addr: addr.into(), args })
}

/// Replaces the last arguments of a message by these numbers.
pub fn set(packet: &mut OscPacket, numbers: &[f32]) {
    let OscPacket::Message(message) = packet else { return };
    for (argument, number) in message.args.iter_mut().rev().zip(numbers.iter().rev()) {
        *argument = OscType::Float(*number);
    }
}

/// Replaces the only argument of a message by a truth value.
pub fn set_bool(packet: &mut OscPacket, value: bool) {
    let OscPacket::Message(message) = packet else { return };
    if let [argument] = message.args.as_mut_slice() {
        *argument = OscType::Bool(value);
    }
}

/// What receivers make of bundles, for tests.
#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
pub mod received {
    use super::{LONGEST, OscMessage, OscPacket};

    /// Decodes bundles and returns their messages in order. No bundle may be too long.
    pub fn messages(datagrams: &[Vec<u8>]) -> Vec<OscMessage> {
        let decoded = datagrams.iter().map(|bytes| {
            assert!(bytes.len() <= LONGEST, "{}", bytes.len());
            rosc::decoder::decode_udp(bytes).unwrap()
        });
        let message = |packet| match packet {
            OscPacket::Message(message) => message,
            OscPacket::Bundle(_) => panic!("a bundle within a bundle"),
        };
        let content = decoded.flat_map(|(rest, packet)| match packet {
            OscPacket::Bundle(bundle) if rest.is_empty() => bundle.content,
            other => panic!("no bundle: {other:?}"),
        });
        content.map(message).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundled(messages: &[OscPacket]) -> Vec<Vec<u8>> {
        let (mut bundles, mut datagrams) = (Bundles::new(), Vec::new());
        let mut send = |bytes: &[u8]| datagrams.push(bytes.to_vec());
        for message in messages {
            bundles.add(message, &mut send);
        }
        bundles.flush(&mut send);
        bundles.flush(&mut send);
        datagrams
    }

    #[test]
    fn a_bundle_is_what_the_library_makes_of_the_same_messages() {
        let messages = [message("/a", vec![OscType::Float(0.5)]), message("/bcd", vec![OscType::Bool(true)])];
        let bundle = OscPacket::Bundle(OscBundle { timetag: AT_ONCE, content: messages.to_vec() });
        assert_eq!(bundled(&messages), [rosc::encoder::encode(&bundle).unwrap_or_default()]);
    }

    #[test]
    fn many_messages_are_divided_in_order_and_none_is_lost() {
        let messages: Vec<_> = (0..200).map(|n| message(format!("/n/{n}"), vec![OscType::Int(n)])).collect();
        let sent = bundled(&messages);
        assert!(sent.len() > 1);
        assert_eq!(received::messages(&sent).into_iter().map(OscPacket::Message).collect::<Vec<_>>(), messages);
    }

    #[test]
    fn a_message_longer_than_a_bundle_travels_alone() {
        let long = message("/long", vec![OscType::Blob(vec![1; LONGEST])]);
        let sent = bundled(&[message("/a", vec![]), long, message("/b", vec![])]);
        assert_eq!(sent.iter().map(|bytes| bytes.len() > LONGEST).collect::<Vec<_>>(), [false, true, false]);
    }
}
