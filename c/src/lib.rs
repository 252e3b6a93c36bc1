//! The C interface of facewire-library. `include/facewire.h` is made of this file.
//!
//! Everything that C hands over is checked, as far as that is possible: a null pointer, a length, a format and a text are; that
//! a pointer leads to as much memory as is told, and that a tracker is open, is the caller's promise.

use std::ffi::{CStr, c_char};
use std::ptr;
use std::time::Duration;

use facewire_library::{
    BLENDSHAPES, Error, FaceTracker, Filters, Format, NeutralFace, NeutralMode, Options as Chosen, default_shaping,
    read_profile,
};

/// Number of blendshapes.
pub const FACEWIRE_BLENDSHAPES: usize = 52;
/// Number of landmarks of a face.
pub const FACEWIRE_LANDMARKS: usize = 478;
/// Longest message of a tracker, with the 0 at its end.
pub const FACEWIRE_MESSAGE_BYTES: usize = 512;

/// Red, green and blue.
pub const FACEWIRE_RGB: u32 = 0;
/// Blue, green and red.
pub const FACEWIRE_BGR: u32 = 1;
/// Red, green, blue and a byte that is not read.
pub const FACEWIRE_RGBA: u32 = 2;
/// Blue, green, red and a byte that is not read.
pub const FACEWIRE_BGRA: u32 = 3;
/// Luma only.
pub const FACEWIRE_GREY: u32 = 4;
/// Packed 4:2:2, Y0 Cb Y1 Cr.
pub const FACEWIRE_YUYV: u32 = 5;
/// 4:2:0: a plane of luma, then one of Cb Cr.
pub const FACEWIRE_NV12: u32 = 6;
/// 4:2:0: planes of luma, Cb and Cr.
pub const FACEWIRE_I420: u32 = 7;
/// 4:2:2: planes of luma, Cb and Cr.
pub const FACEWIRE_I422: u32 = 8;
/// 4:4:4: planes of luma, Cb and Cr.
pub const FACEWIRE_I444: u32 = 9;

/// Pictures that have nothing to do with each other: no filters, no history.
pub const FACEWIRE_STILLS: u32 = 1;
/// No filters.
pub const FACEWIRE_UNSMOOTHED: u32 = 2;
/// The neutral face is not estimated: without a profile, it is the mean of many people.
pub const FACEWIRE_MEAN_NEUTRAL: u32 = 4;
/// Left and right are swapped in the result.
pub const FACEWIRE_MIRROR: u32 = 8;

const FLAGS: u32 = FACEWIRE_STILLS | FACEWIRE_UNSMOOTHED | FACEWIRE_MEAN_NEUTRAL | FACEWIRE_MIRROR;

/// Follows faces from picture to picture.
pub struct Tracker {
    tracker: FaceTracker,
    message: [u8; FACEWIRE_MESSAGE_BYTES],
}

/// How to follow faces. Begin with facewire_default_options().
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// How many faces are followed, 1 to 16.
    pub max_faces: u32,
    /// How many threads compute the networks, 1 to 16.
    pub threads: u32,
    /// Any of FACEWIRE_STILLS, FACEWIRE_UNSMOOTHED, FACEWIRE_MEAN_NEUTRAL and FACEWIRE_MIRROR.
    pub flags: u32,
    /// Angle of view across the width of the picture.
    pub horizontal_fov_deg: f32,
    /// A profile by `facewire calibrate`, or NULL. With several faces, it is that of the first face that is found.
    pub profile: *const c_char,
    /// A blendshape model in place of the built-in one, or NULL.
    pub model: *const c_char,
    /// A folder of networks in place of the built-in ones, or NULL.
    pub networks: *const c_char,
}

/// A picture, which remains the caller's.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Picture {
    /// The samples.
    pub data: *const u8,
    /// How many bytes there are.
    pub bytes: usize,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bytes from one row to the next; 0 if rows have no padding.
    pub stride: usize,
    /// FACEWIRE_RGB or another one.
    pub format: u32,
    /// 1 if black and white are 16 and 235, 0 if they are 0 and 255.
    pub is_video_range: u32,
}

/// How much of each part of a face is in view, from 0 (covered) to 1. Left and right are the person's own.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Visibility {
    /// The left eye with its lids.
    pub left_eye: f32,
    /// The right eye with its lids.
    pub right_eye: f32,
    /// Both brows.
    pub brows: f32,
    /// Mouth and jaw.
    pub mouth: f32,
    /// Cheeks and nose.
    pub cheeks: f32,
    /// The whole face.
    pub face: f32,
}

impl From<facewire_library::Visibility> for Visibility {
    fn from(visibility: facewire_library::Visibility) -> Self {
        let facewire_library::Visibility { left_eye, right_eye, brows, mouth, cheeks, face } = visibility;
        Self { left_eye, right_eye, brows, mouth, cheeks, face }
    }
}

