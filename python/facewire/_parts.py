"""The parts of a face by their landmarks."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Mapping

import numpy
import numpy.typing as npt

# Lines through landmarks, in the order in which a pen would draw them. Those in _OPEN do not return to their first point.
_LINES = {
    "face_oval": (
        10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150, 136, 172,
        58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
    ),
    "left_eyebrow": (300, 293, 334, 296, 336, 285, 295, 282, 283, 276),
    "right_eyebrow": (70, 63, 105, 66, 107, 55, 65, 52, 53, 46),
    "left_eye": (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249),
    "right_eye": (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
    "left_iris": (474, 475, 476, 477),
    "right_iris": (469, 470, 471, 472),
    "left_pupil": (473,),
    "right_pupil": (468,),
    "nose_bridge": (168, 6, 197, 195, 5, 4, 1),
    "nose_base": (98, 97, 2, 326, 327),
    "outer_lips": (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146),
    "inner_lips": (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95),
}
_OPEN = ("nose_bridge", "nose_base")

Indices = npt.NDArray[numpy.int64]


def _frozen(values: Any) -> Indices:
    array = numpy.array(values, numpy.int64)
    array.flags.writeable = False
    return array


def _edges(name: str) -> Indices:
    line = _LINES[name]
    ends = line[1:] if name in _OPEN or len(line) == 1 else (*line[1:], line[0])
    return _frozen(numpy.column_stack([line[:len(ends)], ends]))


PARTS: Mapping[str, Indices] = MappingProxyType({name: _frozen(line) for name, line in _LINES.items()})
"""The landmarks of each part, along its outline: `face.landmarks[facewire.PARTS["left_eye"]]`. Left and right are the person's."""

CONNECTIONS: Mapping[str, Indices] = MappingProxyType({name: _edges(name) for name in _LINES if not name.endswith("_pupil")})
"""The same as pairs of landmarks, between which lines are to be drawn: `face.landmarks[facewire.CONNECTIONS["left_eye"]]`."""
