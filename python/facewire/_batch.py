"""Many pictures at a time."""

from __future__ import annotations

import collections
import concurrent.futures
import os
import queue
from typing import Any, Deque, Iterable, Iterator, List, Optional

from ._facewire import Face, FaceTracker, FacewireError


def batch(pictures: Iterable[Any], *, workers: Optional[int] = None, **options: Any) -> Iterator[List[Face]]:
    """Yields the faces in each of many unrelated pictures, in the order of the pictures.

    pictures: arrays, pictures of Pillow, or paths of files, which Pillow or OpenCV reads. An iterator is read as results are
        taken, so that it need not fit into memory.
    workers: how many threads work, each with a tracker of its own. Without it, one for each core.
    options: those of FaceTracker. It is made with `stills=True`, so the faces have no history.

    A picture that cannot be read raises when its result would come, and ends the batch. At a `break`, pictures that wait are
    left out.

        for path, faces in zip(paths, facewire.batch(paths, max_faces=4)): ...
    """
    if isinstance(pictures, (str, bytes, os.PathLike)):
        raise TypeError("batch takes several pictures: give a list")
    workers = workers or len(os.sched_getaffinity(0))
    trackers: queue.SimpleQueue[FaceTracker] = queue.SimpleQueue()
    for _ in range(workers):
        trackers.put(FaceTracker(stills=True, **options))
    return _batch(pictures, trackers, workers)


def _batch(pictures: Iterable[Any], trackers: Any, workers: int) -> Iterator[List[Face]]:
    def find(picture: Any) -> List[Face]:
        tracker = trackers.get()
        try:
            return _find(tracker, picture)
        finally:
            trackers.put(tracker)

    waiting: Deque[Any] = collections.deque()
    pool = concurrent.futures.ThreadPoolExecutor(workers)
    try:
        for picture in pictures:
            waiting.append(pool.submit(find, picture))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _find(tracker: FaceTracker, picture: Any) -> List[Face]:
    if not isinstance(picture, (str, os.PathLike)):
        return tracker.process_all(picture)
    path = os.fspath(picture)
    try:
        import PIL.Image
    except ImportError:
        return tracker.process_all(_read_by_opencv(path))
    try:
        with PIL.Image.open(path) as opened:
            opened.load()
            return tracker.process_all(opened)
    except PIL.UnidentifiedImageError as error:
        raise FacewireError(str(error)) from error


def _read_by_opencv(path: str) -> Any:
    try:
        import cv2
    except ImportError:
        raise FacewireError("to read files, install Pillow (pip install pillow) or OpenCV (pip install opencv-python)") from None
    if not os.path.exists(path):
        raise FileNotFoundError(path)
    picture = cv2.imread(path)
    if picture is None:
        raise FacewireError(f"{path} cannot be read by OpenCV")
    return picture
