//! The C interface of facewire-library. `include/facewire.h` is made of this file.
//!
//! Everything that C hands over is checked, as far as that is possible: a null pointer, a length, a format and a text are; that
//! a pointer leads to as much memory as is told, and that a tracker is open, is the caller's promise.

use std::ffi::{CStr, c_char};
use std::mem::offset_of;
use std::time::Duration;
use std::{process, ptr};

use facewire_library::{
    BLENDSHAPES, Error, FaceTracker, Format, MAX_SIDE_PX, Method, NeutralFace, NeutralMode, Options as Chosen, Pixels,
    Profile, Shaping, default_shaping, parse_profile, parse_shaping, profile_text, read_profile,
};

/// Number of blendshapes.
pub const FACEWIRE_BLENDSHAPES: usize = 52;
/// Number of landmarks of a face.
pub const FACEWIRE_LANDMARKS: usize = 478;
/// Longest message of a tracker, with the 0 at its end.
pub const FACEWIRE_MESSAGE_BYTES: usize = 512;
/// Longest text of a profile, with the 0 at its end.
pub const FACEWIRE_PROFILE_BYTES: usize = 16384;

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

/// Coefficients by a network with a hidden layer.
pub const FACEWIRE_NETWORK: u32 = 0;
/// Coefficients by the formulas of the paper, one for each.
pub const FACEWIRE_PAPER: u32 = 1;

const FLAGS: u32 = FACEWIRE_STILLS | FACEWIRE_UNSMOOTHED | FACEWIRE_MEAN_NEUTRAL | FACEWIRE_MIRROR;

/// Follows faces from picture to picture.
pub struct Tracker {
    inner: FaceTracker,
    message: [u8; FACEWIRE_MESSAGE_BYTES],
    /// The process that made it.
    process: u32,
}

/// How to follow faces. facewire_default_options() fills it, and must come first. Later versions add fields at the end alone.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// sizeof(struct facewire_options), by which a later version knows which fields a program has.
    pub struct_size: usize,
    /// How many faces are followed, 1 to 16.
    pub max_faces: u32,
    /// How many threads compute the networks, 1 to 16.
    pub threads: u32,
    /// Any of FACEWIRE_STILLS, FACEWIRE_UNSMOOTHED, FACEWIRE_MEAN_NEUTRAL and FACEWIRE_MIRROR.
    pub flags: u32,
    /// FACEWIRE_NETWORK or FACEWIRE_PAPER.
    pub method: u32,
    /// Angle of view across the width of the camera's picture, on which the position of the head depends.
    pub horizontal_fov_deg: f32,
    /// Focal length in pixels of the pictures, in place of the angle of view; 0 if it is not known.
    pub focal_length_px: f32,
    /// Distance between the pupils, to which the position of the head is proportional.
    pub eye_distance_mm: f32,
    /// A profile by `facewire calibrate`, or NULL. With several faces, it is that of the first face that is found.
    pub profile: *const c_char,
    /// The tables smoothing, plausibility and adjust of the service's settings as a text in TOML, or NULL: filters, rules,
    /// and gains, offsets and limits. `facewire defaults` explains them. With FACEWIRE_STILLS or FACEWIRE_UNSMOOTHED there is
    /// no filter to be set.
    pub settings: *const c_char,
    /// A blendshape model in place of the built-in one, or NULL. The file brings its own method.
    pub model: *const c_char,
    /// A folder of networks in place of the built-in ones, or NULL.
    pub networks: *const c_char,
}

/// A picture, which remains the caller's.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Picture {
    /// The samples: all of them, or those of luma if the first of chroma is not NULL.
    pub data: *const u8,
    /// How many bytes there are at data.
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
    /// Planes of chroma, if they do not follow the luma at data: Cb and Cr, or in NV12 the plane of both and NULL. Otherwise NULL.
    pub chroma: [*const u8; 2],
    /// How many bytes there are at each plane of chroma.
    pub chroma_bytes: usize,
    /// Bytes from one row of a plane of chroma to the next; 0 if rows have no padding. In NV12 it is that of luma.
    pub chroma_stride: usize,
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
    /// Rotation of the head as a unit quaternion. Its yaw is 0.9 of that which the landmarks show.
    pub rotation_xyzw: [f32; 4],
    /// The rotation that the landmarks show, for what is drawn over the face.
    pub apparent_rotation_xyzw: [f32; 4],
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
            apparent_rotation_xyzw: face.head.apparent_rotation_xyzw(),
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

/// The version of the library, such as "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn facewire_version() -> *const c_char {
    VERSION.as_ptr().cast()
}

static VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");

