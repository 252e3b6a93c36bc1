"""Videos, which OpenCV or PyAV decodes, and cameras, which OpenCV reads."""

from __future__ import annotations

import collections
import contextlib
import os
import stat
import threading
import time
from typing import Any, AsyncIterator, Deque, Iterable, Iterator, NamedTuple, Optional, Tuple, Union

import numpy
import numpy.typing as npt

from ._facewire import Face, FaceTracker, FacewireError

Picture = npt.NDArray[Any]
Source = Union[str, "os.PathLike[str]", int]

# How many frames of a video may wait for a consumer before reading pauses.
_WAITING_FRAMES = 8
# How often a thread that waits for room checks whether its event loop has been closed.
_LOOK_EVERY_S = 1.0
# If times go back by more than this, later times continue from the last one.
_MAX_BACK_S = 0.5


class _Frame(NamedTuple):
    number: int
    """Counts from 0."""
    time_s: float
    """Seconds since the first frame."""
    face: Optional[Face]
    """The face, if the frame shows one. Of several, the one that has been followed longest."""


class TrackedFrame(_Frame):
    """A frame of a video or a camera: the tuple `(number, time_s, face)`, with all faces as `faces`."""

    faces: Tuple[Face, ...] = ()
    """All faces in the frame, at most `max_faces`; the one that has been followed longest comes first. No part of the tuple."""

    picture: Optional[Picture] = None
    """The picture in OpenCV's order, if `track` was asked for `pictures`. No part of the tuple."""

    def __new__(
        cls,
        number: int,
        time_s: float,
        face: Optional[Face],
        faces: Iterable[Face] = (),
        picture: Optional[Picture] = None,
    ) -> TrackedFrame:
        frame = super().__new__(cls, number, time_s, face)
        frame.faces = tuple(faces) or (() if face is None else (face,))
        frame.picture = picture
        return frame

    def _replace(self, **values: Any) -> TrackedFrame:
        frame = super()._replace(**values)
        frame.faces, frame.picture = self.faces, self.picture
        return frame

    __replace__ = _replace


class Track(Iterator[TrackedFrame]):
    """The frames of a video or a camera, which `close()`, or the end of a `with`, lets go of. So does the last frame."""

    def __init__(self, frames: Iterator[TrackedFrame], pictures: Iterator[Any]) -> None:
        self._frames, self._pictures = frames, pictures

    def __next__(self) -> TrackedFrame:
        return next(self._frames)

    def close(self) -> None:
        """Closes the camera or the file."""
        self._frames.close()  # type: ignore[attr-defined]
        self._pictures.close()  # type: ignore[attr-defined]

    def __enter__(self) -> Track:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def track(source: Source, tracker: Optional[FaceTracker] = None, *, pictures: bool = False, **options: Any) -> Track:
    """Yields every frame of a video or a camera with its face, and with all its faces if the tracker follows several.

    source: the path of a video, or a camera: its number (0 for the first) or its path (`/dev/video0`).
    tracker: is reset first, and keeps its profile. Without one, it is made with these options, which are those of FaceTracker.
    pictures: whether each frame has its `picture`. A list of all frames would then hold the whole video.

    The times of a camera are those that its driver gives to pictures, or those of their arrival where it gives none. Times of a
    video that go back by half a second or less stand still until they are reached again; after a longer step they go on from
    the last one.

    A video needs PyAV (`pip install av`) or OpenCV (`pip install opencv-python`), a camera OpenCV.

        for number, time_s, face in facewire.track("video.mp4"): ...
        for frame in facewire.track("video.mp4", max_faces=2):
            for face in frame.faces: ...
        with facewire.track(0, pictures=True) as frames:
            for frame in frames: ...
    """
    if tracker is not None and options:
        raise TypeError("give a tracker or options, not both")
    if not isinstance(source, int):
        source = os.fspath(source)
        if not os.path.exists(source):
            raise FileNotFoundError(source)
    decoded = _read_camera(source) if _is_camera(source) else _decode(str(source))
    return Track(_track(decoded, tracker or FaceTracker(**options), pictures), decoded)


