"""MediaPipe's drawing utilities for faces, by OpenCV."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Dict, Optional, Tuple

from .. import _connections

WHITE, GREY, GREEN, RED, YELLOW = (224, 224, 224), (192, 192, 192), (48, 255, 48), (48, 48, 255), (0, 204, 255)
COLOURS = {
    "WHITE_COLOR": WHITE, "BLACK_COLOR": (0, 0, 0), "RED_COLOR": (0, 0, 255), "GREEN_COLOR": (0, 128, 0), "BLUE_COLOR": (255, 0, 0)
}


@dataclasses.dataclass
class DrawingSpec:
    """How points or edges look."""

    color: Tuple[int, int, int] = WHITE
    thickness: int = 2
    circle_radius: int = 2


def draw_landmarks(
    image: Any,
    landmark_list: Any,
    connections: Any = None,
    landmark_drawing_spec: Any = DrawingSpec(RED),
    connection_drawing_spec: Any = DrawingSpec(),
    is_drawing_landmarks: bool = True,
) -> None:
    """Draws points and edges into an array of three channels. A look is one for all, or a dictionary."""
    if landmark_list is None or not len(getattr(landmark_list, "landmark", landmark_list)):
        return
    import cv2

    height, width = image.shape[:2]
    points = [(int(point.x * width), int(point.y * height)) for point in getattr(landmark_list, "landmark", landmark_list)]
    for edge in connections or ():
        look = _look(connection_drawing_spec, tuple(edge))
        if look is not None:
            cv2.line(image, points[edge[0]], points[edge[1]], look.color, look.thickness)
    for index, point in enumerate(points):
        look = _look(landmark_drawing_spec, index)
        if look is not None and is_drawing_landmarks:
            cv2.circle(image, point, look.circle_radius, look.color, look.thickness)


def normalized_to_pixel_coordinates(
    normalized_x: float, normalized_y: float, image_width: int, image_height: int
) -> Optional[Tuple[int, int]]:
    """The pixel of a point; None outside of the picture. Programs import it, although its name has an underscore."""
    if not (0 <= normalized_x <= 1 and 0 <= normalized_y <= 1):
        return None
    x_px = min(math.floor(normalized_x * image_width), image_width - 1)
    return x_px, min(math.floor(normalized_y * image_height), image_height - 1)


def _look(spec: Any, key: Any) -> Optional[DrawingSpec]:
    return spec.get(key) if isinstance(spec, dict) else spec


def _contours(i: int = 0) -> Dict[Tuple[int, int], DrawingSpec]:
    looks = {edge: DrawingSpec(WHITE, 1) for edge in _connections.FACEMESH_CONTOURS}
    looks.update({edge: DrawingSpec(GREEN, 1) for edge in _connections.FACEMESH_LEFT_EYE | _connections.FACEMESH_LEFT_EYEBROW})
    looks.update({edge: DrawingSpec(RED, 1) for edge in _connections.FACEMESH_RIGHT_EYE | _connections.FACEMESH_RIGHT_EYEBROW})
    if i == 1:
        looks.update({edge: DrawingSpec(YELLOW, 1) for edge in _connections.FACEMESH_NOSE})
    return looks


def _irises() -> Dict[Tuple[int, int], DrawingSpec]:
    looks = {edge: DrawingSpec(GREEN, 2) for edge in _connections.FACEMESH_LEFT_IRIS}
    looks.update({edge: DrawingSpec(RED, 2) for edge in _connections.FACEMESH_RIGHT_IRIS})
    return looks


STYLES = {
    "get_default_face_mesh_tesselation_style": lambda: DrawingSpec(GREY, 1),
    "get_default_face_mesh_contours_style": _contours,
    "get_default_face_mesh_iris_connections_style": _irises,
}
