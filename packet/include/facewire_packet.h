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
 * If no valid packet arrives for FACEWIRE_SILENCE_MS, a receiver must move to neutral on its own. This does it:
 *
 *     static struct facewire_receiver receiver;
 *     if (... == FACEWIRE_OK) facewire_receive(&receiver, &packet, millis());
 *     facewire_update(&receiver, millis());
 *     jaw_us = 1000 + facewire_shown(&receiver, FACEWIRE_JAW_OPEN) * 1000L / FACEWIRE_COEFFICIENT_ONE;
 */
#ifndef FACEWIRE_PACKET_H
#define FACEWIRE_PACKET_H

#include <stddef.h>
#include <stdint.h>

#define FACEWIRE_PACKET_BYTES 132
#define FACEWIRE_VERSION 1
#define FACEWIRE_SILENCE_MS 500
/* A receiver ignores a packet that is not newer than the one it shows, unless that one came this long ago. */
#define FACEWIRE_LATE_MS 250
/* The time in which a receiver moves to neutral, unless it names its own. */
#define FACEWIRE_TRAVEL_MS 500
/* The integers that represent 1.0 in a coefficient and in a component of the quaternion. */
#define FACEWIRE_COEFFICIENT_ONE 65535
/* The integer that represents a part of the face that is in view; below half of it, the part is covered. */
#define FACEWIRE_VISIBILITY_ONE 15
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

