//! DMX over a network: the 512 values of a universe, by E1.31 (sACN) or by Art-Net.
//!
//! A datagram always carries all 512 values, because some nodes take no shorter one. Values that change are sent at once.
//! Then they are sent three times more, because a datagram may be lost, and then every 0.8 s, because nodes give up a source
//! that is silent for a second or two. Each universe of a source has its own sequence numbers, and nodes drop datagrams that
//! are out of order.

mod cid;

use std::net::SocketAddr;
use std::time::Duration;

pub use self::cid::cid;

/// Number of values in a universe. Addresses count from 1.
pub const ADDRESSES: usize = 512;
/// The values of a universe in the order of their addresses.
pub type Universe = [u8; ADDRESSES];

/// Most datagrams per second of a universe, which is as many as a DMX line carries.
pub const MOST_HZ: u32 = 44;
/// Usual number of datagrams per second.
pub const USUAL_HZ: u32 = 40;

/// How often values that stay the same are repeated before they are sent less often.
const REPEATS: u8 = 3;
const KEEP_ALIVE: Duration = Duration::from_millis(800);
/// How many datagrams say that an E1.31 stream ends.
const TERMINATIONS: u8 = 3;
const STREAM_TERMINATED: u8 = 0x40;
const SACN_BYTES: usize = 126 + ADDRESSES;
const SOURCE_BYTES: usize = 64;
/// The bytes of a datagram of discovery before its universes, and how many it has at most.
const DISCOVERY_BYTES: usize = 120;
const MOST_UNIVERSES: usize = 512;

/// Where sources of E1.31 say which universes they send.
pub const DISCOVERY_UNIVERSE: u16 = 64_214;
/// How often they say so. Consoles take a source from their list that has been silent for twice as long.
pub const DISCOVERY_PERIOD: Duration = Duration::from_secs(10);

/// Where a protocol has what changes from one datagram to the next.
#[derive(Debug)]
struct Layout {
    sequence: usize,
    /// Art-Net has no options, and no stream that ends.
    options: Option<usize>,
    values: usize,
}

/// Returns the multicast group of a universe by E1.31, which all nodes of the network can hear.
#[must_use]
pub fn group(universe: u16) -> SocketAddr {
    let [high, low] = universe.to_be_bytes();
    ([239, 255, high, low], 5568).into()
}

/// Returns the datagram of E1.31 by which consoles list this source with the universes that it sends, which are in ascending
/// order (section 8 of the standard). Only the first 512 of them are named.
#[must_use]
pub fn discovery(cid: [u8; 16], source: &str, universes: &[u16]) -> Vec<u8> {
    let universes = universes.get(..MOST_UNIVERSES).unwrap_or(universes);
    let total = DISCOVERY_BYTES + 2 * universes.len();
    let mut bytes = begin(total, 8, cid, source);
    bytes.extend_from_slice(&[0; 4]);
    add_length(&mut bytes, total);
    // The list of universes, on page 0 of pages up to 0.
    bytes.extend_from_slice(&[0, 0, 0, 1, 0, 0]);
    bytes.extend(universes.iter().flat_map(|universe| universe.to_be_bytes()));
    bytes
}

/// Returns the beginning of a datagram of E1.31 with so many bytes: its root layer with this vector, and its framing layer up to
/// the name of the source, with the vector 2 of both data and discovery.
fn begin(total: usize, vector: u8, cid: [u8; 16], source: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(b"\x00\x10\x00\x00ASC-E1.17\0\0\0");
    add_length(&mut bytes, total);
    bytes.extend_from_slice(&[0, 0, 0, vector]);
    bytes.extend_from_slice(&cid);
    add_length(&mut bytes, total);
    bytes.extend_from_slice(&[0, 0, 0, 2]);
    let name_at = bytes.len();
    let (name, _) = source.split_at(source.floor_char_boundary(SOURCE_BYTES - 1));
    bytes.extend_from_slice(name.as_bytes());
    bytes.resize(name_at + SOURCE_BYTES, 0);
    bytes
}

/// Writes the datagrams of one universe.
#[derive(Debug)]
pub struct Dmx {
    bytes: Vec<u8>,
    layout: Layout,
    sequence: u8,
    repeats: u8,
    sent_at: Option<Duration>,
    terminations: u8,
}

impl Dmx {
    /// Makes the format of E1.31 for a universe from 1 to 63999, with a priority from 0 to 200. Nodes tell sources apart by
    /// their `cid` and show the first 63 bytes of the name `source`.
    #[must_use]
    pub fn sacn(cid: [u8; 16], source: &str, priority: u8, universe: u16) -> Self {
        let mut bytes = begin(SACN_BYTES, 4, cid, source);
        // No synchronisation, sequence, no options.
        bytes.extend_from_slice(&[priority, 0, 0, 0, 0]);
        bytes.extend_from_slice(&universe.to_be_bytes());
        add_length(&mut bytes, SACN_BYTES);
        // The property 0 is the start code, and those after it are the values.
        bytes.extend_from_slice(&[2, 0xA1, 0, 0, 0, 1, 2, 1, 0]);
        Self::new(bytes, 111, Some(112))
    }

