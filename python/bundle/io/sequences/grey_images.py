"""Reading of images as grey values of 8 bits, by OpenCV.

16-bit images (TUM-VI) lose their lower byte. Cameras of 10 or 12 bits in 16-bit files keep their
upper 8 bits: the first image decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import require_package
from bundle.errors import InputError, shown

# first bytes, and bytes near the end of a whole file
_WHOLE = {b"\x89PNG": b"IEND", b"\xff\xd8\xff": b"\xff\xd9"}
_TAIL = 4096  # bytes; cameras append data after the end of an image


def require_opencv(purpose: str) -> None:
    """Check that OpenCV is installed."""
    require_package("cv2", "opencv-python-headless", purpose)


def grey_images(paths: Sequence[Path], size: tuple[int, int] | None) -> Iterator[NDArray[np.uint8]]:
    """Yield the images of files; one at a time is in memory.

    ``size``: width and height of the calibration; None: unknown.
    """
    scale = GreyScale()
    for path in paths:
        image = decoded(path.read_bytes(), shown(path))
        size = check_size(image, size, shown(path))
        yield scale.grey(image)


def decoded(content: bytes, place: str) -> NDArray[Any]:
    """Return the image of the bytes of a file, grey."""
    import cv2

    end = next((end for begin, end in _WHOLE.items() if content.startswith(begin)), b"")
    if end not in content[-_TAIL:]:
        raise InputError(f"{place}: expected a whole image, found a truncated file")
    image: Any = None
    if content:
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    if image is None:
        raise InputError(f"{place}: expected an image, found a file that is none")
    return np.asarray(image)


def check_size(image: NDArray[Any], size: tuple[int, int] | None, place: str) -> tuple[int, int]:
    """Check that an image has the size of the calibration or of the first image; return it."""
    found = image.shape[1], image.shape[0]
    if size is not None and found != size:
        raise InputError(
            f"{place}: expected {size[0]} x {size[1]} pixels as the calibration or the first image "
            f"has, found {found[0]} x {found[1]}"
        )
    return found


class GreyScale:
    """Conversion of the images of one camera to 8 bits; the first image decides the scale."""

    def __init__(self) -> None:
        self._shift: int | None = None

    def grey(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Return an image with values of 8 bits."""
        if image.dtype == np.uint8:
            return np.asarray(image, np.uint8)
        if image.dtype != np.uint16:
            raise InputError(f"image: expected 8 or 16 bits per value, found {image.dtype}")
        if self._shift is None:
            self._shift = max(0, int(image.max()).bit_length() - 8)
            if self._shift > 4:
                self._shift = 8
        return np.asarray(np.minimum(image >> self._shift, 255), np.uint8)
