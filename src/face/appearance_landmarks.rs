//! The landmarks at which the mesh network's feature map is sampled.
//!
//! The build script compiles this file, too.

/// The landmarks: lips, lids and irises, and the rest of the face without its outline, behind which the background lies.
/// With each landmark, its mirror image is in the list.
pub const APPEARANCE_LANDMARKS: [u16; 180] = [
    0, 1, 2, 3, 5, 6, 7, 9, 13, 14, 17, 33, 34, 36, 37, 39, 40, 46, 49, 50, 55, 61, 63, 66, 68, 69, 71, 78, 79, 80, 81,
    82, 84, 87, 88, 91, 95, 98, 104, 105, 108, 116, 117, 119, 121, 123, 133, 134, 135, 137, 138, 139, 140, 143, 144,
    145, 146, 147, 151, 153, 154, 155, 156, 157, 158, 159, 160, 161, 163, 170, 173, 175, 177, 178, 181, 185, 187, 188,
    191, 192, 193, 194, 200, 205, 208, 210, 212, 213, 215, 216, 217, 221, 223, 227, 246, 248, 249, 263, 264, 266, 267,
    269, 270, 276, 279, 280, 285, 291, 293, 296, 298, 299, 301, 308, 309, 310, 311, 312, 314, 317, 318, 321, 324, 327,
    333, 334, 337, 345, 346, 348, 350, 352, 362, 363, 364, 366, 367, 368, 369, 372, 373, 374, 375, 376, 380, 381, 382,
    383, 384, 385, 386, 387, 388, 390, 395, 398, 401, 402, 405, 409, 411, 412, 415, 416, 417, 418, 425, 428, 430, 432,
    433, 435, 436, 437, 441, 443, 447, 466, 468, 473,
];

/// Number of values of the map at each landmark.
pub const APPEARANCE_CHANNELS: usize = 32;
