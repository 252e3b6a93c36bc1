#!/usr/bin/env python3
"""Decodes facewire packets of version 1 from UDP, written from packet/README.md alone. COBS is here for its importers.

It shares no code with the sender, so that the two check each other. As a program it listens for a while and writes one
CSV row per valid packet; its last line on standard error counts packets, losses and refusals.
Exit status 1: not one valid packet came.
"""

import argparse
import contextlib
import csv
import socket
import struct
import sys
import time

PACKET_BYTES = 132
STATES = ["live", "hold", "decay", "neutral"]
NEUTRAL_FACES = ["mean", "estimated", "calibrated", "mean"]
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
HEADER = ["received_s", "state", "reason", "sequence", "age_ms", "capture_us", "qx", "qy", "qz", "qw",
          "x_mm", "y_mm", "z_mm", *NAMES]


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
    return {
        "state": STATES[flags & 3],
        "reason": REASONS[flags >> 4],
        "neutral_face": NEUTRAL_FACES[flags >> 2 & 3],
        "sequence": sequence,
        "age_ms": age / 10,
        "capture_us": capture_us,
        "rotation": [value / 32767 for value in struct.unpack_from("<4h", data, 12)],
        "position_mm": list(struct.unpack_from("<3h", data, 20)),
        "coefficients": [value / 65535 for value in struct.unpack_from("<52H", data, 26)],
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


def listen(port, seconds, host=""):
    """Yields (receive time, datagram) until `seconds` have passed."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as server:
        server.bind((host, port))
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            server.settimeout(left)
            with contextlib.suppress(TimeoutError):
                yield time.monotonic(), server.recv(65536)


def row(received_s, packet):
    """The packet as cells of the CSV, under HEADER."""
    cells = [f"{received_s:.6f}"]
    cells += [packet[key] for key in ("state", "reason", "sequence", "age_ms", "capture_us")]
    cells += [f"{value:.6f}" for value in packet["rotation"]]
    cells += packet["position_mm"]
    cells += [f"{value:.6f}" for value in packet["coefficients"]]
    return cells


def record(datagrams, out):
    """Writes valid packets as CSV; returns counts of packets, losses (gaps in the sequence) and refusals."""
    writer = csv.writer(out)
    writer.writerow(HEADER)
    out.flush()
    counts = {"packets": 0, "lost": 0, "refused": 0}
    last = None
    for received_s, data in datagrams:
        try:
            packet = decode(data)
        except ValueError as error:
            counts["refused"] += 1
            print(f"refused: {error}", file=sys.stderr)
            continue
        if last is not None:
            counts["lost"] += (packet["sequence"] - last - 1) % 65536
        last = packet["sequence"]
        counts["packets"] += 1
        writer.writerow(row(received_s, packet))
        out.flush()
    return counts


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=5252)
    parser.add_argument("--host", default="", help="address to listen on (default: all of IPv4)")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--csv", default="-", help="file to write, - is standard output")
    args = parser.parse_args()
    target = contextlib.nullcontext(sys.stdout) if args.csv == "-" else open(args.csv, "w", newline="")
    with target as out:
        counts = record(listen(args.port, args.seconds, args.host), out)
    print(" ".join(f"{name} {count}" for name, count in counts.items()), file=sys.stderr)
    return 0 if counts["packets"] else 1


if __name__ == "__main__":
    sys.exit(main())