/// The options of the service.
const DEFAULTS: Options = Options {
    struct_size: size_of::<Options>(),
    max_faces: 1,
    threads: 1,
    flags: 0,
    method: FACEWIRE_NETWORK,
    horizontal_fov_deg: 60.0,
    focal_length_px: 0.0,
    eye_distance_mm: 63.0,
    profile: ptr::null(),
    settings: ptr::null(),
    model: ptr::null(),
    networks: ptr::null(),
};
/// The size of the first version, whose last field is `networks`. Later ones are larger.
const FIRST_OPTIONS_BYTES: usize = offset_of!(Options, networks) + size_of::<*const c_char>();
/// No version is larger.
const MAX_OPTIONS_BYTES: usize = 4096;

/// Fills options with those of the service. `struct_size` is sizeof(struct facewire_options).
///
/// # Safety
/// The pointer is NULL or leads to so many bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_default_options(options: *mut Options, struct_size: usize) {
    if options.is_null() || struct_size > MAX_OPTIONS_BYTES {
        return;
    }
    let defaults = Options { struct_size, ..DEFAULTS };
    let known = struct_size.min(size_of::<Options>());
    let options = options.cast::<u8>();
    // SAFETY: the caller promises that there are `struct_size` bytes, and no more than `known` are taken of the defaults.
    unsafe {
        options.write_bytes(0, struct_size);
        options.copy_from_nonoverlapping((&raw const defaults).cast(), known);
    }
}

/// Returns the options of a program that was compiled with this or another version of the header.
///
/// # Safety
/// The pointer leads to as many bytes as its struct_size says.
unsafe fn known_options(options: *const Options) -> Result<Options, &'static str> {
    let options = options.cast::<u8>();
    // SAFETY: every version begins with the size.
    let struct_size = unsafe { options.cast::<usize>().read_unaligned() };
    if !(FIRST_OPTIONS_BYTES..=MAX_OPTIONS_BYTES).contains(&struct_size) {
        return Err("the options were not filled by facewire_default_options()");
    }
    let known = struct_size.min(size_of::<Options>());
    // SAFETY: the caller promises that there are `struct_size` bytes.
    let unknown = unsafe { std::slice::from_raw_parts(options.add(known), struct_size - known) };
    if unknown.iter().any(|byte| *byte != 0) {
        return Err("the program sets an option of a later version of facewire");
    }
    let mut found = DEFAULTS;
    // SAFETY: `known` is at most the size of either side.
    unsafe { (&raw mut found).cast::<u8>().copy_from_nonoverlapping(options, known) };
    Ok(found)
}

/// Makes a tracker. Returns NULL after an error, and writes its message with a 0 at the end into `message_bytes` bytes at
/// `message`, unless that is NULL. `options` can be NULL.
///
/// A tracker belongs to the process that made it. In a child that this process forks, every call for it is an error, and
/// facewire_close() does nothing.
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
    let options = if options.is_null() { Ok(DEFAULTS) } else { unsafe { known_options(options) } };
    // SAFETY: the caller promises that the texts end with a 0.
    let opened = options.map_err(str::to_owned).and_then(|options| unsafe { open(&options) });
    match opened {
        Ok(inner) => {
            let message = [0; FACEWIRE_MESSAGE_BYTES];
            Box::into_raw(Box::new(Tracker { inner, message, process: process::id() }))
        }
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
    // SAFETY: the caller promises that the texts end with a 0.
    let text = |text: *const c_char| unsafe { text_of(text) };
    let is_set = |flag: u32| options.flags & flag != 0;
    if options.flags & !FLAGS != 0 {
        return Err("flags has a bit without a meaning".to_owned());
    }
    let mut chosen = if is_set(FACEWIRE_STILLS) { Chosen::for_stills() } else { Chosen::default() };
    chosen = chosen
        .max_faces(options.max_faces as usize)
        .threads(options.threads)
        .method(method(options.method)?)
        .horizontal_fov_deg(options.horizontal_fov_deg)
        .eye_distance_mm(options.eye_distance_mm)
        .smoothing(!is_set(FACEWIRE_UNSMOOTHED))
        .shaping(shaping(options.flags, text(options.settings)?)?);
    if options.focal_length_px != 0.0 {
        chosen = chosen.focal_length_px(options.focal_length_px);
    }
    if is_set(FACEWIRE_MEAN_NEUTRAL) {
        chosen = chosen.neutral(NeutralMode::Off);
    }
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

fn told(error: Error) -> String {
    let flag = match error {
        Error::UnusedFilters { stills: true } => "FACEWIRE_STILLS",
        Error::UnusedFilters { stills: false } => "FACEWIRE_UNSMOOTHED",
        error => return error.to_string(),
    };
    format!("the settings configure filters in [smoothing], but {flag} switches all filters off")
}

fn method(number: u32) -> Result<Method, String> {
    match number {
        FACEWIRE_NETWORK => Ok(Method::Network),
        FACEWIRE_PAPER => Ok(Method::Paper),
        _ => Err("there is no such method".to_owned()),
    }
}

/// What these flags and this text make of coefficients.
fn shaping(flags: u32, settings: Option<&str>) -> Result<Shaping, String> {
    let mut shaping = settings.map_or_else(|| Ok(default_shaping()), parse_shaping).map_err(told)?;
    shaping.adjustments.mirror |= flags & FACEWIRE_MIRROR != 0;
    Ok(shaping)
}

/// # Safety
/// The text is null or ends with a 0.
unsafe fn text_of<'a>(text: *const c_char) -> Result<Option<&'a str>, String> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller promises that the text ends with a 0.
    let text = unsafe { CStr::from_ptr(text) }.to_str();
    Ok(Some(text.map_err(|_| "a text is not UTF-8".to_owned())?))
}

