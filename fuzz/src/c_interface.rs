//! The C interface takes any picture: it finds faces in it, or refuses it with a sentence, and reads no byte outside.

use std::cell::RefCell;
use std::ffi::CStr;
use std::mem::MaybeUninit;
use std::ptr;

use facewire_c::{
    Face, Picture, Tracker, facewire_close, facewire_message, facewire_open, facewire_process, facewire_reset,
};

const CAPACITY: usize = 2;

thread_local! {
    /// Networks are loaded once, because that takes longer than a picture.
    static TRACKER: RefCell<Opened> = RefCell::new(
        // SAFETY: there are neither options nor room for a message.
        Opened(unsafe { facewire_open(ptr::null(), ptr::null_mut(), 0) })
    );
}

/// A tracker that is closed at the end of its thread.
struct Opened(*mut Tracker);

impl Drop for Opened {
    fn drop(&mut self) {
        // SAFETY: the tracker is open, and nothing uses it any more.
        unsafe { facewire_close(self.0) }
    }
}

/// The first bytes are width, height, stride, how many bytes there are, format, range and planes, and flags; the others are repeated as
/// samples. Returns how many faces were found.
pub fn c_interface(bytes: &[u8]) -> usize {
    let Some((head, pattern)) = bytes.split_at_checked(12) else { return 0 };
    let number = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
    let repeated = pattern.iter().copied().cycle().take(usize::from(number(6)));
    // Exactly as many bytes as are told, so that AddressSanitizer sees one that is read behind them.
    let samples: Box<[u8]> = repeated.collect();
    let picture = Picture {
        data: if head[10] & 4 == 0 { samples.as_ptr() } else { ptr::null() },
        bytes: samples.len(),
        width: number(0).into(),
        height: number(2).into(),
        stride: if head[10] & 8 == 0 { number(4).into() } else { usize::MAX - usize::from(number(4)) },
        format: head[8].into(),
        is_video_range: (head[9] & 1).into(),
        chroma: [2, 4].map(|bit| if head[9] & bit == 0 { ptr::null() } else { samples.as_ptr() }),
        chroma_bytes: samples.len(),
        chroma_stride: usize::from(head[9] >> 3) << 4,
    };
    let mut faces = [const { MaybeUninit::<Face>::uninit() }; CAPACITY];
    TRACKER.with_borrow_mut(|Opened(tracker)| {
        assert!(!tracker.is_null());
        // SAFETY: the tracker is open, the samples are as many as the picture tells, and there is room for so many faces.
        let (found, message) = unsafe {
            if head[10] & 1 != 0 {
                facewire_reset(*tracker);
            }
            let time_us = u64::from(head[11]) << (head[10] >> 2);
            let found = facewire_process(*tracker, &raw const picture, time_us, faces.as_mut_ptr().cast(), CAPACITY);
            (found, CStr::from_ptr(facewire_message(*tracker)))
        };
        assert!((-1..=2).contains(&found) && (found < 0) != message.is_empty(), "{found} {message:?}");
        let found = found.max(0) as usize;
        for face in faces.iter().take(found) {
            // SAFETY: so many faces were written.
            let face = unsafe { face.assume_init_ref() };
            assert!(face.coefficients.iter().all(|value| (0.0..=1.0).contains(value)));
            assert!(face.landmarks.as_flattened().iter().chain(&face.position_mm).all(|value| value.is_finite()));
            let length = face.rotation_xyzw.iter().map(|value| value * value).sum::<f32>();
            assert!((length - 1.0).abs() < 1e-3, "{length}");
            // NaN is in no range.
            let angles_deg = face.yaw_pitch_roll_deg.iter().chain(&face.gaze_yaw_pitch_deg);
            assert!(angles_deg.copied().all(|angle| (-180.0..=180.0).contains(&angle)));
            assert!(face.neutral <= 2);
        }
        found
    })
}
