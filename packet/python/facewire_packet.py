"""Reads facewire packets of version 1 and decides what to show. Needs nothing but Python 3.9 or later.

It is written from packet/README.md and shares no code with the sender, so that the two check each other.

    receiver = Receiver()
    receiver.receive(decode(datagram), time.monotonic())         # whenever a packet has come
    face = receiver.show(time.monotonic())                       # as often as you like
    print(face["coefficients"]["jawOpen"], face["rotation"], face["silent"])
"""

import math
import struct

PACKET_BYTES = 132
STATES = ["live", "hold", "decay", "neutral"]
NEUTRAL_FACES = ["mean", "estimated", "calibrated", "mean"]
PARTS = ["left_eye", "right_eye", "brows", "mouth", "cheeks", "face"]
REASONS = ["none", "no face", "no camera", "late", "bad result", "stopping"]
NAMES = """
eyeBlinkLeft eyeLookDownLeft eyeLookInLeft eyeLookOutLeft eyeLookUpLeft eyeSquintLeft eyeWideLeft
eyeBlinkRight eyeLookDownRight eyeLookInRight eyeLookOutRight eyeLookUpRight eyeSquintRight eyeWideRight
jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft mouthRight
mouthSmileLeft mouthSmileRight mouthFrownLeft mouthFrownRight mouthDimpleLeft mouthDimpleRight
mouthStretchLeft mouthStretchRight mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper
mouthPressLeft mouthPressRight mouthLowerDownLeft mouthLowerDownRight mouthUpperUpLeft mouthUpperUpRight
browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight cheekPuff cheekSquintLeft cheekSquintRight
noseSneerLeft noseSneerRight tongueOut
""".split()
# Without a packet for this long, the face moves to neutral.
SILENCE_S = 0.5
# A packet that is not newer is ignored, unless the newest one is this old.
LATE_S = 0.25
# The longest time by which one call moves the face on, so that the face does not jump after a delay of the program.
STEP_S = 0.1


def crc16_mcrf4xx(data):
    """CRC-16/MCRF4XX, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0x8408 if crc & 1 else crc >> 1
    return crc


def decode(data):
    """The packet as a dictionary; ValueError says why the bytes are not one."""
    if len(data) != PACKET_BYTES:
        raise ValueError(f"{len(data)} bytes instead of {PACKET_BYTES}")
    magic, version, flags, sequence, age, capture_us = struct.unpack_from("<2sBBHHI", data, 0)
    if magic != b"FW":
        raise ValueError(f"magic {magic!r}")
    if version != 1:
        raise ValueError(f"version {version}")
    if struct.unpack_from("<H", data, 130)[0] != crc16_mcrf4xx(data[:130]):
        raise ValueError("checksum")
    if flags >> 4 >= len(REASONS):
        raise ValueError(f"reason {flags >> 4}")
    coefficients = list(struct.unpack_from("<52H", data, 26))
    visibility, neutral_face = [15] * len(PARTS), flags >> 2 & 3
    if neutral_face == 3:  # a part is covered: the lowest 4 bits of the first coefficients carry these
        count = len(PARTS) + 1
        *visibility, neutral_face = [value & 15 for value in coefficients[:count]]
        coefficients[:count] = [value & 0xFFF0 | value >> 12 for value in coefficients[:count]]
    return {
        "state": STATES[flags & 3],
        "reason": REASONS[flags >> 4],
        "neutral_face": NEUTRAL_FACES[neutral_face & 3],
        "visibility": {part: value / 15 for part, value in zip(PARTS, visibility)},
        "sequence": sequence,
        "age_ms": age / 10,
        "capture_us": capture_us,
        "rotation": [value / 32767 for value in struct.unpack_from("<4h", data, 12)],
        "position_mm": list(struct.unpack_from("<3h", data, 20)),
        "coefficients": [value / 65535 for value in coefficients],
    }


def cobs_decode(frame):
    """The bytes behind a COBS frame, its closing zero taken off; ValueError if it is none."""
    data, at = b"", 0
    while at < len(frame):
        code = frame[at]
        if not code or at + code > len(frame):
            raise ValueError("the frame is not COBS")
        data += frame[at + 1:at + code]
        at += code
        if code < 255 and at < len(frame):
            data += b"\0"
    return data


class Receiver:
    """Turns the packets of one sender into the face to show.

    The face is that of the newest packet. After SILENCE_S without a packet it moves to neutral within `travel_s`, and
    from there to the face of the packets when they come again. Times are in seconds, as of time.monotonic().
    """

    def __init__(self, travel_s=0.5):
        self.travel_s = travel_s
        self.packet = None
        self.silent = True
        self.taken_s = self.updated_s = -math.inf
        self.moved_s = 0.0
        # x, y and z of the rotation and the coefficients, where the current move began.
        self.start = [0.0] * (3 + len(NAMES))

    def receive(self, packet, now_s):
        """Takes a packet. Returns False if it is a duplicate or comes too late, and therefore is ignored."""
        self._update(now_s)
        if not self.silent and now_s - self.taken_s < LATE_S:
            ahead = (packet["sequence"] - self.packet["sequence"]) % 65536
            if not 0 < ahead < 32768:
                return False
        if self.silent:
            self._begin_move(silent=False)
        self.packet, self.taken_s = packet, now_s
        return True

    def show(self, now_s):
        """The face now: whether packets have stopped, the rotation, and the coefficients by their names."""
        self._update(now_s)
        x, y, z, *values = self._shown()
        w = math.sqrt(max(0.0, 1.0 - x * x - y * y - z * z))
        return {"silent": self.silent, "rotation": [x, y, z, w], "coefficients": dict(zip(NAMES, values))}

    def _update(self, now_s):
        self.moved_s = min(self.moved_s + max(0.0, min(now_s - self.updated_s, STEP_S)), self.travel_s)
        self.updated_s = now_s
        if not self.silent and now_s - self.taken_s >= SILENCE_S:
            self._begin_move(silent=True)

    def _begin_move(self, silent):
        self.start, self.silent, self.moved_s = self._shown(), silent, 0.0

    def _shown(self):
        share = self.moved_s / self.travel_s if self.travel_s else 1.0
        return [start + (end - start) * share for start, end in zip(self.start, self._target())]

    def _target(self):
        if self.silent:
            return [0.0] * len(self.start)
        x, y, z, w = self.packet["rotation"]
        sign = -1 if w < 0 else 1
        return [sign * x, sign * y, sign * z, *self.packet["coefficients"]]
