//! One frame of a recording, and its bytes.

use facewire_face::{LANDMARKS, Landmarks};
use facewire_packet::{PACKET_BYTES, Packet, Pose, Reason, State};

const STEPS_PER_PX: f32 = 32.0;
/// Largest coordinate, steps: 32,768 pixels.
const MOST_STEPS: i32 = 1 << 20;
const COORDINATES: usize = 3 * LANDMARKS;
/// Most bytes of a frame, rounded up.
pub(super) const MAX_FRAME_BYTES: usize = 8192;

pub(super) type Steps = [i32; COORDINATES];

/// What is kept of one frame. Has a fixed size, so that it can be handed from thread to thread without allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Time of the frame in microseconds: of its capture, or in a file since the first frame.
    pub time_us: u64,
    /// The pose that receivers were to show, or the reason why there was none.
    pub pose: Result<Pose, Reason>,
    /// Width and height of the picture in which the landmarks were found, pixels.
    pub size_px: [u16; 2],
    pub landmarks: Option<Landmarks>,
}

impl Recorded {
    pub fn nothing(time_us: u64, reason: Reason) -> Self {
        Self { time_us, pose: Err(reason), size_px: [0; 2], landmarks: None }
    }

    pub fn new(time_us: u64, pose: &Pose, size_px: [f32; 2], landmarks: Option<&Landmarks>) -> Self {
        Self { time_us, pose: Ok(*pose), size_px: size_px.map(|side| side as u16), landmarks: landmarks.cloned() }
    }

    /// Appends the bytes of the frame to `bytes`. The landmarks are written as the difference to those of `before`, which
    /// then become these.
    pub(super) fn write(&self, bytes: &mut Vec<u8>, before: &mut Steps) {
        let (state, reason, pose) = match &self.pose {
            Ok(pose) => (State::Live, Reason::None, pose),
            Err(reason) => (State::Neutral, *reason, &Pose::NEUTRAL),
        };
        let packet = Packet { state, reason, age_us: 0, ..Packet::NEUTRAL }.with_pose(pose);
        bytes.extend_from_slice(&self.time_us.to_le_bytes());
        bytes.extend_from_slice(&packet.encode());
        let size_px = if self.landmarks.is_some() { self.size_px } else { [0; 2] };
        bytes.extend_from_slice(size_px.map(u16::to_le_bytes).as_flattened());
        let Some(landmarks) = &self.landmarks else { return };
        for (value, before) in landmarks.0.as_flattened().iter().zip(before) {
            let steps = ((value * STEPS_PER_PX).round() as i32).clamp(-MOST_STEPS, MOST_STEPS);
            // Postcard writes numbers as zigzag and LEB128, which take 5 bytes at most.
            let mut number = [0; 5];
            let number = postcard::to_slice(&(steps - *before), &mut number);
            bytes.extend_from_slice(number.unwrap_or_default());
            *before = steps;
        }
    }

