//! Open Sound Control: messages in bundles that one Ethernet frame carries.
//!
//! Messages are encoded when a format is made. From then on only their numbers change, in place, so that nothing
//! allocates.

/// Longest bundle, bytes: less than every network carries undivided, tunnels included. An Ethernet frame carries 1472, and
/// some receivers' buffers hold 1536. No message of facewire is longer.
pub const LONGEST: usize = 1200;
/// What a bundle begins with. The time tag 1 means "at once".
const HEAD: &[u8] = b"#bundle\0\0\0\0\0\0\0\0\x01";

/// The bytes of a message: its address, the types of its arguments, and the arguments.
#[derive(Debug)]
pub struct Message(Vec<u8>);

impl Message {
    /// A message with arguments of these types: an `s` for `text`, which can only come first, an `i` for each number in
    /// `whole`, and an `f` for each number that [`Message::set`] replaces. A truth value, `F`, must be the only argument.
    pub fn new(address: &str, types: &str, text: &str, whole: &[i32]) -> Self {
        let mut message = Self(Vec::new());
        let text = types.starts_with('s').then_some(text);
        [address, &format!(",{types}")].into_iter().chain(text).for_each(|text| message.add_text(text));
        message.0.extend(whole.iter().flat_map(|number| number.to_be_bytes()));
        message.0.resize(message.0.len() + 4 * types.matches('f').count(), 0);
        message
    }

    /// Adds a text, the zero that ends it, and zeros up to a multiple of 4 bytes.
    fn add_text(&mut self, text: &str) {
        self.0.extend_from_slice(text.as_bytes());
        self.0.resize((self.0.len() + 1).next_multiple_of(4), 0);
    }

    /// Replaces the last arguments by these numbers.
    pub fn set(&mut self, numbers: &[f32]) {
        let (words, _) = self.0.as_chunks_mut();
        words.iter_mut().rev().zip(numbers.iter().rev()).for_each(|(word, number)| *word = number.to_be_bytes());
    }

    /// Replaces the truth value, which consists of its type alone.
    pub fn set_bool(&mut self, value: bool) {
        if let Some(word) = self.0.as_chunks_mut().0.last_mut() {
            *word = if value { *b",T\0\0" } else { *b",F\0\0" };
        }
    }
}

#[derive(Debug)]
pub struct Bundles {
    /// Whether messages share datagrams. If not, each message travels in a datagram of its own.
    is_bundled: bool,
    bytes: Vec<u8>,
}

impl Bundles {
    pub fn new(is_bundled: bool) -> Self {
        Self { is_bundled, bytes: Vec::with_capacity(LONGEST) }
    }

    /// Adds a message. Sends the bundle so far if the message does not fit into it.
    pub fn add(&mut self, Message(message): &Message, send: &mut dyn FnMut(&[u8])) {
        if !self.is_bundled {
            return send(message);
        }
        let length = u32::try_from(message.len()).unwrap_or(u32::MAX).to_be_bytes();
        if self.bytes.len() + length.len() + message.len() > LONGEST {
            self.flush(send);
        }
        if self.bytes.is_empty() {
            self.bytes.extend_from_slice(HEAD);
        }
        self.bytes.extend_from_slice(&length);
        self.bytes.extend_from_slice(message);
    }

    /// Sends the bundle if it contains a message, and begins a new one.
    pub fn flush(&mut self, send: &mut dyn FnMut(&[u8])) {
        if !self.bytes.is_empty() {
            send(&self.bytes);
            self.bytes.clear();
        }
    }
}

/// Decodes bundles with a library that is not ours, and returns their messages in order. No bundle may be too long.
#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
pub fn received(datagrams: &[Vec<u8>]) -> Vec<rosc::OscMessage> {
    let content = |bytes: &Vec<u8>| match rosc::decoder::decode_udp(bytes).unwrap() {
        (&[], rosc::OscPacket::Bundle(bundle)) if bytes.len() <= LONGEST => bundle.content,
        _ => panic!("no bundle: {bytes:?}"),
    };
    let messages = datagrams.iter().flat_map(content).map(|packet| match packet {
        rosc::OscPacket::Message(message) => message,
        rosc::OscPacket::Bundle(_) => panic!("a bundle within a bundle"),
    });
    messages.collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests {
    use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType};

    use super::*;

    #[test]
    fn many_messages_are_divided_in_order_as_the_library_encodes_them() {
        let (mut bundles, mut datagrams, mut want) = (Bundles::new(true), Vec::new(), Vec::new());
        let mut send = |bytes: &[u8]| datagrams.push(bytes.to_vec());
        for number in 0_u8..100 {
            let (name, value, is_even) = ("n".repeat(number.into()), f32::from(number) / 8.0, number % 2 == 0);
            let mut numbers = Message::new("/n", "sif", &name, &[-7]);
            numbers.set(&[value]);
            let mut flag = Message::new("/flag", "F", "", &[]);
            flag.set_bool(is_even);
            bundles.add(&numbers, &mut send);
            bundles.add(&flag, &mut send);
            let args = vec![OscType::String(name), OscType::Int(-7), OscType::Float(value)];
            want.push(OscMessage { addr: "/n".to_owned(), args });
            want.push(OscMessage { addr: "/flag".to_owned(), args: vec![OscType::Bool(is_even)] });
        }
        (0..2).for_each(|_| bundles.flush(&mut send));
        assert!(datagrams.len() > 1);
        assert_eq!(received(&datagrams), want);
        let count = received(&datagrams[..1]).len();
        let content = want.into_iter().take(count).map(OscPacket::Message).collect();
        let bundle = OscBundle { timetag: OscTime { seconds: 0, fractional: 1 }, content };
        assert_eq!(datagrams[0], rosc::encoder::encode(&OscPacket::Bundle(bundle)).unwrap());
    }
}