    /// Makes the format of Art-Net for a port address from 0 to 32767: net * 256 + sub-net * 16 + universe.
    #[must_use]
    pub fn art_net(port_address: u16) -> Self {
        let [net, sub_uni] = port_address.to_be_bytes();
        let mut bytes = Vec::with_capacity(18 + ADDRESSES);
        bytes.extend_from_slice(b"Art-Net\0\x00\x50\x00\x0E");
        bytes.extend_from_slice(&[0, 0, sub_uni, net, 2, 0]);
        Self::new(bytes, 12, None)
    }

    fn new(mut bytes: Vec<u8>, sequence: usize, options: Option<usize>) -> Self {
        let layout = Layout { sequence, options, values: bytes.len() };
        bytes.resize(layout.values + ADDRESSES, 0);
        Self { bytes, layout, sequence: 0, repeats: 0, sent_at: None, terminations: 0 }
    }

    /// Sends the values if they are due at `now`, the time since the format was made. With `is_last`, Art-Net sends them at
    /// every call. E1.31 sends them at the first, and ends the stream with a datagram at each of the first three.
    pub fn encode(&mut self, values: &Universe, is_last: bool, now: Duration, send: &mut dyn FnMut(&[u8])) {
        let is_stream = self.layout.options.is_some();
        let before = self.bytes.get_mut(self.layout.values..).unwrap_or_default();
        self.repeats = if before == values { self.repeats.saturating_add(1) } else { 0 };
        before.copy_from_slice(values);
        let is_old = |sent_at| now.saturating_sub(sent_at) >= KEEP_ALIVE;
        let is_due = self.repeats <= REPEATS || self.sent_at.is_none_or(is_old);
        let is_sent = if is_last { !is_stream || self.terminations == 0 } else { is_due };
        if is_sent {
            self.send(0, now, send);
        }
        if !is_last {
            self.terminations = 0;
        } else if is_stream && self.terminations < TERMINATIONS {
            self.terminations += 1;
            self.send(STREAM_TERMINATED, now, send);
        }
    }

    fn send(&mut self, options: u8, now: Duration, send: &mut dyn FnMut(&[u8])) {
        for (place, byte) in [(Some(self.layout.sequence), self.sequence), (self.layout.options, options)] {
            if let Some(at) = place.and_then(|place| self.bytes.get_mut(place)) {
                *at = byte;
            }
        }
        self.sent_at = Some(now);
        send(&self.bytes);
        // In Art-Net, 0 stands for no sequence. The first datagram has it, so that a node accepts a sender that was killed
        // and starts again.
        let first = u8::from(self.layout.options.is_none());
        self.sequence = self.sequence.checked_add(1).unwrap_or(first);
    }
}

