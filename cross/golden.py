#!/usr/bin/env python3
"""Compares landmarks of `facewire track demo` with those that MediaPipe finds, and prints their distances.

golden.py MEDIAPIPE.npy BOARD.npy: the first file holds every 8th frame in steps of 1/32 px (tests/golden/make.py), the
second one every frame in pixels. Exit status 1 if a frame has no face or a distance exceeds the limits of
tests/golden.rs.
"""

import array
import ast
import math
import struct
import sys

EVERY = 8
STEPS = 32
MEAN_PX = 0.3
WORST_PX = 1.5


def frames(path, scale):
    """Returns the points of each frame, in pixels, from a .npy file of format version 1."""
    with open(path, "rb") as file:
        magic, length = struct.unpack("<8sH", file.read(10))
        header = ast.literal_eval(file.read(length).decode("ascii"))
        values = array.array({"<i2": "h", "<f4": "f"}[header["descr"]], file.read())
    count, points, axes = header["shape"]
    if magic != b"\x93NUMPY\x01\x00" or header["fortran_order"] or axes != 3 or len(values) != count * points * axes:
        sys.exit(f"{path} holds no landmarks")
    scaled = [value / scale for value in values]
    found = [tuple(scaled[at:at + axes]) for at in range(0, len(scaled), axes)]
    return [found[at:at + points] for at in range(0, len(found), points)]


def main():
    """Compares the files that the command line names."""
    golden, board = frames(sys.argv[1], STEPS), frames(sys.argv[2], 1)[::EVERY]
    pairs = [pair for ours, theirs in zip(board, golden) for pair in zip(ours, theirs)]
    if [len(frame) for frame in board] != [len(frame) for frame in golden]:
        print(f"{len(board)} frames of landmarks, expected {len(golden)}")
        return 1
    distances = [math.dist(ours[:2], theirs[:2]) for ours, theirs in pairs]
    depths = [abs(ours[2] - theirs[2]) for ours, theirs in pairs]
    # The landmarks of a frame without a face are not numbers, and neither is the mean then.
    mean, worst, worst_depth = sum(distances) / len(distances), max(distances), max(depths)
    print(f"  landmarks in {len(board)} frames, distance from MediaPipe's: "
          f"mean {mean:.3f} px, worst {worst:.2f} px, in depth {worst_depth:.2f} px")
    return 0 if mean <= MEAN_PX and worst <= WORST_PX and worst_depth <= WORST_PX else 1


if __name__ == "__main__":
    sys.exit(main())
