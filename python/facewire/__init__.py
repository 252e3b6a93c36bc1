"""52 ARKit blendshape coefficients, 478 landmarks, head pose and gaze from pictures of faces.

    import cv2, facewire

    tracker = facewire.FaceTracker()
    camera = cv2.VideoCapture(0)
    while True:
        ok, frame = camera.read()
        face = tracker.process(frame)
        if face:
            print(face["jawOpen"], face.yaw_pitch_roll_deg)
"""

from collections.abc import Mapping

from ._facewire import BLENDSHAPES, Face, FaceTracker, FacewireError, __version__
from ._film import TrackedFrame, track

__all__ = ["BLENDSHAPES", "Face", "FaceTracker", "FacewireError", "TrackedFrame", "__version__", "track"]

Mapping.register(Face)
