//! Compares the reader of a serial line with a decoder that has the whole line at once.

use facewire_packet::{DecodeError, FRAME_BYTES, FrameReader, PACKET_BYTES, Packet};

use super::wire::sealed;

/// The result at the end of a frame.
type Ended = Result<Packet, DecodeError>;

/// Checks that the reader finds the packets that a decoder of the whole line finds, wherever it is cloned or moved between
/// two bytes, and that after any meaningless bytes a 0 synchronises it for the good frame that follows. The reader's type
/// bounds its memory, because it owns no heap.
pub fn cobs_stream(data: &[u8]) {
    let line = line(data);
    let ended = read(&mut FrameReader::default(), &line);
    assert_eq!(ended, whole(&line));
    let cut = data.first().map_or(0, |byte| usize::from(*byte) * line.len() / 256);
    let (start, rest) = line.split_at(cut);
    let mut reader = FrameReader::default();
    let first = read(&mut reader, start);
    assert_eq!([first, read(&mut reader.clone(), rest)].concat(), ended);
    finds_the_next_good_frame(reader, rest);
}

/// Builds a line of meaningless bytes and good frames. A byte of 224 or more sends the bytes that follow as the frame of
/// one packet; a smaller byte is the count of bytes to send as they are.
fn line(mut data: &[u8]) -> Vec<u8> {
    let mut line = Vec::new();
    while let Some((first, rest)) = data.split_first() {
        let wanted = if *first >= 224 { PACKET_BYTES } else { usize::from(*first) };
        let (taken, left) = rest.split_at(wanted.min(rest.len()));
        if *first >= 224 {
            line.extend(stuffed(&sealed(taken)));
        } else {
            line.extend(taken);
        }
        data = left;
    }
    line
}

/// Encodes by COBS as its inventors describe it: each stretch of bytes up to a 0 is preceded by its length plus 1.
fn stuffed(bytes: &[u8; PACKET_BYTES]) -> Vec<u8> {
    let mut frame = Vec::new();
    for stretch in bytes.split(|byte| *byte == 0) {
        frame.push(u8::try_from(stretch.len() + 1).unwrap());
        frame.extend(stretch);
    }
    frame.push(0);
    assert_eq!(frame.len(), FRAME_BYTES);
    if let Ok(packet) = Packet::decode(bytes)
        && packet.encode() == *bytes
    {
        assert_eq!(packet.encode_frame()[..], frame[..]);
    }
    frame
}

fn read(reader: &mut FrameReader, bytes: &[u8]) -> Vec<Ended> {
    bytes.iter().filter_map(|byte| reader.push(*byte)).collect()
}

/// Decodes the frames of a whole line. The bytes after the last 0 are not a frame yet.
fn whole(line: &[u8]) -> Vec<Ended> {
    let mut frames: Vec<&[u8]> = line.split(|byte| *byte == 0).collect();
    frames.pop();
    frames.into_iter().filter(|frame| !frame.is_empty()).map(unstuffed).collect()
}

fn unstuffed(mut frame: &[u8]) -> Ended {
    let mut bytes = Vec::new();
    while let Some((distance, rest)) = frame.split_first() {
        let stretch = usize::from(*distance) - 1;
        if stretch > rest.len() {
            return Err(DecodeError::Cut);
        }
        bytes.extend(&rest[..stretch]);
        frame = &rest[stretch..];
        if !frame.is_empty() {
            bytes.push(0);
        }
    }
    Packet::decode(&bytes)
}

fn finds_the_next_good_frame(mut reader: FrameReader, rubbish: &[u8]) {
    read(&mut reader, rubbish);
    reader.push(0);
    let sent = Packet { sequence: 4711, ..Packet::NEUTRAL };
    assert_eq!(read(&mut reader, &sent.encode_frame()), [Packet::decode(&sent.encode())]);
}
