"""Runs the first program of README.md on pictures in place of a camera's, and writes the coefficients of each picture as CSV.

ten_lines.py [--film FILM [--first N]] [--window WINDOW.jpg] README.md PICTURES.npy OUT.csv

The columns are those of `facewire track`. With a film, the pictures are written first, which needs PyAV or OpenCV. With --window,
what the program showed last is written by Pillow.
"""

import argparse
import csv
import itertools
import re
import sys

import numpy

import facewire

FRAMES = 48


class Ended(Exception):
    """There are no more pictures."""


class OpenCV:
    """Stands in for OpenCV: a camera, and a window that nobody closes."""

    CAP_V4L2, CAP_PROP_POS_MSEC = 200, 0

    def __init__(self, pictures):
        self.left, self.shown = iter(pictures), []

    def VideoCapture(self, *_):
        """Opens the camera."""
        return self

    def read(self):
        """Returns the next picture."""
        for picture in self.left:
            return True, picture.copy()
        raise Ended

    def get(self, _):
        """Knows no times."""
        return 0.0

    def release(self):
        """Closes the camera."""

    def imshow(self, _, picture):
        """Shows a picture in a window."""
        self.shown.append(picture.copy())

    def waitKey(self, _):
        """Waits for a key, which nobody presses."""
        return -1


def main():
    """Does what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--film")
    parser.add_argument("--first", type=int, default=0, help="the first frame of the film that is taken")
    parser.add_argument("--window")
    parser.add_argument("readme")
    parser.add_argument("pictures")
    parser.add_argument("out")
    args = parser.parse_args()
    if args.film:
        from facewire._film import _decode as decode

        frames = itertools.islice(decode(args.film), args.first, args.first + FRAMES)
        numpy.save(args.pictures, [picture for _, picture in frames])
    pictures = numpy.load(args.pictures)

    # The program says `import cv2`, opens a camera and shows a window.
    sys.modules["cv2"] = cv2 = OpenCV(pictures)
    with open(args.readme, encoding="utf-8") as file:
        program = re.search(r"```python\n(.*?)```", file.read(), re.DOTALL).group(1)
    printed = []
    try:
        exec(compile(program, args.readme, "exec"), {"print": lambda *what: printed.append(what)})
    except Ended:
        pass
    if len(printed) != len(pictures):
        sys.exit(f"the program printed {len(printed)} faces of {len(pictures)}")
    drawn = sum(bool((shown != picture).any()) for shown, picture in zip(cv2.shown, pictures))
    if drawn != len(pictures):
        sys.exit(f"the program drew a face into {drawn} pictures of {len(pictures)}")
    if args.window:
        import PIL.Image

        PIL.Image.fromarray(cv2.shown[-1][:, :, ::-1]).save(args.window, quality=85)

    tracker = facewire.FaceTracker()
    with open(args.out, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", "time_s", "state", *facewire.BLENDSHAPES, "head_yaw_deg", "head_pitch_deg", "head_roll_deg"])
        for number, picture in enumerate(pictures):
            face = tracker.process(picture, number / 30)
            numbers = [*face.coefficients, *face.yaw_pitch_roll_deg] if face else [0] * 55
            table.writerow([number, number / 30, "live" if face else "neutral", *numbers])
    print(f"{len(printed)} faces by the program of the README, facewire {facewire.__version__}")


if __name__ == "__main__":
    main()
