"""MediaPipe's pictures."""

from __future__ import annotations

import enum
from typing import Any

import numpy


class ImageFormat(enum.IntEnum):
    """What an array holds. facewire takes the first three formats that have a name."""

    UNKNOWN = 0
    SRGB = 1
    SRGBA = 2
    GRAY8 = 3
    GRAY16 = 4
    SRGB48 = 7
    SRGBA64 = 8
    VEC32F1 = 9
    VEC32F2 = 12
    VEC32F4 = 13


class Image:
    """A picture of uint8."""

    def __init__(self, image_format: ImageFormat = ImageFormat.SRGB, data: Any = None) -> None:
        shapes: Any = {ImageFormat.SRGB: [(3,)], ImageFormat.SRGBA: [(4,)], ImageFormat.GRAY8: [(), (1,)]}.get(image_format, [])
        data = numpy.asarray(data)
        if data.ndim < 2 or data.shape[2:] not in shapes:
            raise ValueError(f"an array of shape {data.shape} is no picture of {ImageFormat(image_format).name}")
        if data.dtype != numpy.uint8:
            raise ValueError(f"a picture is an array of uint8, not of {data.dtype}")
        self.image_format, self._data = image_format, data

    @classmethod
    def create_from_file(cls, file_name: str) -> "Image":
        """Reads a picture by OpenCV or Pillow."""
        try:
            import cv2
        except ImportError:
            import PIL.Image

            with PIL.Image.open(file_name) as picture:
                return cls(ImageFormat.SRGB, numpy.asarray(picture.convert("RGB")))
        picture = cv2.imread(file_name)
        if picture is None:
            raise RuntimeError(f"{file_name} cannot be read")
        return cls(ImageFormat.SRGB, picture[:, :, ::-1])

    @property
    def width(self) -> int:
        return int(self._data.shape[1])

    @property
    def height(self) -> int:
        return int(self._data.shape[0])

    @property
    def channels(self) -> int:
        return int(self._data.shape[2]) if self._data.ndim == 3 else 1

    @property
    def step(self) -> int:
        """Bytes of a row."""
        return self.width * self.channels

    def __getitem__(self, place: Any) -> Any:
        return self._data[place].item()

    def uses_gpu(self) -> bool:
        """Whether the samples are on a GPU."""
        return False

    def is_contiguous(self) -> bool:
        """Whether the samples lie one after another."""
        return bool(self._data.flags.c_contiguous)

    def is_empty(self) -> bool:
        """Whether there are no samples."""
        return not self._data.size

    def numpy_view(self) -> "numpy.ndarray[Any, Any]":
        """The array, which is not to be changed."""
        view = self._data.view()
        view.flags.writeable = False
        return view