async def track_async(
    source: Source, tracker: Optional[FaceTracker] = None, *, newest: bool = False, **options: Any
) -> AsyncIterator[TrackedFrame]:
    """Yields what `track` yields, from a thread of its own, so that the event loop goes on meanwhile.

    newest: whether a slow consumer gets the newest frame, and those before it are left out. Otherwise it gets every frame
        in order: a video waits for it, and frames of a camera wait in memory.

        async for frame in facewire.track_async(0, newest=True):
            await send(frame.face)

    The camera is released when the loop ends. After a `break` that is when the generator is closed, at the latest with the event
    loop; to choose the moment, keep the generator in a variable and await its `aclose()`.
    """
    import asyncio

    loop, came = asyncio.get_running_loop(), asyncio.Event()
    # Networks take a moment to load.
    frames = await loop.run_in_executor(None, lambda: track(source, tracker, **options))
    waiting: Deque[Any] = collections.deque(maxlen=1 if newest else None)
    room = None if newest or _is_camera(source) else threading.Semaphore(_WAITING_FRAMES)
    is_over = threading.Event()

    def call(function: Any, *arguments: Any) -> None:
        # A loop that was closed calls nothing.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(function, *arguments)

    def wait_for_room() -> None:
        # A loop that was closed without its generators takes no frame any more.
        while room is not None and not room.acquire(timeout=_LOOK_EVERY_S) and not loop.is_closed():
            pass

    def read() -> None:
        end: Any = None
        try:
            with frames:
                for frame in frames:
                    wait_for_room()
                    if is_over.is_set() or loop.is_closed():
                        break
                    waiting.append(frame)
                    call(came.set)
        except BaseException as error:  # It is raised where the frames are awaited.
            end = error
        finally:
            call(finish, end)

    ends = []

    def finish(end: Any) -> None:
        ends.append(end)
        came.set()

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        while True:
            await came.wait()
            came.clear()
            # Whether all frames have come is asked before the last of them is taken.
            has_ended = bool(ends)
            while waiting:
                frame = waiting.popleft()
                if room is not None:
                    room.release()
                yield frame
            if has_ended and ends[0] is not None:
                raise ends[0]
            if has_ended:
                return
    finally:
        is_over.set()
        if room is not None:
            room.release()
        await loop.run_in_executor(None, thread.join)


def _is_camera(source: Source) -> bool:
    return isinstance(source, int) or stat.S_ISCHR(os.stat(source).st_mode)


def _track(decoded: Iterator[Tuple[float, Picture]], tracker: FaceTracker, with_pictures: bool) -> Iterator[TrackedFrame]:
    tracker.reset()
    tracker._trust_times()
    begun_s, last_s = None, 0.0
    for number, (time_s, picture) in enumerate(decoded):
        begun_s = time_s if begun_s is None else begun_s
        # In a video that was joined from several, times may begin anew. They go on from the last one then.
        if last_s - (time_s - begun_s) > _MAX_BACK_S:
            begun_s = time_s - last_s
        last_s = max(time_s - begun_s, last_s)
        faces = tracker.process_all(picture, last_s)
        yield TrackedFrame(number, last_s, faces[0] if faces else None, faces, picture if with_pictures else None)


def _read_camera(source: Union[str, int]) -> Iterator[Tuple[float, Picture]]:
    """Yields the pictures of a camera as they come, with the time at which each was taken."""
    try:
        import cv2
    except ImportError:
        raise FacewireError("to read a camera, install OpenCV (pip install opencv-python)") from None
    camera = cv2.VideoCapture(source if isinstance(source, int) else os.path.realpath(source), cv2.CAP_V4L2)
    last_s = last_now_s = 0.0
    has_times, ahead_s = True, 0.0
    try:
        while True:
            is_there, picture = camera.read()
            if not is_there:
                raise FacewireError(f"camera {source} gives no pictures; is it plugged in, and does no other program use it?")
            now_s, time_s = time.monotonic(), camera.get(cv2.CAP_PROP_POS_MSEC) / 1000
            # Pictures that waited for a slow consumer come at the wrong time, but the driver knows when they were taken. If it
            # does not, the times go on by the clock.
            if has_times and not time_s > last_s:
                has_times, ahead_s = False, last_s - last_now_s
            last_s, last_now_s = time_s if has_times else now_s + ahead_s, now_s
            yield last_s, picture
    finally:
        camera.release()


def _decode(path: str) -> Iterator[Tuple[float, Picture]]:
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
                picture = numpy.ascontiguousarray(numpy.rot90(picture, quarters))
                yield frame.time if frame.time is not None else number / rate, picture
    except av.FFmpegError as error:
        raise FacewireError(f"{path} cannot be decoded: {error}") from error


def _decode_by_opencv(path: str) -> Iterator[Tuple[float, Picture]]:
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
