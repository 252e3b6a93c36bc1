"""Faces drawn into pictures, by NumPy alone."""

from __future__ import annotations

import functools
import math
from typing import Any, Optional

import numpy

from ._facewire import BLENDSHAPES, Face
from ._parts import CONNECTIONS

DOTS, LINES, BARS, LETTERS = (255, 255, 255), (255, 200, 60), (190, 110, 20), (255, 255, 255)

# Letters of the names, seven rows of five dots.
_LETTERS = """
a 00000e010f110f b 1010161911111e c 00000e1010110e d 01010d1311110f e 00000e111f100e f 0609081c080808 g 000f11110f010e
h 10101619111111 i 04000c0404040e j 0200060202120c k 10101214181412 l 0c04040404040e m 00001a15151111 n 00001619111111
o 00000e1111110e p 00001e111e1010 q 00000d130f0101 r 00001619101010 s 00000e100e011e t 08081c08080906 u 0000111111130d
v 00001111110a04 w 0000111115150a x 0000110a040a11 y 000011110f010e z 00001f0204081f
B 1e11111e11111e C 0e11101010110e D 1c12111111121c F 1f10101e101010 I 0e04040404040e L 1010101010101f O 0e11111111110e
P 1e11111e101010 R 1e11111e141211 S 0f10100e01011e U 1111111111110e W 1111111515150a
""".split()
_ROW_PX, _LETTER_PX = 9, 6
_WIDTH_PX = _LETTER_PX * max(map(len, BLENDSHAPES)) + 4


def draw(
    picture: Any, face: Optional[Face], *, landmarks: bool = True, contours: bool = True, bars: bool = True
) -> Any:
    """Draws a face into a picture, an array of uint8 that can be written, and returns the array.

    landmarks: dots at the 478 landmarks.
    contours: lines along eyes, irises, brows, lips, nose and oval.
    bars: the 52 coefficients by name at the left edge, from the top as they are in BLENDSHAPES.

    Without a face (None) nothing is drawn. Of several faces, draw all but one with `bars=False`.
    """
    if not isinstance(picture, numpy.ndarray) or picture.dtype != numpy.uint8 or picture.ndim not in (2, 3):
        raise TypeError("draw takes a picture as an array of uint8; of a picture of Pillow, give numpy.array(picture)")
    if face is None:
        return picture
    points = face.landmarks[:, :2].astype(float)
    left, top, right, bottom = face.box_px
    # A line is wider in a large face.
    radius = max((bottom - top) / 600, 0.5)
    if contours:
        _put(picture, numpy.concatenate([_along(points[edges], radius) for edges in CONNECTIONS.values()]), radius, LINES)
    if landmarks:
        _put(picture, points, 1.2 * radius, DOTS)
    if bars:
        _bars(picture, face.coefficients)
    return picture


def _along(segments: Any, radius: float) -> Any:
    """Points on segments, so near each other that their dots make lines."""
    lengths = numpy.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    counts = numpy.maximum(lengths / max(0.7 * radius, 0.7), 1).astype(int)
    which = numpy.repeat(numpy.arange(len(segments)), counts)
    share = (numpy.arange(counts.sum()) - numpy.repeat(counts.cumsum() - counts, counts)) / counts[which]
    return segments[which, 0] + share[:, None] * (segments[which, 1] - segments[which, 0])


def _put(picture: Any, points: Any, radius: float, colour: Any) -> None:
    """Puts a dot with a soft edge at each point."""
    height, width = picture.shape[:2]
    # Pixels further away are not covered.
    reach = math.ceil(radius)
    nearest = numpy.rint(points).astype(int)
    seen = ((nearest > -reach) & (nearest < [width + reach, height + reach])).all(axis=1)
    points, nearest = points[seen], nearest[seen]
    if not len(points):
        return
    (left, top), (right, bottom) = nearest.min(axis=0) - reach, nearest.max(axis=0) + reach + 1
    share = numpy.zeros((bottom - top, right - left))
    for offset in numpy.ndindex(2 * reach + 1, 2 * reach + 1):
        pixels = nearest + offset - reach
        x_px, y_px = (pixels - points).T
        covered = (radius + 0.5 - numpy.sqrt(x_px * x_px + y_px * y_px)).clip(0, 1)
        numpy.maximum.at(share, (pixels[:, 1] - top, pixels[:, 0] - left), covered)
    inside = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
    seen_share = share[max(-top, 0):, max(-left, 0):]
    part = picture[inside]
    _blend(part, seen_share[:part.shape[0], :part.shape[1]], colour)


def _blend(part: Any, share: Any, colour: Any) -> None:
    """Mixes a colour into a part of a picture, with a share for each pixel."""
    channels = 1 if part.ndim == 2 else part.shape[2]
    values = numpy.array((*colour, 255)[:channels] if channels >= 3 else [sum(colour) / 3])
    places = numpy.nonzero(share)
    before = part[places].reshape(-1, channels)
    mixed = before + share[places][:, None] * (values - before)
    part[places] = numpy.rint(mixed).reshape(part[places].shape)


def _bars(picture: Any, coefficients: Any) -> None:
    height, width = picture.shape[:2]
    # In a large picture everything is larger by a whole number; in a small one there are several columns.
    size = max(height // (_ROW_PX * len(BLENDSHAPES)), 1)
    row_px, column_px = _ROW_PX * size, _WIDTH_PX * size
    rows = max(height // row_px, 1)
    columns = -(-len(BLENDSHAPES) // rows)
    part = picture[:, :columns * column_px]
    # A fourth channel says how opaque a pixel is.
    colours = part if part.ndim == 2 else part[:, :, :3]
    colours //= 3
    for place, (name, value) in enumerate(zip(BLENDSHAPES, coefficients)):
        x, y = place // rows * column_px, place % rows * row_px
        bar = picture[y + size // 2:y + row_px - size // 2, x:x + int(value * column_px + 0.5)]
        _blend(bar, numpy.ones(bar.shape[:2]), BARS)
        text = picture[y + size:y + 8 * size, x + 2 * size:x + column_px]
        letters = _text(name, size)[:text.shape[0], :text.shape[1]]
        _blend(text[:, :letters.shape[1]], letters, LETTERS)


@functools.lru_cache(maxsize=4 * len(BLENDSHAPES))
def _text(text: str, size: int) -> Any:
    """The share of each pixel that letters of this size cover."""
    letters = dict(zip(_LETTERS[::2], _LETTERS[1::2]))
    columns = []
    for letter in text:
        dots = numpy.array([[row >> (5 - column) & 1 for column in range(6)] for row in bytes.fromhex(letters[letter])])
        columns.append(dots)
    return numpy.hstack(columns).repeat(size, axis=0).repeat(size, axis=1).astype(float)
