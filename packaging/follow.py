"""Follows the face in a raw video of 640 x 480 pixels, and compares each coefficient with that of c/examples/film.c, to the
last bit.

follow.py FILM.i422 VALUES.f32 [OTHER.f32]

OTHER has the values of another system, if the file exists, with which the coefficients agree to 0.05.
"""

import pathlib
import sys

import numpy

import facewire

LIMIT = 0.05

film = numpy.fromfile(sys.argv[1], numpy.uint8).reshape(-1, 960, 640)
expected, *others = [
    numpy.fromfile(path, numpy.float32).reshape(len(film), -1)[:, : len(facewire.BLENDSHAPES)]
    for path in sys.argv[2:]
    if pathlib.Path(path).exists()
]
tracker = facewire.FaceTracker()
faces = [tracker.process(picture, number * 1_000_000 // 30 / 1e6, format="i422") for number, picture in enumerate(film)]
assert all(faces), "a picture shows no face"
found = numpy.array([face.coefficients for face in faces])
assert numpy.array_equal(found, expected), f"values differ by up to {numpy.abs(found - expected).max()} from those of the C library"
print(f"a face in each of {len(film)} pictures, jawOpen up to {max(face['jawOpen'] for face in faces):.2f}, as by the C library", end="")
for other in others:
    difference = numpy.abs(found - other).max()
    assert difference <= LIMIT, f"values differ by up to {difference} from those of another system"
    print(f"; up to {difference:.4f} from another system", end="")
print()