/* Indices of visibility[]. Left and right are the person's own. */
enum facewire_part {
    FACEWIRE_LEFT_EYE = 0,
    FACEWIRE_RIGHT_EYE,
    FACEWIRE_BROWS,
    FACEWIRE_MOUTH,  /* and jaw */
    FACEWIRE_CHEEKS, /* and nose */
    FACEWIRE_FACE,   /* the whole */
    FACEWIRE_PARTS
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
    uint8_t visibility[FACEWIRE_PARTS]; /* how much of each part of the face is in view, times 15 */
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

/* Takes visibility and neutral face, which a packet has in the lowest 4 bits of its first coefficients while a part of the face
 * is covered. Puts the highest 4 bits in their place, so that 0 and 1 are exact. */
static inline void facewire_extract(struct facewire_packet *packet) {
    for (int i = 0; i <= FACEWIRE_PARTS; i++) {
        uint16_t coefficient = packet->coefficients[i];
        uint8_t carried = (uint8_t)(coefficient & 15);
        if (i < FACEWIRE_PARTS) packet->visibility[i] = carried;
        else packet->neutral_face = carried & 3;
        packet->coefficients[i] = (uint16_t)((coefficient & 0xFFF0) | coefficient >> 12);
    }
    if (packet->neutral_face == 3) packet->neutral_face = FACEWIRE_NEUTRAL_FACE_MEAN; /* not used */
}

/* Decodes a packet. On failure returns a negative enum facewire_result and leaves `packet` unchanged. */
static inline int facewire_decode(const uint8_t *bytes, size_t length, struct facewire_packet *packet) {
    int result = facewire_verify(bytes, length);
    if (result != FACEWIRE_OK) return result;
    packet->state = bytes[3] & 3;
    packet->reason = bytes[3] >> 4;
    packet->sequence = facewire_u16(bytes + 4);
    packet->age = facewire_u16(bytes + 6);
    packet->capture_us = facewire_u16(bytes + 8) | (uint32_t)facewire_u16(bytes + 10) << 16;
    for (int i = 0; i < 4; i++) packet->rotation[i] = facewire_i16(bytes + 12 + 2 * i);
    for (int i = 0; i < 3; i++) packet->position_mm[i] = facewire_i16(bytes + 20 + 2 * i);
    for (int i = 0; i < FACEWIRE_BLENDSHAPES; i++) packet->coefficients[i] = facewire_u16(bytes + 26 + 2 * i);
    packet->neutral_face = bytes[3] >> 2 & 3;
    for (int i = 0; i < FACEWIRE_PARTS; i++) packet->visibility[i] = FACEWIRE_VISIBILITY_ONE;
    if (packet->neutral_face == 3) facewire_extract(packet);
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

/* Turns the packets of one sender into the face to show. Initialise it with zeros, which are the neutral face.
 *
 * The face is that of the newest packet. After FACEWIRE_SILENCE_MS without a packet it moves to neutral within `travel_ms`.
 * When packets come again, and when the first one comes, it moves from where it is to that of the packets within the same
 * time, so that it never jumps.
 *
 * A UDP datagram may arrive twice or after a later one. So a packet whose sequence number is not ahead of the newest one's
 * is ignored for FACEWIRE_LATE_MS. After this time any packet is taken, because a sender that has restarted counts from 0.
 * If two senders use one port, the face is that of the sender whose sequence is ahead, until it is silent for
 * FACEWIRE_LATE_MS or the other one overtakes it: give each sender a port of its own. */
struct facewire_receiver {
    uint16_t travel_ms;            /* may be set before the first packet; 0 means FACEWIRE_TRAVEL_MS */
    uint8_t receiving;             /* 0 after FACEWIRE_SILENCE_MS without a packet, and before the first one */
    struct facewire_packet packet; /* the newest one that was taken */
    /* The others are for the functions below. */
    uint32_t taken_ms;
    uint32_t updated_ms;
    uint32_t moved_ms; /* how long the current move has taken, at most travel_ms */
    uint16_t share;    /* how much of the current move is done, of FACEWIRE_ARRIVED */
    int16_t start_vector[3]; /* the face where the move began: x, y and z of a quaternion whose w is 0 or more */
    uint16_t start_coefficients[FACEWIRE_BLENDSHAPES];
};

/* The share of a finished move. */
#define FACEWIRE_ARRIVED ((int32_t)32768)
/* The longest time by which one call moves the face on, so that the face does not jump after a delay of the program. */
#define FACEWIRE_STEP_MS 100

/* The time from one moment to another, or 0 if the other one lies before it. Both may have wrapped. */
static inline uint32_t facewire_elapsed_ms(uint32_t from_ms, uint32_t to_ms) {
    uint32_t elapsed_ms = to_ms - from_ms;
    return elapsed_ms < 0x80000000UL ? elapsed_ms : 0;
}

/* The value between two others at the share of the current move that is done. */
static inline int32_t facewire_between(const struct facewire_receiver *receiver, int32_t start, int32_t end) {
    return start + (end - start) * (int32_t)receiver->share / FACEWIRE_ARRIVED;
}

/* Returns the coefficient to show, from 0 to 65535, as of the last facewire_update(). */
static inline uint16_t facewire_shown(const struct facewire_receiver *receiver, int blendshape) {
    uint16_t end = receiver->receiving ? receiver->packet.coefficients[blendshape] : 0;
    return (uint16_t)facewire_between(receiver, receiver->start_coefficients[blendshape], end);
}

/* A component of the newest rotation, with the sign that makes w at least 0. Both signs are the same rotation. */
static inline int16_t facewire_upright(const struct facewire_receiver *receiver, int component) {
    int32_t value = receiver->packet.rotation[component];
    if (value < -FACEWIRE_ROTATION_ONE) value = -FACEWIRE_ROTATION_ONE;
    return (int16_t)(receiver->packet.rotation[3] < 0 ? -value : value);
}

/* The square root, rounded down. */
static inline uint16_t facewire_root(uint32_t square) {
    uint16_t root = 0;
    for (uint16_t bit = 0x8000; bit > 0; bit = (uint16_t)(bit >> 1)) {
        uint16_t tried = (uint16_t)(root | bit);
        if ((uint32_t)tried * tried <= square) root = tried;
    }
    return root;
}

static inline int16_t facewire_shown_component(const struct facewire_receiver *receiver, int component) {
    int16_t end = receiver->receiving ? facewire_upright(receiver, component) : 0;
    return (int16_t)facewire_between(receiver, receiver->start_vector[component], end);
}

/* Writes the rotation to show, as in struct facewire_packet but with w of 0 or more, as of the last facewire_update(). */
static inline void facewire_shown_rotation(const struct facewire_receiver *receiver, int16_t rotation[4]) {
    uint32_t length = 0, one = (uint32_t)FACEWIRE_ROTATION_ONE * FACEWIRE_ROTATION_ONE;
    for (int i = 0; i < 3; i++) {
        rotation[i] = facewire_shown_component(receiver, i);
        length += (uint32_t)((int32_t)rotation[i] * rotation[i]);
    }
    if (receiver->receiving && receiver->share == FACEWIRE_ARRIVED) {
        rotation[3] = facewire_upright(receiver, 3);
    } else {
        rotation[3] = (int16_t)(length < one ? facewire_root(one - length) : 0);
    }
}

/* Begins to move from what is shown, to neutral or to the packets. */
static inline void facewire_begin_move(struct facewire_receiver *receiver, uint8_t receiving) {
    for (int i = 0; i < FACEWIRE_BLENDSHAPES; i++) receiver->start_coefficients[i] = facewire_shown(receiver, i);
    for (int i = 0; i < 3; i++) receiver->start_vector[i] = facewire_shown_component(receiver, i);
    receiver->receiving = receiving;
    receiver->moved_ms = 0;
    receiver->share = 0;
}

/* Continues the current move, and begins the one to neutral if packets have stopped. Call it before you read what to show,
 * at least once in 24 days. `now_ms` is in milliseconds from any moment and may wrap, as millis() does. */
static inline void facewire_update(struct facewire_receiver *receiver, uint32_t now_ms) {
    uint32_t step_ms = facewire_elapsed_ms(receiver->updated_ms, now_ms);
    uint16_t travel_ms = receiver->travel_ms > 0 ? receiver->travel_ms : FACEWIRE_TRAVEL_MS;
    receiver->updated_ms = now_ms;
    receiver->moved_ms += step_ms < FACEWIRE_STEP_MS ? step_ms : FACEWIRE_STEP_MS;
    if (receiver->moved_ms > travel_ms) receiver->moved_ms = travel_ms;
    receiver->share = (uint16_t)(receiver->moved_ms * (uint32_t)FACEWIRE_ARRIVED / travel_ms);
    if (receiver->receiving && facewire_elapsed_ms(receiver->taken_ms, now_ms) >= FACEWIRE_SILENCE_MS) {
        facewire_begin_move(receiver, 0);
    }
}

/* Takes a packet. Returns 0 if it is a duplicate or comes too late, and therefore is ignored. */
static inline int facewire_receive(struct facewire_receiver *receiver, const struct facewire_packet *packet, uint32_t now_ms) {
    facewire_update(receiver, now_ms);
    uint16_t ahead = (uint16_t)(packet->sequence - receiver->packet.sequence);
    int newer = ahead > 0 && ahead < 0x8000;
    if (receiver->receiving && !newer && facewire_elapsed_ms(receiver->taken_ms, now_ms) < FACEWIRE_LATE_MS) return 0;
    if (!receiver->receiving) facewire_begin_move(receiver, 1);
    receiver->packet = *packet;
    receiver->taken_ms = now_ms;
    return 1;
}

#endif
