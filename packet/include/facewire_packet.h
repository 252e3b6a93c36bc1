/* The facewire packet, version 1, for receivers. SPDX-License-Identifier: MIT OR Apache-2.0
 *
 * C99 or C++11, no libraries, no floating point, no allocation. A UDP datagram holds one packet of 132 bytes:
 *
 *     struct facewire_packet packet;
 *     if (facewire_decode(bytes, length, &packet) == FACEWIRE_OK) {
 *         jaw_us = 1000 + packet.coefficients[FACEWIRE_JAW_OPEN] * 1000L / FACEWIRE_COEFFICIENT_ONE;
 *     }
 *
 * A serial line carries each packet as a COBS frame that ends with its only zero byte. Pass every received byte on:
 *
 *     static struct facewire_line line;
 *     if (facewire_feed(&line, byte, &packet) == FACEWIRE_OK) { ... }
 *
 * If no valid packet arrives for FACEWIRE_SILENCE_MS, the receiver must move to neutral on its own: all coefficients 0,
 * rotation identity, at a speed that its mechanics can bear.
 */
#ifndef FACEWIRE_PACKET_H
#define FACEWIRE_PACKET_H

#include <stddef.h>
#include <stdint.h>

#define FACEWIRE_PACKET_BYTES 132
#define FACEWIRE_VERSION 1
#define FACEWIRE_SILENCE_MS 500
/* The integers that represent 1.0 in a coefficient and in a component of the quaternion. */
#define FACEWIRE_COEFFICIENT_ONE 65535
#define FACEWIRE_ROTATION_ONE 32767

/* How much the sender trusts the pose. */
enum facewire_state {
    FACEWIRE_LIVE = 0,
    FACEWIRE_HOLD = 1,
    FACEWIRE_DECAY = 2,
    FACEWIRE_NEUTRAL = 3
};

/* Why the sender is not live. */
enum facewire_reason {
    FACEWIRE_REASON_NONE = 0,
    FACEWIRE_REASON_NO_FACE = 1,
    FACEWIRE_REASON_NO_CAMERA = 2,
    FACEWIRE_REASON_LATE = 3,
    FACEWIRE_REASON_BAD_RESULT = 4,
    FACEWIRE_REASON_STOPPING = 5
};

/* The neutral face from which the sender measures expressions. */
enum facewire_neutral_face {
    FACEWIRE_NEUTRAL_FACE_MEAN = 0,      /* of many people */
    FACEWIRE_NEUTRAL_FACE_ESTIMATED = 1, /* the wearer's, estimated while watching */
    FACEWIRE_NEUTRAL_FACE_CALIBRATED = 2 /* the wearer's, from a calibration */
};

/* The return values of facewire_decode() and facewire_feed(). */
enum facewire_result {
    FACEWIRE_MORE = 1, /* this byte ends no frame */
    FACEWIRE_OK = 0,
    FACEWIRE_BAD_LENGTH = -1,
    FACEWIRE_BAD_MAGIC = -2,
    FACEWIRE_BAD_VERSION = -3,
    FACEWIRE_BAD_CHECKSUM = -4,
    FACEWIRE_BAD_REASON = -5,
    FACEWIRE_CUT = -6 /* the frame is incomplete */
};