/// Adds the length of an E1.31 datagram from here to its end, with the flags of the protocol. It has `total` bytes.
fn add_length(bytes: &mut Vec<u8>, total: usize) {
    let length = u16::try_from(total - bytes.len()).unwrap_or(0);
    bytes.extend_from_slice(&(0x7000 | length).to_be_bytes());
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests {
    use super::super::testing::sent;
    use super::*;

    const ZERO: Universe = [0; ADDRESSES];
    /// ANSI E1.31-2018, appendix B, table B-13, without its synchronisation: facewire has none.
    const SACN: &[u8] = b"\x00\x10\x00\x00\x41\x53\x43\x2D\x45\x31\x2E\x31\x37\x00\x00\x00\x72\x6E\x00\x00\x00\x04\
        \xEF\x07\xC8\xDD\x00\x64\x44\x01\xA3\xA2\x45\x9E\xF8\xE6\x14\x3E\x72\x58\x00\x00\x00\x02Source_A";
    const SACN_END: &[u8] = b"\x64\x00\x00\x9A\x00\x00\x01\x72\x0B\x02\xA1\x00\x00\x00\x01\x02\x01\x00";
    const CID: [u8; 16] = *b"\xEF\x07\xC8\xDD\x00\x64\x44\x01\xA3\xA2\x45\x9E\xF8\xE6\x14\x3E";

    fn universe(first: u8) -> Universe {
        let mut values = ZERO;
        values[0] = first;
        values
    }

    /// The datagrams for these values at this time.
    fn at(format: &mut Dmx, ms: u64, first: u8, is_last: bool) -> Vec<Vec<u8>> {
        sent(|send| format.encode(&universe(first), is_last, Duration::from_millis(ms), send))
    }

    #[test]
    fn a_datagram_of_e131_has_the_bytes_of_the_standards_example() {
        let mut format = Dmx::sacn(CID, "Source_A", 100, 1);
        format.sequence = 154;
        let want = [SACN, &[0; 56], SACN_END, &ZERO].concat();
        assert_eq!(at(&mut format, 0, 0, false), [want]);
        let long = at(&mut Dmx::sacn(CID, &"ü".repeat(40), 200, 63_999), 0, 0, false).concat();
        assert_eq!(
            (&long[44..106], &long[106..109]),
            ("ü".repeat(31).as_bytes(), &[0, 0, 200][..]),
            "whole characters"
        );
        assert_eq!((long[113..115].to_vec(), long.len()), (vec![0xF9, 0xFF], 638));
        assert_eq!([1, 63_999].map(|it| group(it).to_string()), ["239.255.0.1:5568", "239.255.249.255:5568"]);
    }

    /// ANSI E1.31-2018, tables 4-3 and 8-9, with the source of table B-13 and the universes 1 and 7. 124 bytes are 0x7C.
    #[test]
    fn a_datagram_of_discovery_has_the_bytes_of_the_standard_and_names_512_universes_at_most() {
        let want = [
            &b"\x00\x10\x00\x00\x41\x53\x43\x2D\x45\x31\x2E\x31\x37\x00\x00\x00\x70\x6C\x00\x00\x00\x08"[..],
            &CID,
            b"\x70\x56\x00\x00\x00\x02Source_A",
            &[0; 56],
            b"\x00\x00\x00\x00\x70\x0C\x00\x00\x00\x01\x00\x00\x00\x01\x00\x07",
        ];
        assert_eq!(discovery(CID, "Source_A", &[1, 7]), want.concat());
        let universes: Vec<u16> = (1..=600).collect();
        let full = discovery(CID, "Source_A", &universes);
        assert_eq!((full.len(), &full[16..18], &full[1142..]), (1144, &[0x74, 0x68][..], &[2, 0][..]));
        assert_eq!(group(DISCOVERY_UNIVERSE).to_string(), "239.255.250.214:5568");
    }

    #[test]
    fn a_datagram_of_art_net_has_the_documented_bytes_and_all_values() {
        let mut want = [b"Art-Net\0\x00\x50\x00\x0E\x00\x00\x01\x00\x02\x00".as_slice(), &ZERO].concat();
        want[18] = 0xFF;
        assert_eq!(at(&mut Dmx::art_net(1), 0, 0xFF, false), [want]);
        let highest = at(&mut Dmx::art_net(0x7FFF), 0, 0, false).concat();
        assert_eq!(highest[14..18], [0xFF, 0x7F, 2, 0]);
    }

    /// Some players show their idle look after a second without a datagram.
    #[test]
    fn changes_are_sent_at_once_and_what_is_unchanged_three_times_more_and_then_about_once_a_second() {
        for mut format in [Dmx::sacn(CID, "face", 100, 1), Dmx::art_net(0)] {
            let times = (0..).step_by(25).take(400);
            let sent_ms: Vec<u64> = times.filter(|ms| !at(&mut format, *ms, 9, false).is_empty()).collect();
            assert_eq!(sent_ms[..6], [0, 25, 50, 75, 875, 1675]);
            assert!(sent_ms.windows(2).all(|pair| pair[1] - pair[0] < 1000), "{sent_ms:?}");
            assert_eq!(at(&mut format, 10_000, 10, false).len(), 1);
        }
    }

    /// Nodes drop a datagram whose number is not after the last one's, and Art-Net's 0 switches that off.
    #[test]
    fn numbers_count_from_0_every_datagram_of_the_universe_and_wrap_by_art_net_to_1() {
        for (mut format, place, after_255) in [(Dmx::sacn(CID, "face", 100, 1), 111, 0), (Dmx::art_net(0), 12, 1)] {
            assert_eq!(at(&mut format, 0, 1, false)[0][place], 0);
            format.sequence = 254;
            let numbers: Vec<u8> = (0..3).map(|ms| at(&mut format, ms, 0, false)[0][place]).collect();
            assert_eq!(numbers, [254, 255, after_255]);
            let _unchanged = [3, 4, 5].map(|ms| at(&mut format, ms, 0, false));
            assert_eq!(at(&mut format, 6, 1, false)[0][place], after_255 + 2, "what is not sent takes no number");
        }
    }

    /// Of a datagram that ends the stream, nodes take no values.
    #[test]
    fn the_last_values_are_sent_and_then_three_datagrams_end_the_stream_of_e131_and_none_follow() {
        let mut format = Dmx::sacn(CID, "face", 100, 1);
        (0..10).for_each(|ms| drop(at(&mut format, ms, 5, false)));
        let ends: Vec<_> = (10..16).map(|ms| at(&mut format, ms, 5, true)).collect();
        let options: Vec<Vec<u8>> = ends.iter().map(|sent| sent.iter().map(|bytes| bytes[112]).collect()).collect();
        assert_eq!(options, [vec![0, 0x40], vec![0x40], vec![0x40], vec![], vec![], vec![]]);
        let numbers: Vec<u8> = ends.concat().iter().map(|bytes| bytes[111]).collect();
        assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
        assert!(at(&mut format, 2000, 5, false)[0][112] == 0, "a stream that goes on");
        let mut format = Dmx::art_net(0);
        (0..10).for_each(|ms| drop(at(&mut format, ms, 5, false)));
        assert_eq!([10, 11, 12].map(|ms| at(&mut format, ms, 5, true).len()), [1; 3]);
    }
}
