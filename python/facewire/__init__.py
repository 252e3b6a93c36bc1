"""52 ARKit blendshape coefficients, 478 landmarks, head pose and gaze from pictures of faces.

    import cv2, facewire

    for frame in facewire.track(0, pictures=True):  # the first camera
        if frame.face:
            print(frame.face["jawOpen"], frame.face.yaw_pitch_roll_deg)
        cv2.imshow("facewire", facewire.draw(frame.picture, frame.face))
        cv2.waitKey(1)

`FaceTracker` takes single pictures, `track` and `track_async` videos and cameras, `batch` many unrelated pictures.
"""

from collections.abc import Mapping

from ._batch import batch
from ._draw import draw
from ._facewire import BLENDSHAPES, Face, FaceTracker, FacewireError, __version__
from ._film import Track, TrackedFrame, track, track_async
from ._parts import CONNECTIONS, PARTS

__all__ = [
    "BLENDSHAPES", "CONNECTIONS", "Face", "FaceTracker", "FacewireError", "PARTS", "Track", "TrackedFrame", "__version__",
    "batch", "draw", "track", "track_async",
]

Mapping.register(Face)