/* Indices of coefficients[]. Left and right are the person's own. */
enum facewire_blendshape {
    FACEWIRE_EYE_BLINK_LEFT = 0,
    FACEWIRE_EYE_LOOK_DOWN_LEFT,
    FACEWIRE_EYE_LOOK_IN_LEFT,
    FACEWIRE_EYE_LOOK_OUT_LEFT,
    FACEWIRE_EYE_LOOK_UP_LEFT,
    FACEWIRE_EYE_SQUINT_LEFT,
    FACEWIRE_EYE_WIDE_LEFT,
    FACEWIRE_EYE_BLINK_RIGHT,
    FACEWIRE_EYE_LOOK_DOWN_RIGHT,
    FACEWIRE_EYE_LOOK_IN_RIGHT,
    FACEWIRE_EYE_LOOK_OUT_RIGHT,
    FACEWIRE_EYE_LOOK_UP_RIGHT,
    FACEWIRE_EYE_SQUINT_RIGHT,
    FACEWIRE_EYE_WIDE_RIGHT,
    FACEWIRE_JAW_FORWARD,
    FACEWIRE_JAW_LEFT,
    FACEWIRE_JAW_RIGHT,
    FACEWIRE_JAW_OPEN,
    FACEWIRE_MOUTH_CLOSE,
    FACEWIRE_MOUTH_FUNNEL,
    FACEWIRE_MOUTH_PUCKER,
    FACEWIRE_MOUTH_LEFT,
    FACEWIRE_MOUTH_RIGHT,
    FACEWIRE_MOUTH_SMILE_LEFT,
    FACEWIRE_MOUTH_SMILE_RIGHT,
    FACEWIRE_MOUTH_FROWN_LEFT,
    FACEWIRE_MOUTH_FROWN_RIGHT,
    FACEWIRE_MOUTH_DIMPLE_LEFT,
    FACEWIRE_MOUTH_DIMPLE_RIGHT,
    FACEWIRE_MOUTH_STRETCH_LEFT,
    FACEWIRE_MOUTH_STRETCH_RIGHT,
    FACEWIRE_MOUTH_ROLL_LOWER,
    FACEWIRE_MOUTH_ROLL_UPPER,
    FACEWIRE_MOUTH_SHRUG_LOWER,
    FACEWIRE_MOUTH_SHRUG_UPPER,
    FACEWIRE_MOUTH_PRESS_LEFT,
    FACEWIRE_MOUTH_PRESS_RIGHT,
    FACEWIRE_MOUTH_LOWER_DOWN_LEFT,
    FACEWIRE_MOUTH_LOWER_DOWN_RIGHT,
    FACEWIRE_MOUTH_UPPER_UP_LEFT,
    FACEWIRE_MOUTH_UPPER_UP_RIGHT,
    FACEWIRE_BROW_DOWN_LEFT,
    FACEWIRE_BROW_DOWN_RIGHT,
    FACEWIRE_BROW_INNER_UP,
    FACEWIRE_BROW_OUTER_UP_LEFT,
    FACEWIRE_BROW_OUTER_UP_RIGHT,
    FACEWIRE_CHEEK_PUFF,
    FACEWIRE_CHEEK_SQUINT_LEFT,
    FACEWIRE_CHEEK_SQUINT_RIGHT,
    FACEWIRE_NOSE_SNEER_LEFT,
    FACEWIRE_NOSE_SNEER_RIGHT,
    FACEWIRE_TONGUE_OUT,
    FACEWIRE_BLENDSHAPES
};

struct facewire_packet {
    uint8_t state;       /* enum facewire_state */
    uint8_t reason;      /* enum facewire_reason */
    uint8_t neutral_face; /* enum facewire_neutral_face */
    uint16_t sequence;   /* increases by one with each packet and wraps; a gap means lost packets */
    uint16_t age;        /* time from capture to sending in 0.1 ms; saturates */
    uint32_t capture_us; /* capture time on the sender's monotonic clock; wraps */
    int16_t rotation[4]; /* quaternion x y z w times 32767; axes x to the person's left, y up, z out of the face */
    int16_t position_mm[3]; /* in camera coordinates: x right in the picture, y down, z away from the camera */
    uint16_t coefficients[FACEWIRE_BLENDSHAPES]; /* times 65535 */
};

static inline uint16_t facewire_u16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (uint16_t)bytes[1] << 8);
}

static inline int16_t facewire_i16(const uint8_t *bytes) {
    return (int16_t)facewire_u16(bytes);
}

