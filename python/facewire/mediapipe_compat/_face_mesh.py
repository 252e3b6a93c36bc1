"""MediaPipe's FaceMesh."""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional

from facewire import FaceTracker

from ._landmarks import NormalizedLandmarkList, normalized


class FaceMeshResult(NamedTuple):
    """The faces in a picture; None if there is none."""

    multi_face_landmarks: Optional[List[NormalizedLandmarkList]]


class FaceMesh:
    """Finds the landmarks of faces. The confidences are accepted and have no effect."""

    def __init__(
        self,
        static_image_mode: bool = False,
        max_num_faces: int = 1,
        refine_landmarks: bool = False,
        min_detection_confidence: float = 0.5,
        min_tracking_confidence: float = 0.5,
    ) -> None:
        self._tracker: Optional[FaceTracker] = FaceTracker(max_faces=max_num_faces, stills=static_image_mode)
        self._count = 478 if refine_landmarks else 468

    def process(self, image: Any) -> FaceMeshResult:
        """Finds the faces in an array of red, green and blue."""
        if getattr(image, "ndim", 0) != 3 or image.shape[2] != 3:
            raise ValueError("Input image must contain three channel rgb data.")
        if self._tracker is None:
            raise ValueError("the mesh is closed")
        height, width = image.shape[:2]
        faces = self._tracker.process_all(image, format="rgb")
        lists = [NormalizedLandmarkList(normalized(face, width, height, self._count, 0.0)) for face in faces]
        return FaceMeshResult(lists or None)

    def close(self) -> None:
        """Frees the memory."""
        self._tracker = None

    def __enter__(self) -> "FaceMesh":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