/// A face in a picture.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Face {
    /// Stays the same while a face is followed.
    pub id: u64,
    /// In the order of facewire_blendshape(), from 0 to 1.
    pub coefficients: [f32; FACEWIRE_BLENDSHAPES],
    /// Rotation of the head as a unit quaternion.
    pub rotation_xyzw: [f32; 4],
    /// Turn of the head to its left, up, and towards its right shoulder.
    pub yaw_pitch_roll_deg: [f32; 3],
    /// Position of the point between the eyes: x to the right of the picture, y down, z away from the camera.
    pub position_mm: [f32; 3],
    /// Where both eyes look, in the axes of the head: to its left and up.
    pub gaze_yaw_pitch_deg: [f32; 2],
    /// The neutral face from which coefficients are measured: 0 the mean of many people, 1 estimated, 2 calibrated.
    pub neutral: u32,
    /// How much of each part is in view. The coefficients of what is covered are a guess.
    pub visibility: Visibility,
    /// How surely the network sees a face: its log-odds, about 25 for one in view. Below 15 the face is doubtful.
    pub score: f32,
    /// The smallest upright rectangle around the landmarks, in pixels of the picture: left, top, right and bottom.
    pub box_px: [f32; 4],
    /// x, y and z of the landmarks in pixels of the picture.
    pub landmarks: [[f32; 3]; FACEWIRE_LANDMARKS],
}

impl From<&facewire_library::Face> for Face {
    fn from(face: &facewire_library::Face) -> Self {
        Self {
            id: face.id,
            coefficients: face.coefficients,
            rotation_xyzw: face.head.rotation_xyzw,
            yaw_pitch_roll_deg: face.head.yaw_pitch_roll_deg(),
            position_mm: face.head.position_mm,
            gaze_yaw_pitch_deg: face.gaze.yaw_pitch_deg,
            neutral: match face.neutral {
                NeutralFace::Mean => 0,
                NeutralFace::Estimated => 1,
                NeutralFace::Calibrated => 2,
            },
            visibility: face.visibility.into(),
            score: face.score,
            box_px: face.box_px(),
            landmarks: face.landmarks.0,
        }
    }
}

/// Options that are those of the service.
#[unsafe(no_mangle)]
pub extern "C" fn facewire_default_options() -> Options {
    Options {
        max_faces: 1,
        threads: 1,
        flags: 0,
        horizontal_fov_deg: 60.0,
        profile: ptr::null(),
        model: ptr::null(),
        networks: ptr::null(),
    }
}

/// Makes a tracker. Returns NULL after an error, and writes its message with a 0 at the end into `message_bytes` bytes at
/// `message`, unless that is NULL. `options` can be NULL.
///
/// # Safety
/// The pointers lead to what they are said to lead to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_open(
    options: *const Options,
    message: *mut c_char,
    message_bytes: usize,
) -> *mut Tracker {
    // SAFETY: the caller promises that the pointer is null or leads to options.
    let options = unsafe { options.as_ref() }.copied().unwrap_or(facewire_default_options());
    // SAFETY: the caller promises that the texts end with a 0.
    match unsafe { open(&options) } {
        Ok(tracker) => Box::into_raw(Box::new(Tracker { tracker, message: [0; FACEWIRE_MESSAGE_BYTES] })),
        Err(error) => {
            if !message.is_null() && message_bytes > 0 {
                // SAFETY: the caller promises that so many bytes can be written there.
                write_message(&error, unsafe { std::slice::from_raw_parts_mut(message.cast(), message_bytes) });
            }
            ptr::null_mut()
        }
    }
}

/// # Safety
/// The texts end with a 0.
unsafe fn open(options: &Options) -> Result<FaceTracker, String> {
    let text = |text: *const c_char| -> Result<Option<&str>, String> {
        if text.is_null() {
            return Ok(None);
        }
        // SAFETY: the caller promises that the text ends with a 0.
        let text = unsafe { CStr::from_ptr(text) }.to_str();
        Ok(Some(text.map_err(|_| "a path is not UTF-8".to_owned())?))
    };
    let is_set = |flag: u32| options.flags & flag != 0;
    if options.flags & !FLAGS != 0 {
        return Err("flags has a bit without a meaning".to_owned());
    }
    let mut chosen = if is_set(FACEWIRE_STILLS) { Chosen::for_stills() } else { Chosen::default() };
    let mut shaping = default_shaping();
    shaping.adjustments.mirror = is_set(FACEWIRE_MIRROR);
    if is_set(FACEWIRE_STILLS) || is_set(FACEWIRE_UNSMOOTHED) {
        shaping.filters = Filters::OFF;
    }
    chosen = chosen
        .max_faces(options.max_faces as usize)
        .threads(options.threads)
        .horizontal_fov_deg(options.horizontal_fov_deg)
        .shaping(shaping);
    if is_set(FACEWIRE_MEAN_NEUTRAL) {
        chosen = chosen.neutral(NeutralMode::Off);
    }
    let told = |error: Error| error.to_string();
    if let Some(path) = text(options.profile)? {
        chosen = chosen.profile(read_profile(path).map_err(told)?);
    }
    if let Some(path) = text(options.model)? {
        chosen = chosen.model(path);
    }
    if let Some(folder) = text(options.networks)? {
        chosen = chosen.networks(folder);
    }
    chosen.open().map_err(told)
}