/// Runs a call for a tracker: returns -1 after an error, and keeps its message. In a child of the process that made the tracker,
/// nothing but the message is touched, because another thread may have been at work when the process forked.
///
/// # Safety
/// The pointer is null or leads to a tracker that no other thread uses.
unsafe fn call(tracker: *mut Tracker, run: impl FnOnce(&mut FaceTracker) -> Result<usize, String>) -> i32 {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    let Some(Tracker { inner, message, process }) = (unsafe { tracker.as_mut() }) else { return -1 };
    message.fill(0);
    let done = if *process == process::id() { run(inner) } else { Err(FORKED.to_owned()) };
    match done {
        Ok(count) => i32::try_from(count).unwrap_or(i32::MAX),
        Err(error) => {
            write_message(&error, message);
            -1
        }
    }
}

const FORKED: &str = "the process that made this tracker has forked: make a tracker in the child";

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
    let run = |tracker: &mut FaceTracker| {
        // SAFETY: the caller promises that the pointer is null or leads to a picture, whose data has as many bytes as it says.
        let picture = unsafe { picture.as_ref() }.ok_or("there is no picture")?;
        // SAFETY: as above.
        let picture = unsafe { picture_of(picture) }?;
        tracker.process_all(&picture, Duration::from_micros(time_us)).map(drop).map_err(told)?;
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
        Ok(written)
    };
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { call(tracker, run) }
}

/// # Safety
/// The data are null or as many bytes as the picture tells.
unsafe fn picture_of(picture: &Picture) -> Result<facewire_library::Picture<'_>, String> {
    let format = usize::try_from(picture.format).ok().and_then(|format| Format::ALL.get(format).copied());
    let format = format.ok_or("there is no such format")?;
    // SAFETY: the caller promises that there are so many.
    let data = unsafe { plane(picture.data, picture.bytes) }.ok_or("the picture has no data")?;
    let size = [picture.width as usize, picture.height as usize];
    let stride = if picture.stride == 0 { format.row_bytes(size[0]) } else { picture.stride };
    let [first, second] = picture.chroma;
    let has_full_range = picture.is_video_range == 0;
    if first.is_null() {
        if !second.is_null() {
            return Err("chroma[1] is set, and chroma[0] is NULL".to_owned());
        }
        return format.padded_picture(data, size, stride, has_full_range).map_err(told);
    }
    // SAFETY: the caller promises that there are so many at each plane.
    let [first, second] = [first, second].map(|data| unsafe { plane(data, picture.chroma_bytes) });
    let first = first.ok_or("the picture has no chroma")?;
    let pixels = match (format, second) {
        (Format::Nv12, None) if [0, stride].contains(&picture.chroma_stride) => {
            Pixels::Nv12 { luma: data, chroma: first, stride }
        }
        (Format::I420 | Format::I422 | Format::I444, Some(second)) => {
            let shift = u8::from(format != Format::I444);
            let chroma_stride =
                if picture.chroma_stride == 0 { size[0].div_ceil(1 << shift) } else { picture.chroma_stride };
            let chroma_shift = [shift, u8::from(format == Format::I420)];
            Pixels::Planar { planes: [data, first, second], strides: [stride, chroma_stride], chroma_shift }
        }
        _ => return Err("the format does not have these planes of chroma".to_owned()),
    };
    let found = facewire_library::Picture::new(size[0], size[1], pixels, has_full_range);
    found.ok_or_else(|| {
        format!(
            "the planes are too short for a picture of {} x {} pixels, or a side is not 1 to {MAX_SIDE_PX} pixels long",
            size[0], size[1]
        )
    })
}

/// # Safety
/// The pointer is null or leads to so many bytes.
unsafe fn plane<'a>(data: *const u8, bytes: usize) -> Option<&'a [u8]> {
    if data.is_null() || bytes > isize::MAX.unsigned_abs() {
        return None;
    }
    // SAFETY: the pointer is not null, and the caller promises that there are so many bytes.
    Some(unsafe { std::slice::from_raw_parts(data, bytes) })
}

