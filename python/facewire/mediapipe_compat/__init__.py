"""What programs use of MediaPipe for faces, answered by facewire: `import facewire.mediapipe_compat as mp`.

Given are `mp.solutions.face_mesh.FaceMesh` and `mp.tasks.vision.FaceLandmarker` with their options and results, `mp.Image`, the
lists of edges, and the drawing utilities (which need OpenCV). Options that choose a model file or a confidence are accepted and
have no effect. `detect_async` calls back before it returns.

If MediaPipe is not installed, `import mediapipe` and imports of its modules then load this package, so that one changed import
is enough for a program of many files; so do those of libraries for which MediaPipe is optional. If it is installed, call
`install()` to get the same effect.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
import types

from .. import _connections
from . import _drawing
from ._face_mesh import FaceMesh
from ._image import Image, ImageFormat
from ._landmarker import (
    BaseOptions,
    Blendshapes,
    Category,
    Connection,
    FaceLandmarker,
    FaceLandmarkerOptions,
    FaceLandmarkerResult,
    FaceLandmarksConnections,
    ImageProcessingOptions,
    RunningMode,
)
from ._landmarks import Landmark, NormalizedLandmark, NormalizedLandmarkList

# The version of MediaPipe whose names are here, beside those of `mp.solutions`, which 0.10.21 was the last to have.
__version__ = "1.2.3"
__all__ = ["FaceLandmarker", "FaceMesh", "Image", "ImageFormat", "install", "solutions", "tasks"]


def _module(name: str, **content: object) -> types.ModuleType:
    """Makes a module below this one, so that it can be imported by its name."""
    made = types.ModuleType(f"{__name__}.{name}")
    made.__dict__.update(content)
    made.__path__ = []  # A package: what is below it is in sys.modules, too.
    sys.modules[made.__name__] = made
    return made


_edges = {name: value for name, value in vars(_connections).items() if name.startswith("FACEMESH_")}

face_mesh_connections = _module("solutions.face_mesh_connections", **_edges)
face_mesh = _module("solutions.face_mesh", FaceMesh=FaceMesh, FACEMESH_NUM_LANDMARKS=468, FACEMESH_NUM_LANDMARKS_WITH_IRISES=478, **_edges)
drawing_utils = _module(
    "solutions.drawing_utils", DrawingSpec=_drawing.DrawingSpec, draw_landmarks=_drawing.draw_landmarks,
    _normalized_to_pixel_coordinates=_drawing.normalized_to_pixel_coordinates, **_drawing.COLOURS
)
drawing_styles = _module("solutions.drawing_styles", **_drawing.STYLES)
solutions = _module(
    "solutions", face_mesh=face_mesh, drawing_utils=drawing_utils, drawing_styles=drawing_styles,
    face_mesh_connections=face_mesh_connections,
)

_vision = {
    "FaceLandmarker": FaceLandmarker,
    "FaceLandmarkerOptions": FaceLandmarkerOptions,
    "FaceLandmarkerResult": FaceLandmarkerResult,
    "FaceLandmarksConnections": FaceLandmarksConnections,
    "ImageProcessingOptions": ImageProcessingOptions,
    "RunningMode": RunningMode,
}
_face_landmarker = _module(
    "tasks.python.vision.face_landmarker", Blendshapes=Blendshapes, Connection=Connection, **_vision
)
_running_mode = _module("tasks.python.vision.core.vision_task_running_mode", VisionTaskRunningMode=RunningMode)
_image_module = _module("tasks.python.vision.core.image", Image=Image, ImageFormat=ImageFormat)
_processing = _module("tasks.python.vision.core.image_processing_options", ImageProcessingOptions=ImageProcessingOptions)
_vision_core = _module(
    "tasks.python.vision.core", image=_image_module, image_processing_options=_processing, vision_task_running_mode=_running_mode
)
vision = _module(
    "tasks.python.vision", face_landmarker=_face_landmarker, core=_vision_core, drawing_utils=drawing_utils,
    drawing_styles=drawing_styles, **_vision
)
sys.modules[f"{__name__}.tasks.vision"] = vision
_landmark = _module("tasks.python.components.containers.landmark", Landmark=Landmark, NormalizedLandmark=NormalizedLandmark)
_category = _module("tasks.python.components.containers.category", Category=Category)
containers = _module(
    "tasks.python.components.containers", landmark=_landmark, category=_category, Landmark=Landmark,
    NormalizedLandmark=NormalizedLandmark, Category=Category,
)
components = _module("tasks.python.components", containers=containers)
_base_options = _module("tasks.python.core.base_options", BaseOptions=BaseOptions)
core = _module("tasks.python.core", base_options=_base_options)
_python = _module("tasks.python", vision=vision, components=components, core=core, BaseOptions=BaseOptions)
tasks = _module("tasks", python=_python, vision=vision, components=components, BaseOptions=BaseOptions)
landmark_pb2 = _module(
    "framework.formats.landmark_pb2", NormalizedLandmark=NormalizedLandmark, NormalizedLandmarkList=NormalizedLandmarkList
)
formats = _module("framework.formats", landmark_pb2=landmark_pb2)
framework = _module("framework", formats=formats)
python = _module("python", solutions=solutions)
for _name in ("solutions", *(f"solutions.{name}" for name in ("face_mesh", "face_mesh_connections", "drawing_utils", "drawing_styles"))):
    sys.modules[f"{__name__}.python.{_name}"] = sys.modules[f"{__name__}.{_name}"]


def install() -> None:
    """Makes `mediapipe` mean this package in this process."""
    for name, module in list(sys.modules.items()):
        if name == __name__ or name.startswith(__name__ + "."):
            sys.modules["mediapipe" + name[len(__name__):]] = module


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds this package under the name of MediaPipe if nothing else is found."""

    def find_spec(self, name, path=None, target=None):
        return importlib.machinery.ModuleSpec(name, self) if name == "mediapipe" else None

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        install()


sys.meta_path.append(_Finder())
