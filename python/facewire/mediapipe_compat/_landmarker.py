"""MediaPipe's FaceLandmarker."""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from typing import Any, Callable, List, NamedTuple, Optional

import numpy

from facewire import BLENDSHAPES, Face, FaceTracker

from .. import _connections
from ._image import Image, ImageFormat
from ._landmarks import normalized

# MediaPipe's names in its order, which is that of the alphabet. It has no tongueOut.
NAMES = ["_neutral", *sorted(name for name in BLENDSHAPES if name != "tongueOut")]
_PLACES = numpy.array([BLENDSHAPES.index(name) for name in NAMES[1:]])

# MediaPipe takes every camera for one that sees 63 degrees from top to bottom, facewire for one that sees 60 from side to side:
# focal lengths in heights and in widths of the picture (the defaults of its face_geometry, and of FaceTracker).
_THEIR_FOCUS, _OUR_FOCUS = (0.5 / math.tan(math.radians(angle / 2)) for angle in (63, 60))
# The mean of the corners of the eyes in MediaPipe's canonical_face_model.obj, centimetres. facewire's position is that of this point.
_BETWEEN_EYES_CM = numpy.array([0.0, 2.62, 3.47])

Blendshapes = enum.IntEnum(  # type: ignore[misc]
    "Blendshapes", [(re.sub("([A-Z])", r"_\1", name).upper().lstrip("_"), index) for index, name in enumerate(NAMES)]
)


class RunningMode(enum.Enum):
    """How pictures come."""

    IMAGE = "IMAGE"
    VIDEO = "VIDEO"
    LIVE_STREAM = "LIVE_STREAM"


@dataclasses.dataclass
class BaseOptions:
    """The model's place, which is not read: facewire has its own."""

    class Delegate(enum.IntEnum):
        """What computes."""

        DEFAULT = 0
        CPU = 1
        GPU = 2

    model_asset_path: Optional[str] = None
    model_asset_buffer: Optional[bytes] = None
    delegate: Any = None


@dataclasses.dataclass
class ImageProcessingOptions:
    """A part or a turn of a picture. facewire refuses what differs from the whole upright picture."""

    region_of_interest: Any = None
    rotation_degrees: int = 0


@dataclasses.dataclass
class Category:
    """A blendshape and its coefficient."""

    index: Optional[int] = None
    score: Optional[float] = None
    display_name: Optional[str] = None
    category_name: Optional[str] = None


class Connection(NamedTuple):
    """An edge between two points."""

    start: int
    end: int


def _connected(edges: _connections.Edges) -> List[Connection]:
    return [Connection(*edge) for edge in sorted(edges)]


class FaceLandmarksConnections:
    """The edges between points."""

    Connection = Connection
    FACE_LANDMARKS_LIPS = _connected(_connections.FACEMESH_LIPS)
    FACE_LANDMARKS_LEFT_EYE = _connected(_connections.FACEMESH_LEFT_EYE)
    FACE_LANDMARKS_LEFT_EYEBROW = _connected(_connections.FACEMESH_LEFT_EYEBROW)
    FACE_LANDMARKS_LEFT_IRIS = _connected(_connections.FACEMESH_LEFT_IRIS)
    FACE_LANDMARKS_RIGHT_EYE = _connected(_connections.FACEMESH_RIGHT_EYE)
    FACE_LANDMARKS_RIGHT_EYEBROW = _connected(_connections.FACEMESH_RIGHT_EYEBROW)
    FACE_LANDMARKS_RIGHT_IRIS = _connected(_connections.FACEMESH_RIGHT_IRIS)
    FACE_LANDMARKS_FACE_OVAL = _connected(_connections.FACEMESH_FACE_OVAL)
    FACE_LANDMARKS_NOSE = _connected(_connections.FACEMESH_NOSE)
    FACE_LANDMARKS_CONTOURS = _connected(_connections.FACEMESH_CONTOURS)
    FACE_LANDMARKS_TESSELATION = _connected(_connections.FACEMESH_TESSELATION)


@dataclasses.dataclass
class FaceLandmarkerResult:
    """The faces in a picture."""

    face_landmarks: List[Any]
    face_blendshapes: List[List[Category]]
    facial_transformation_matrixes: List[Any]


@dataclasses.dataclass
class FaceLandmarkerOptions:
    """The options. The confidences have no effect."""

    base_options: BaseOptions
    running_mode: RunningMode = RunningMode.IMAGE
    num_faces: int = 1
    min_face_detection_confidence: float = 0.5
    min_face_presence_confidence: float = 0.5
    min_tracking_confidence: float = 0.5
    output_face_blendshapes: Optional[bool] = False
    output_facial_transformation_matrixes: Optional[bool] = False
    result_callback: Optional[Callable[[FaceLandmarkerResult, Image, int], None]] = None

    def __post_init__(self) -> None:
        if (self.running_mode is RunningMode.LIVE_STREAM) != (self.result_callback is not None):
            raise ValueError("a result_callback goes with the live stream mode, and with no other")