/// Makes the mean of `count` faces the neutral face of the wearer, who looks at the camera, at rest. This replaces the profile.
/// With several faces in the picture, those at `faces` have one id, which is in the last picture, and nobody else's neutral face
/// changes. Returns 0, or -1 after an error.
///
/// # Safety
/// The pointers lead to what they are said to lead to, and no other thread uses the tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_set_neutral(tracker: *mut Tracker, faces: *const Face, count: usize) -> i32 {
    let run = |tracker: &mut FaceTracker| {
        let count = if faces.is_null() { 0 } else { count };
        let restored = (0..count).map(|place| {
            let mut face = facewire_library::Face::default();
            // SAFETY: the caller promises that there are so many faces.
            let Face { id, landmarks, .. } = unsafe { faces.add(place).as_ref() }.copied()?;
            (face.id, face.landmarks.0) = (id, landmarks);
            Some(face)
        });
        let restored: Vec<_> = restored.flatten().collect();
        tracker.set_neutral(&restored).map(|()| 0).map_err(told)
    };
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { call(tracker, run) }
}

/// Writes what is known of the wearer whose face has this id in the last picture, or of the first face if `id` is 0: the profile
/// that was given, or the neutral face that was estimated, once the wearer is known well enough. The text is that of a file by
/// `facewire calibrate`, and has at most FACEWIRE_PROFILE_BYTES with the 0 at its end. Returns its length, 0 if not enough is
/// known, or -1 after an error, such as an id that is not in the last picture.
///
/// # Safety
/// The pointers lead to what they are said to lead to, and no other thread uses the tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_profile(tracker: *mut Tracker, id: u64, text: *mut c_char, bytes: usize) -> i32 {
    let run = |tracker: &mut FaceTracker| {
        if id != 0 && tracker.faces().all(|face| face.id != id) {
            return Err(missing(id));
        }
        let known = if id == 0 { tracker.profile() } else { tracker.profile_of(id) };
        let found = known.as_ref().and_then(profile_text).unwrap_or_default();
        let bytes = if text.is_null() { 0 } else { bytes };
        if !found.is_empty() && bytes <= found.len() {
            return Err(format!("the profile takes {} bytes", found.len() + 1));
        }
        if bytes > 0 {
            // SAFETY: the caller promises that so many bytes can be written there.
            write_message(&found, unsafe { std::slice::from_raw_parts_mut(text.cast(), bytes) });
        }
        Ok(found.len())
    };
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { call(tracker, run) }
}

/// Replaces the profile of the face with this id in the last picture, or of the first face if `id` is 0, by a text of
/// facewire_profile() or of a file by `facewire calibrate`. NULL takes the profile away. Coefficients do not jump. A profile of
/// the first face remains after facewire_reset(), and so does what facewire_set_neutral() gives if max_faces is 1.
/// Returns 0, or -1 after an error.
///
/// # Safety
/// The pointers lead to what they are said to lead to, and no other thread uses the tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_set_profile(tracker: *mut Tracker, id: u64, text: *const c_char) -> i32 {
    let run = |tracker: &mut FaceTracker| {
        // SAFETY: the caller promises that the text ends with a 0.
        let text = unsafe { text_of(text) }?;
        let profile = text.map_or_else(|| Ok(Profile::default()), parse_profile).map_err(told)?;
        if id == 0 {
            tracker.set_profile(&profile);
        } else if !tracker.set_profile_of(id, &profile) {
            return Err(missing(id));
        }
        Ok(0)
    };
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { call(tracker, run) }
}

fn missing(id: u64) -> String {
    format!("face {id} is not in the last picture")
}

/// What went wrong in the last call that returned a number; empty if nothing did. The text belongs to the tracker, and changes
/// with the next call.
///
/// # Safety
/// The pointer is NULL or leads to a tracker.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_message(tracker: *const Tracker) -> *const c_char {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { tracker.as_ref() }.map_or(c"there is no tracker".as_ptr(), |tracker| tracker.message.as_ptr().cast())
}

/// Forgets all faces, what was learned of them and their profiles, but that of the first face: facewire_set_profile() takes it
/// away.
///
/// # Safety
/// The pointer is NULL or leads to a tracker that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_reset(tracker: *mut Tracker) {
    let run = |tracker: &mut FaceTracker| {
        tracker.reset();
        Ok(0)
    };
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    unsafe { call(tracker, run) };
}

/// Frees a tracker. NULL is none. Does nothing in a child of the process that made the tracker.
///
/// # Safety
/// The pointer is NULL or was returned by facewire_open(), and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn facewire_close(tracker: *mut Tracker) {
    // SAFETY: the caller promises that the pointer is null or leads to a tracker.
    if unsafe { tracker.as_ref() }.is_some_and(|tracker| tracker.process == process::id()) {
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
