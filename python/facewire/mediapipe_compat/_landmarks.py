"""Points in the units of MediaPipe: x and z in widths, y in heights of the picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Iterable, List, Optional

import numpy

from facewire import Face


@dataclasses.dataclass
class Landmark:
    """A point. MediaPipe finds no visibility for those of a face: FaceLandmarker leaves it None, and FaceMesh 0."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    visibility: Optional[float] = None
    presence: Optional[float] = None
    name: Optional[str] = None

    def HasField(self, name: str) -> bool:  # pylint: disable=invalid-name
        """As in protocol buffers: the mesh has no visibility."""
        return name in ("x", "y", "z")


class NormalizedLandmark(Landmark):
    """A point in parts of the picture."""


class Landmarks(Sequence):  # type: ignore[type-arg]
    """A list of points that are made when they are asked for."""

    def __init__(self, points: Any, unset: Optional[float]) -> None:
        self._points, self._unset = points, unset

    def __len__(self) -> int:
        return len(self._points)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self._made(point) for point in self._points[index].tolist()]
        return self._made(self._points[index].tolist())

    def __repr__(self) -> str:
        return repr(list(self))

    def __iter__(self) -> Any:
        return (self._made(point) for point in self._points.tolist())

    def _made(self, point: Any) -> NormalizedLandmark:
        x, y, z = point
        return NormalizedLandmark(x, y, z, self._unset, self._unset)


class NormalizedLandmarkList:
    """The points of a face, as FaceMesh returns them."""

    def __init__(self, landmark: Iterable[NormalizedLandmark] = ()) -> None:
        self.landmark: Any = landmark if isinstance(landmark, Landmarks) else _Points(landmark)


class _Points(List[Any]):
    def add(self, **fields: Any) -> NormalizedLandmark:
        """Adds a point, as programs do that fill a list for the drawing utilities."""
        self.append(NormalizedLandmark(**fields))
        return self[-1]  # type: ignore[no-any-return]


def normalized(face: Face, width: int, height: int, count: int = 478, unset: Optional[float] = None) -> Landmarks:
    """The first points of a face in a picture of this size."""
    return Landmarks(face.landmarks[:count] / numpy.array([width, height, width], numpy.float32), unset)