class FaceLandmarker:
    """Finds landmarks and coefficients of faces."""

    def __init__(self, options: FaceLandmarkerOptions) -> None:
        self._options, self._last_ms = options, -1
        self._tracker: Optional[FaceTracker] = FaceTracker(
            max_faces=options.num_faces, stills=options.running_mode is RunningMode.IMAGE
        )
        # As with MediaPipe, pictures may be any time apart.
        self._tracker._trust_times()

    @classmethod
    def create_from_options(cls, options: FaceLandmarkerOptions) -> "FaceLandmarker":
        """Makes a landmarker."""
        return cls(options)

    @classmethod
    def create_from_model_path(cls, model_path: str) -> "FaceLandmarker":
        """Makes a landmarker for single pictures."""
        return cls(FaceLandmarkerOptions(BaseOptions(model_asset_path=model_path)))

    def detect(self, image: Image, image_processing_options: Any = None) -> FaceLandmarkerResult:
        """Finds the faces in a single picture."""
        self._need(RunningMode.IMAGE, image_processing_options)
        return self._find(image, 0.0)

    def detect_for_video(
        self, image: Image, timestamp_ms: int, image_processing_options: Any = None
    ) -> FaceLandmarkerResult:
        """Finds the faces in the next picture of a film."""
        self._need(RunningMode.VIDEO, image_processing_options)
        return self._find(image, self._later(timestamp_ms))

    def detect_async(self, image: Image, timestamp_ms: int, image_processing_options: Any = None) -> None:
        """Finds the faces in the next picture of a camera, and calls back."""
        self._need(RunningMode.LIVE_STREAM, image_processing_options)
        found = self._find(image, self._later(timestamp_ms))
        if self._options.result_callback is not None:
            self._options.result_callback(found, image, timestamp_ms)

    def close(self) -> None:
        """Frees the memory."""
        self._tracker = None

    def __enter__(self) -> "FaceLandmarker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _need(self, mode: RunningMode, image_processing_options: Any) -> None:
        if image_processing_options not in (None, ImageProcessingOptions()):
            raise ValueError("facewire takes whole pictures the right way up: image_processing_options are not supported")
        if self._options.running_mode is not mode:
            raise ValueError(f"the landmarker runs in the mode {self._options.running_mode.value}, not {mode.value}")

    def _later(self, timestamp_ms: int) -> float:
        if timestamp_ms <= self._last_ms:
            raise ValueError("Input timestamp must be monotonically increasing.")
        self._last_ms = timestamp_ms
        return timestamp_ms / 1000

    def _find(self, image: Image, time_s: float) -> FaceLandmarkerResult:
        if self._tracker is None:
            raise ValueError("the landmarker is closed")
        kind = {ImageFormat.SRGB: "rgb", ImageFormat.SRGBA: "rgba"}.get(image.image_format, "grey")
        faces = self._tracker.process_all(image.numpy_view(), time_s, format=kind)  # type: ignore[arg-type]
        options = self._options
        return FaceLandmarkerResult(
            [normalized(face, image.width, image.height) for face in faces],
            [_categories(face) for face in faces] if options.output_face_blendshapes else [],
            [matrix(face, image.width, image.height) for face in faces] if options.output_facial_transformation_matrixes else [],
        )


def _categories(face: Face) -> List[Category]:
    scores = [0.0, *face.coefficients[_PLACES].tolist()]
    return [Category(index, score, "", name) for index, (score, name) in enumerate(zip(scores, NAMES))]


def matrix(face: Face, width: int, height: int) -> "numpy.ndarray[Any, Any]":
    """The map from the axes of MediaPipe's model of a head to those of the camera (x to the right, y up, z towards it), cm."""
    x, y, z, w = face.rotation_xyzw
    right, down, away = (side / 10 for side in face.position_mm)
    # Distances go by the focal length, on which facewire and MediaPipe do not agree.
    away *= height / width * _THEIR_FOCUS / _OUR_FOCUS
    axes = numpy.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    # As with MediaPipe up to 0.10.21: programs write its numbers as JSON, which takes no float32.
    made = numpy.eye(4)
    made[:3, :3] = axes
    made[:3, 3] = numpy.array([right, -down, -away]) - axes @ _BETWEEN_EYES_CM
    return made