    /// Takes a frame from the beginning of `bytes`. Returns `None` if they do not begin with a frame.
    pub(super) fn read(bytes: &mut &[u8], before: &mut Steps) -> Option<Self> {
        let time_us = u64::from_le_bytes(take(bytes)?);
        let packet = Packet::decode(&take::<PACKET_BYTES>(bytes)?).ok()?;
        let pose = if packet.state == State::Live { Ok(packet.pose()) } else { Err(packet.reason) };
        let size_px = [u16::from_le_bytes(take(bytes)?), u16::from_le_bytes(take(bytes)?)];
        if size_px.contains(&0) {
            return Some(Self { time_us, pose, size_px, landmarks: None });
        }
        let mut landmarks = Landmarks::zero();
        for (value, before) in landmarks.0.as_flattened_mut().iter_mut().zip(before) {
            let (difference, rest) = postcard::take_from_bytes(bytes).ok()?;
            *bytes = rest;
            *before = before.checked_add(difference).filter(|steps| (-MOST_STEPS..=MOST_STEPS).contains(steps))?;
            *value = *before as f32 / STEPS_PER_PX;
        }
        Some(Self { time_us, pose, size_px, landmarks: Some(landmarks) })
    }

    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(2 * COORDINATES);
        self.write(&mut bytes, &mut [0; COORDINATES]);
        bytes
    }

    /// Reads the bytes of [`Recorded::to_bytes`]. Returns `None` for others.
    pub fn from_bytes(mut bytes: &[u8]) -> Option<Self> {
        Self::read(&mut bytes, &mut [0; COORDINATES]).filter(|_| bytes.is_empty())
    }
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn landmarks_are_kept_to_a_64th_of_a_pixel_and_the_pose_as_in_a_packet() {
        let mut random = fastrand::Rng::with_seed(3);
        let landmarks = Landmarks(core::array::from_fn(|_| core::array::from_fn(|_| 5000.0 * (random.f32() - 0.2))));
        let pose = Pose { position_mm: [1.0, 2.0, 600.0], coefficients: [0.25; 52], ..Pose::NEUTRAL };
        let frame = Recorded::new(7, &pose, [640.0, 480.0], Some(&landmarks));
        let read = Recorded::from_bytes(&frame.to_bytes()).unwrap();
        let kept = read.landmarks.as_ref().unwrap();
        let differences = kept.0.as_flattened().iter().zip(landmarks.0.as_flattened()).map(|(a, b)| (a - b).abs());
        assert!(differences.fold(0.0, f32::max) <= 1.0 / 64.0);
        let read_pose = read.pose.unwrap();
        assert_eq!((read.time_us, read.size_px, read_pose.position_mm), (7, [640, 480], pose.position_mm));
        assert!(read_pose.coefficients.iter().all(|value| (value - 0.25).abs() < 1e-5));
        let nothing = Recorded::nothing(9, Reason::NoCamera);
        assert_eq!(Recorded::from_bytes(&nothing.to_bytes()).unwrap().pose, Err(Reason::NoCamera));
    }

    #[test]
    fn a_coordinate_is_written_in_32nds_of_a_pixel_as_zigzag_and_leb128_and_stays_finite() {
        for (value_px, bytes) in [
            (0.0, &[0][..]),
            (-1.0 / 32.0, &[1]),
            (2.0, &[0x80, 1]),
            (-300.5, &[0x9f, 0x96, 1]),
            (f32::INFINITY, &[0x80, 0x80, 0x80, 1]),
            (f32::NAN, &[0]),
        ] {
            let landmarks = Landmarks([[value_px; 3]; LANDMARKS]);
            let written = Recorded::new(0, &Pose::NEUTRAL, [640.0, 480.0], Some(&landmarks)).to_bytes();
            assert!(written.ends_with(&bytes.repeat(COORDINATES)), "{value_px}");
            assert!(Recorded::from_bytes(&written).unwrap().landmarks.unwrap().is_finite());
        }
    }

    #[test]
    fn cut_bytes_and_a_landmark_beyond_every_picture_are_no_frame() {
        /// 32,768 pixels, in steps.
        const MOST: i32 = 1 << 20;
        let bytes = Recorded::new(1, &Pose::NEUTRAL, [640.0, 480.0], Some(&Landmarks::zero())).to_bytes();
        for length in 0..bytes.len() {
            assert_eq!(Recorded::from_bytes(bytes.get(..length).unwrap()), None, "{length}");
        }
        let head = bytes.get(..bytes.len() - COORDINATES).unwrap();
        let beyond = [(0, i32::MIN), (0, -MOST - 1), (0, MOST + 1), (MOST, 1), (MOST, i32::MAX)];
        for (before, difference) in beyond {
            let crafted = [head, &postcard::to_allocvec(&difference).unwrap().repeat(COORDINATES)].concat();
            let read = Recorded::read(&mut crafted.as_slice(), &mut [before; COORDINATES]);
            assert_eq!(read, None, "{before} and {difference}");
        }
    }
}
