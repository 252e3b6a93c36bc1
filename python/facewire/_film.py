"""Videos, which OpenCV or PyAV decodes."""

from __future__ import annotations

import os
from typing import Any, Iterable, Iterator, NamedTuple, Optional, Tuple, Union

import numpy

from ._facewire import Face, FaceTracker, FacewireError


class _Frame(NamedTuple):
    number: int
    """Counts from 0."""
    time_s: float
    """Seconds since the beginning of the video."""
    face: Optional[Face]
    """The face, if the frame shows one. Of several, the one that has been followed longest."""


class TrackedFrame(_Frame):
    """A frame of a video: the tuple `(number, time_s, face)`, with all faces as `faces`."""

    faces: Tuple[Face, ...] = ()
    """All faces in the frame, at most `max_faces`; the one that has been followed longest comes first. No part of the tuple."""

    def __new__(cls, number: int, time_s: float, face: Optional[Face], faces: Iterable[Face] = ()) -> TrackedFrame:
        frame = super().__new__(cls, number, time_s, face)
        frame.faces = tuple(faces) or (() if face is None else (face,))
        return frame


def track(film: Union[str, "os.PathLike[str]"], tracker: Optional[FaceTracker] = None, **options: Any) -> Iterator[TrackedFrame]:
    """Yields every frame of a video with its face, and with all its faces if the tracker follows several.

    Without a tracker, one is made with these options (those of FaceTracker); a given one is reset first. It needs PyAV
    (`pip install av`) or OpenCV.

        for number, time_s, face in facewire.track("video.mp4"): ...
        for frame in facewire.track("video.mp4", max_faces=2):
            for face in frame.faces: ...
    """
    if tracker is not None and options:
        raise TypeError("give a tracker or options, not both")
    tracker = tracker or FaceTracker(**options)
    path = os.fspath(film)
    if not os.path.exists(path):
        raise FileNotFoundError(path)
    return _track(path, tracker)


def _track(path: str, tracker: FaceTracker) -> Iterator[TrackedFrame]:
    tracker.reset()
    begun_s, last_s, skipped_s = None, 0.0, 0.0
    for number, (time_s, picture) in enumerate(_decode(path)):
        begun_s = time_s if begun_s is None else begun_s
        # In a video that was joined from several, times may begin anew. They go on from the last one then.
        begun_s = min(begun_s, time_s - last_s)
        time_s = max(time_s - begun_s, last_s)
        # Pictures of a video may be any time apart, but a tracker refuses times that seem to be in milliseconds. After a second
        # without a picture nothing is smoothed in any case.
        skipped_s += max(time_s - last_s - 1.0, 0.0)
        last_s = time_s
        faces = tracker.process_all(picture, time_s - skipped_s)
        yield TrackedFrame(number, time_s, faces[0] if faces else None, faces)


def _decode(path: str) -> Iterator[Tuple[float, numpy.ndarray[Any, Any]]]:
    """Yields the time of every frame, and its picture as it is to be seen, in the order of OpenCV."""
    try:
        import av
    except ImportError:
        yield from _decode_by_opencv(path)
        return
    try:
        with av.open(path) as container:
            if not container.streams.video:
                raise FacewireError(f"{path} has no pictures")
            rate = float(container.streams.video[0].average_rate or 30)
            for number, frame in enumerate(container.decode(video=0)):
                picture = frame.to_ndarray(format="bgr24")
                # The video says how it was held; OpenCV turns the pictures itself.
                quarters = round(getattr(frame, "rotation", 0) / 90) % 4
                yield frame.time if frame.time is not None else number / rate, numpy.rot90(picture, quarters)
    except av.FFmpegError as error:
        raise FacewireError(f"{path} cannot be decoded: {error}") from error


def _decode_by_opencv(path: str) -> Iterator[Tuple[float, numpy.ndarray[Any, Any]]]:
    try:
        import cv2
    except ImportError:
        raise FacewireError("to decode videos, install PyAV (pip install av) or OpenCV (pip install opencv-python)") from None
    film = cv2.VideoCapture(path)
    if not film.isOpened():
        raise FacewireError(f"{path} cannot be decoded by OpenCV")
    rate = film.get(cv2.CAP_PROP_FPS) or 30.0
    number = 0
    while True:
        is_there, picture = film.read()
        if not is_there:
            film.release()
            return
        time_s = film.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # A video without times has 0 for all.
        yield time_s if time_s > 0 else number / rate, picture
        number += 1