/// Finds the faces in a picture that was taken at `time_us` since any moment that stays the same, and writes at most `capacity`
/// of them to `faces`, that which has been followed longest first. Returns how many were written, or -1 after an error, whose
/// sentence facewire_message() returns. Allocates nothing, except with FACEWIRE_STILLS.
///
/// # Safety
/// The pointers lead to what they are said to lead to, and no other thread uses the tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_process(
    tracker: *mut Tracker,
    picture: *const Picture,
    time_us: u64,
    faces: *mut Face,
    capacity: usize,
) -> i32 {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    let Some(Tracker { tracker, message }) = (unsafe { tracker.as_mut() }) else { return -1 };
    message.fill(0);
    // SAFETY: the caller promises that the pointer is null or leads to a picture, and its data to as many bytes as it tells.
    let picture = unsafe { picture.as_ref() }.ok_or("there is no picture".to_owned());
    // SAFETY: as above.
    let picture = picture.and_then(|picture| unsafe { picture_of(picture) });
    let found = picture.and_then(|picture| {
        let found = tracker.process_all(&picture, Duration::from_micros(time_us));
        found.map(drop).map_err(|error| error.to_string())
    });
    if let Err(error) = found {
        write_message(&error, message);
        return -1;
    }
    let capacity = if faces.is_null() { 0 } else { capacity };
    let (mut written, mut least) = (0, 0);
    while let Some(face) = tracker.faces().filter(|face| face.id > least).min_by_key(|face| face.id)
        && written < capacity
    {
        least = face.id;
        // SAFETY: the caller promises that there is memory for so many faces.
        unsafe { faces.add(written).write(face.into()) };
        written += 1;
    }
    i32::try_from(written).unwrap_or(i32::MAX)
}

/// # Safety
/// The data are null or as many bytes as the picture tells.
unsafe fn picture_of(picture: &Picture) -> Result<facewire_library::Picture<'_>, String> {
    let format = usize::try_from(picture.format).ok().and_then(|format| Format::ALL.get(format).copied());
    let format = format.ok_or("there is no such format")?;
    if picture.data.is_null() || picture.bytes > isize::MAX.unsigned_abs() {
        return Err("the picture has no data".to_owned());
    }
    // SAFETY: the data are not null, and the caller promises that there are so many.
    let data = unsafe { std::slice::from_raw_parts(picture.data, picture.bytes) };
    let size = [picture.width as usize, picture.height as usize];
    let stride = if picture.stride == 0 { format.row_bytes(size[0]) } else { picture.stride };
    let found = format.padded_picture(data, size, stride, picture.is_video_range == 0);
    found.map_err(|error| error.to_string())
}

/// What went wrong in the last call of facewire_process(); empty if nothing did. The text belongs to the tracker, and changes
/// with the next call.
///
/// # Safety
/// The pointer is NULL or leads to a tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_message(tracker: *const Tracker) -> *const c_char {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { tracker.as_ref() }.map_or(c"there is no tracker".as_ptr(), |tracker| tracker.message.as_ptr().cast())
}

/// Forgets all faces and what was learned of them.
///
/// # Safety
/// The pointer is NULL or leads to a tracker that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_reset(tracker: *mut Tracker) {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    if let Some(tracker) = unsafe { tracker.as_mut() } {
        tracker.tracker.reset();
    }
}

/// Frees a tracker. NULL is none.
///
/// # Safety
/// The pointer is NULL or was returned by facewire_open(), and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_close(tracker: *mut Tracker) {
    if !tracker.is_null() {
        // SAFETY: the caller promises that the tracker comes from facewire_open.
        drop(unsafe { Box::from_raw(tracker) });
    }
}

/// The name of a blendshape, such as "jawOpen"; NULL if the index is not below FACEWIRE_BLENDSHAPES.
#[unsafe(no_mangle)]
pub extern "C" fn facewire_blendshape(index: usize) -> *const c_char {
    NAMES.get(index).map_or(ptr::null(), |name| name.as_ptr().cast())
}

/// The names with a 0 at their end.
#[allow(clippy::indexing_slicing, reason = "the compiler computes this")]
static NAMES: [[u8; 24]; FACEWIRE_BLENDSHAPES] = {
    let (mut names, mut index) = ([[0; 24]; FACEWIRE_BLENDSHAPES], 0);
    while index < FACEWIRE_BLENDSHAPES {
        let (name, mut at) = (BLENDSHAPES[index].as_bytes(), 0);
        while at < name.len() {
            names[index][at] = name[at];
            at += 1;
        }
        index += 1;
    }
    names
};

/// Writes as much of a sentence as there is room for, and a 0.
fn write_message(sentence: &str, message: &mut [u8]) {
    let room = message.len().saturating_sub(1);
    let end = (0..=sentence.len().min(room)).rev().find(|end| sentence.is_char_boundary(*end)).unwrap_or(0);
    let (text, rest) = message.split_at_mut(end);
    text.copy_from_slice(sentence.as_bytes().get(..end).unwrap_or_default());
    if let Some(last) = rest.first_mut() {
        *last = 0;
    }
}
