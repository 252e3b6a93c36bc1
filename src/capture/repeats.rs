//! Notices a picture that is sent again and again, byte for byte, although the camera's clock goes on.
//!
//! Sensors have noise, so that two frames of a camera nearly always differ somewhere. A camera whose frames are the same for a
//! second hangs, its shutter is closed, or it shows a picture of its own. What a program shows may well stand still: a photo, for
//! instance.
//!
//! Contract: one look at a few hundred bytes of a frame that differs from the one before. Nothing allocates.

/// Places of a frame at which 8 bytes each are compared with those of the frame before. All bytes count where these are the same.
const SAMPLES: usize = 64;
const SAMPLE_BYTES: usize = 8;
/// A picture stands still if it was the same for so many frames and for so long.
const LEAST_FRAMES: u32 = 8;
const LEAST_US: u64 = 1_000_000;
/// A camera whose picture has stood still for this long is opened again, once for each such picture.
const REOPEN_AFTER_US: u64 = 5_000_000;
/// After this many frames that move, the picture at which the camera hung before is forgotten.
const FORGET_AFTER_FRAMES: u32 = 300;

/// Compares each frame of a camera with the one before.
#[derive(Debug, Default)]
pub(super) struct Repeats {
    /// What the last frame had at a few places.
    sample: u64,
    /// A hash of all bytes of the last frame, unless the sample of it told it from the one before.
    whole: Option<u64>,
    /// How many frames in a row were the same as the one before, and since when.
    count: u32,
    since_us: u64,
    /// Whether the picture stands still, for how long it is known to, and the number of frames since it last did.
    is_frozen: bool,
    still_us: u64,
    moving: u32,
    /// The picture that stood still when the camera was open before. It counts at once, and is no reason to open it again.
    remembered: Option<u64>,
}

impl Repeats {
    pub(super) fn new(remembered: Option<u64>) -> Self {
        Self { remembered, ..Self::default() }
    }

    /// Takes a frame. Returns whether its picture stands still.
    pub(super) fn is_frozen(&mut self, frame: &[u8], now_us: u64) -> bool {
        let sample = sample(frame);
        let may_be_same = std::mem::replace(&mut self.sample, sample) == sample;
        let whole = (may_be_same || self.remembered.is_some()).then(|| hash(frame));
        let is_same = whole.is_some() && whole == self.whole;
        self.whole = whole;
        if is_same {
            self.count = self.count.saturating_add(1);
        } else {
            self.count = 0;
            self.since_us = now_us;
        }
        self.still_us = now_us.saturating_sub(self.since_us);
        let stands_still = self.count >= LEAST_FRAMES && self.still_us >= LEAST_US;
        self.is_frozen = stands_still || self.is_remembered();
        self.moving = if self.is_frozen { 0 } else { self.moving.saturating_add(1) };
        if self.moving >= FORGET_AFTER_FRAMES {
            self.remembered = None;
        }
        self.is_frozen
    }

    fn is_remembered(&self) -> bool {
        self.whole.is_some() && self.whole == self.remembered
    }

    /// Returns for how many frames the picture has stood still if opening the camera again may help.
    pub(super) fn asks_to_reopen(&self) -> Option<u32> {
        let is_new = self.is_frozen && !self.is_remembered() && self.still_us >= REOPEN_AFTER_US;
        is_new.then_some(self.count)
    }

    /// The picture that stands still, or that did so before.
    pub(super) fn frozen(&self) -> Option<u64> {
        self.whole.filter(|_| self.is_frozen).or(self.remembered)
    }
}

/// A hash of the length of a frame and of its bytes at some places.
fn sample(frame: &[u8]) -> u64 {
    // An odd step does not stay in a few columns of the picture.
    let step = (frame.len() / SAMPLES).max(SAMPLE_BYTES) | 1;
    let samples = frame.chunks(step).filter_map(|part| part.first_chunk());
    samples.fold(frame.len() as u64, |hash, bytes| mix(hash, *bytes))
}