/* CRC-16/MCRF4XX. */
static inline uint16_t facewire_crc(const uint8_t *bytes, size_t length) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint16_t)(crc & 1 ? crc >> 1 ^ 0x8408 : crc >> 1);
        }
    }
    return crc;
}

/* Checks length, magic number, version, checksum and reason. Returns an enum facewire_result. */
static inline int facewire_verify(const uint8_t *bytes, size_t length) {
    if (length != FACEWIRE_PACKET_BYTES) return FACEWIRE_BAD_LENGTH;
    if (bytes[0] != 0x46 || bytes[1] != 0x57) return FACEWIRE_BAD_MAGIC;
    if (bytes[2] != FACEWIRE_VERSION) return FACEWIRE_BAD_VERSION;
    if (facewire_u16(bytes + 130) != facewire_crc(bytes, 130)) return FACEWIRE_BAD_CHECKSUM;
    if (bytes[3] >> 4 > FACEWIRE_REASON_STOPPING) return FACEWIRE_BAD_REASON;
    return FACEWIRE_OK;
}

/* Decodes a packet. On failure returns a negative enum facewire_result and leaves `packet` unchanged. */
static inline int facewire_decode(const uint8_t *bytes, size_t length, struct facewire_packet *packet) {
    int result = facewire_verify(bytes, length);
    if (result != FACEWIRE_OK) return result;
    packet->state = bytes[3] & 3;
    packet->reason = bytes[3] >> 4;
    packet->neutral_face = bytes[3] >> 2 & 3;
    if (packet->neutral_face == 3) packet->neutral_face = FACEWIRE_NEUTRAL_FACE_MEAN; /* reserved */
    packet->sequence = facewire_u16(bytes + 4);
    packet->age = facewire_u16(bytes + 6);
    packet->capture_us = facewire_u16(bytes + 8) | (uint32_t)facewire_u16(bytes + 10) << 16;
    for (int i = 0; i < 4; i++) packet->rotation[i] = facewire_i16(bytes + 12 + 2 * i);
    for (int i = 0; i < 3; i++) packet->position_mm[i] = facewire_i16(bytes + 20 + 2 * i);
    for (int i = 0; i < FACEWIRE_BLENDSHAPES; i++) packet->coefficients[i] = facewire_u16(bytes + 26 + 2 * i);
    return FACEWIRE_OK;
}

/* The current frame of a serial line. Initialise it with zeros. */
struct facewire_line {
    uint8_t bytes[FACEWIRE_PACKET_BYTES];
    uint8_t length; /* decoded bytes of the frame; stops counting at one more than a packet */
    uint8_t left;   /* 1 + remaining bytes of the COBS block; 0 before the frame's first byte */
};

static inline void facewire_keep(struct facewire_line *line, uint8_t byte) {
    if (line->length < FACEWIRE_PACKET_BYTES) line->bytes[line->length] = byte;
    if (line->length <= FACEWIRE_PACKET_BYTES) line->length++;
}

/* Processes the next byte of a serial line. Returns FACEWIRE_OK if the byte completes a packet, which is then stored in
 * `packet`, and FACEWIRE_MORE if the frame goes on. A negative enum facewire_result means that a frame has ended
 * without a valid packet; `packet` is then unchanged. */
static inline int facewire_feed(struct facewire_line *line, uint8_t byte, struct facewire_packet *packet) {
    uint8_t left = line->left;
    if (byte != 0) {
        if (left > 1) facewire_keep(line, byte);
        if (left == 1) facewire_keep(line, 0);
        line->left = left > 1 ? (uint8_t)(left - 1) : byte;
        return FACEWIRE_MORE;
    }
    uint8_t length = line->length;
    line->length = 0;
    line->left = 0;
    if (left == 0) return FACEWIRE_MORE; /* an empty frame */
    if (left > 1) return FACEWIRE_CUT;
    return facewire_decode(line->bytes, length, packet);
}

#endif
