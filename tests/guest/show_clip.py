#!/usr/bin/env python3
"""Feeds frames of the built-in clip to a camera, one by one: the next follows once a packet has the pose of the last.

show_clip.py CAMERA FILM.avi PACKETS.csv SHOWN.csv FRAME...

CAMERA is uvc, for the USB webcam, or mjpeg or yuyv, for a v4l2loopback camera with this format. PACKETS.csv is what
tests/packet_recorder.py records. When all frames have been shown, this program writes each frame into SHOWN.csv, with the time of
capture in its packet. It then repeats the last frame until it is killed.
"""

import csv
import fcntl
import os
import re
import struct
import subprocess
import sys
import time

from receivers import await_that

# A frame is shown again until a packet has its pose: the service may have missed it, a neutral face needs three poses in a row,
# and a face that was lost is searched for in the next frame. The pause before it is shown again is AGAIN_S or, on a slow machine,
# AGAIN_TIMES the longest time that a frame has taken, but at most AGAIN_AT_LAST_S, so that the camera does not seem stuck.
AGAIN_S, AGAIN_TIMES, AGAIN_AT_LAST_S = 1, 1.5, 15
SIZE = (640, 480)
# struct v4l2_format: the type for output, and its fields up to the colour space.
SET_FORMAT, OUTPUT, FORMAT_BYTES = 0xC0D05605, 2, 208


def jpegs(film):
    """The frames of a Motion-JPEG AVI."""
    with open(film, "rb") as file:
        data = file.read()
    starts = [match.end() for match in re.finditer(rb"00dc.{4}(?=\xff\xd8)", data, re.DOTALL)]
    return [data[at:at + struct.unpack_from("<I", data, at - 4)[0]] for at in starts]


def decoded(pictures):
    """These JPEG pictures in YUYV."""
    command = ["ffmpeg", "-v", "error", "-f", "mjpeg", "-i", "-", "-f", "rawvideo", "-pix_fmt", "yuyv422", "-"]
    raw = subprocess.run(command, input=b"".join(pictures), stdout=subprocess.PIPE, check=True).stdout
    size = len(raw) // len(pictures)
    return [raw[start:start + size] for start in range(0, len(raw), size)]


class Webcam:
    """The USB webcam."""

    fifo = "/run/show-clip"

    def __init__(self, film):
        os.mkfifo(self.fifo)
        subprocess.run(["uvc-camera", "plug", film, self.fifo], check=True)
        self.asked = open(self.fifo, "w", buffering=1)

    def show(self, number):
        """Makes the webcam send a frame."""
        print(number, file=self.asked)


class Loopback:
    """The v4l2loopback camera. It is a camera once it has a frame."""

    def __init__(self, film, name, numbers):
        options = ["video_nr=0", "exclusive_caps=1", "max_buffers=8", "card_label=Loopback camera"]
        subprocess.run(["modprobe", "v4l2loopback", *options], check=True)
        pictures = jpegs(film)
        pictures = [pictures[number] for number in numbers]
        self.frames = dict(zip(numbers, decoded(pictures) if name == "yuyv" else pictures))
        code, line_bytes, colours = {"mjpeg": (b"MJPG", 0, 7), "yuyv": (b"YUYV", SIZE[0] * 2, 8)}[name]
        fields = (*SIZE, *struct.unpack("=I", code), 1, line_bytes, SIZE[0] * SIZE[1] * 2, colours)
        self.device = open("/dev/video0", "wb", buffering=0)
        fcntl.ioctl(self.device, SET_FORMAT, bytearray(struct.pack("=II7I", OUTPUT, 0, *fields).ljust(FORMAT_BYTES, b"\0")))

    def show(self, number):
        """Sends a frame."""
        self.device.write(self.frames[number])


class Poses:
    """Reads the recorded packets that have a pose, as they come."""

    def __init__(self, path):
        self.file, self.rest = open(path), ""

    def captured_since(self, shown_us):
        """Returns the time of capture in the first new packet whose pose was captured after this time, or None."""
        *rows, self.rest = (self.rest + self.file.read()).split("\n")
        cells = [row.split(",") for row in rows]
        times_us = [int(row[5]) for row in cells if row[1] == "live"]
        # The packets' clock has 32 bits.
        return next((time_us for time_us in times_us if (time_us - shown_us) % (1 << 32) < 1 << 31), None)


class Screen:
    """Shows frames to a camera. `slowest_s` is the longest time that it took from showing a frame to the packet with its pose."""

    def __init__(self, camera, poses):
        self.camera, self.poses, self.slowest_s = camera, poses, 0.0

    def show(self, number):
        """Shows a frame until a packet gives its pose; returns the time of capture in it."""
        begun, due = time.monotonic(), 0.0

        def captured():
            nonlocal due
            if time.monotonic() >= due:
                self.camera.show(number)
                due = time.monotonic() + min(max(AGAIN_S, AGAIN_TIMES * self.slowest_s), AGAIN_AT_LAST_S)
            return self.poses.captured_since(int(begun * 1e6))

        captured_us = await_that(f"the pose of frame {number}", captured)
        self.slowest_s = max(self.slowest_s, time.monotonic() - begun)
        return captured_us


def main():
    """Shows the frames."""
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    name, film, packets, shown = sys.argv[1:5]
    numbers = [int(number) for number in sys.argv[5:]]
    camera = Webcam(film) if name == "uvc" else Loopback(film, name, numbers)
    screen = Screen(camera, Poses(packets))
    rows = [(number, screen.show(number)) for number in numbers]
    with open(f"{shown}.new", "w", newline="") as file:
        csv.writer(file).writerows([("frame", "capture_us"), *rows])
    os.rename(f"{shown}.new", shown)
    while True:
        time.sleep(AGAIN_S)
        camera.show(numbers[-1])


if __name__ == "__main__":
    main()