/// A hash of all bytes. Four chains keep a processor busier than one.
fn hash(frame: &[u8]) -> u64 {
    let (blocks, rest) = frame.as_chunks::<{ 4 * SAMPLE_BYTES }>();
    let mut chains = [1, 2, 3, 4];
    for block in blocks {
        for (chain, bytes) in chains.iter_mut().zip(block.as_chunks().0) {
            *chain = mix(*chain, *bytes);
        }
    }
    let begun = chains.into_iter().fold(frame.len() as u64, |hash, chain| mix(hash, chain.to_le_bytes()));
    rest.iter().fold(begun, |hash, byte| mix(hash, u64::from(*byte).to_le_bytes()))
}

fn mix(hash: u64, bytes: [u8; SAMPLE_BYTES]) -> u64 {
    (hash ^ u64::from_le_bytes(bytes)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_US: u64 = 33_333;

    /// Returns for which of these frames, which are a period apart, the picture stands still.
    fn frozen(repeats: &mut Repeats, frames: impl IntoIterator<Item = Vec<u8>>, period_us: u64) -> Vec<usize> {
        let frames = frames.into_iter().enumerate();
        let stands_still = |(at, frame): &(usize, Vec<u8>)| repeats.is_frozen(frame, *at as u64 * period_us);
        frames.filter(stands_still).map(|(at, _)| at).collect()
    }

    /// A frame in which one byte far from every sample has this value.
    fn frame(value: u8) -> Vec<u8> {
        let mut frame = vec![7; 64_000];
        frame[31_995] = value;
        frame
    }

    #[test]
    fn a_picture_stands_still_if_every_byte_is_the_same_for_a_second_and_at_least_eight_frames() {
        let still = |count| std::iter::repeat_n(frame(1), count);
        let found = frozen(&mut Repeats::default(), still(60), PERIOD_US);
        assert_eq!(found, (32..60).collect::<Vec<_>>(), "the second frame is the first that is known in full");
        assert_eq!(frozen(&mut Repeats::default(), still(20), 1_000_000), (9..20).collect::<Vec<_>>(), "a slow camera");
        let noise = (0..200).map(|number| frame(number / 5));
        assert!(frozen(&mut Repeats::default(), noise, PERIOD_US).is_empty(), "five frames of each picture");
        let growing = (0..200).map(|length| vec![7; 64_000 + length]);
        assert!(frozen(&mut Repeats::default(), growing, PERIOD_US).is_empty(), "images of other lengths");
    }

    #[test]
    fn a_picture_asks_once_to_open_the_camera_again_and_is_known_at_once_afterwards_until_others_have_moved_for_300_frames()
     {
        let mut repeats = Repeats::default();
        frozen(&mut repeats, vec![frame(1); 152], PERIOD_US);
        assert_eq!(repeats.asks_to_reopen(), None, "it has stood still for less than 5 seconds");
        repeats.is_frozen(&frame(1), 152 * PERIOD_US);
        assert_eq!(repeats.asks_to_reopen(), Some(151));
        let mut again = Repeats::new(repeats.frozen());
        let begin_of_stream = [5, 6, 7, 1, 1].map(frame);
        assert_eq!(frozen(&mut again, begin_of_stream, PERIOD_US), [3, 4]);
        frozen(&mut again, vec![frame(1); 300], PERIOD_US);
        assert_eq!(again.asks_to_reopen(), None, "opening it again has not helped");
        let moving = |repeats: &mut Repeats, frames| {
            frozen(repeats, (0..frames).map(|number| frame(2 + number as u8 % 2)), PERIOD_US)
        };
        assert!(moving(&mut again, 299).is_empty());
        assert!(again.is_frozen(&frame(1), 0));
        assert!(moving(&mut again, 300).is_empty());
        assert!(!again.is_frozen(&frame(1), 0) && again.frozen().is_none());
    }
}
