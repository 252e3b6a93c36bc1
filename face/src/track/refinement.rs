//! Index tables and constants of the heads that refine lips, eyes and irises.
//!
//! The sources are the attention mesh network (the options of its custom operators) and the
//! `LandmarksRefinementCalculator` of the face graph in MediaPipe 0.10.14. When the networks
//! are installed, `models/networks/refinement.py` reads both and compares them with the
//! `const` lines of this file; it parses only the plain form that they have.
//!
//! A head replaces x and y of the mesh points in its list, in the order of the list, and
//! leaves z. Its crop is placed around the same points. Left and right are the person's own:
//! the right eye has the corners 33 and 133. MediaPipe's files name an eye by the side of the
//! picture.

/// Feature map of the mesh network: rows and columns.
pub(crate) const FEATURE_SIZE: usize = 48;

/// Feature map of the mesh network: channels.
pub(crate) const FEATURE_CHANNELS: usize = 32;

/// Cells of the feature map per sample of the 192 x 192 input.
pub(crate) const FEATURE_SCALE: f32 = 0.25;

/// Input of a head: rows and columns.
pub(crate) const CROP_SIZE: usize = 16;

/// Side of a crop divided by the side of the box around the points of its refinement network.
pub(crate) const CROP_SCALE: f32 = 1.5;

/// Angle of the line through a head's rotation points in its crop, in radians.
pub(crate) const TARGET_ANGLE: f32 = 0.0;

/// Points of the lips: the outer and the inner contour, then the ring beside each.
pub(crate) const LIPS: [u16; 80] = [
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409, 78, 95, 88, 178, 87, 14,
    317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415, 76, 77, 90, 180, 85, 16, 315, 404, 320, 307, 306,
    184, 74, 73, 72, 11, 302, 303, 304, 408, 62, 96, 89, 179, 86, 15, 316, 403, 319, 325, 292, 183, 42, 41, 38, 12,
    268, 271, 272, 407,
];

/// Corners of the mouth, whose line is level in the crop of the lips.
pub(crate) const LIPS_ROTATION: [u16; 2] = [61, 291];

/// Points of the right eye: the contour of the lids, the rings around it, the eyebrow.
pub(crate) const RIGHT_EYE: [u16; 71] = [
    33, 7, 163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173, 130, 25, 110, 24, 23, 22, 26, 112,
    243, 247, 30, 29, 27, 28, 56, 190, 226, 31, 228, 229, 230, 231, 232, 233, 244, 113, 225, 224, 223, 222, 221, 189,
    35, 124, 46, 53, 52, 65, 143, 111, 117, 118, 119, 120, 121, 128, 245, 156, 70, 63, 105, 66, 107, 55, 193,
];

/// Corners of the right eye, whose line is level in its crop.
pub(crate) const RIGHT_EYE_ROTATION: [u16; 2] = [33, 133];

/// Points of the left eye, in the order of their mirror images in [`RIGHT_EYE`].
pub(crate) const LEFT_EYE: [u16; 71] = [
    263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398, 359, 255, 339, 254, 253, 252, 256,
    341, 463, 467, 260, 259, 257, 258, 286, 414, 446, 261, 448, 449, 450, 451, 452, 453, 464, 342, 445, 444, 443, 442,
    441, 413, 265, 353, 276, 283, 282, 295, 372, 340, 346, 347, 348, 349, 350, 357, 465, 383, 300, 293, 334, 296, 336,
    285, 417,
];

/// Corners of the left eye, whose line is level in its crop.
pub(crate) const LEFT_EYE_ROTATION: [u16; 2] = [362, 263];

/// Points that the right eye adds to the mesh: the centre of the iris, then four on its edge.
pub(crate) const RIGHT_IRIS: [u16; 5] = [468, 469, 470, 471, 472];

/// Points that the left eye adds to the mesh, in the same order.
pub(crate) const LEFT_IRIS: [u16; 5] = [473, 474, 475, 476, 477];

/// Contour of the right eye, whose mean z all five points of the iris take.
pub(crate) const RIGHT_IRIS_DEPTH: [u16; 16] =
    [33, 7, 163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173];

/// Contour of the left eye, whose mean z all five points of the iris take.
pub(crate) const LEFT_IRIS_DEPTH: [u16; 16] =
    [263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398];
