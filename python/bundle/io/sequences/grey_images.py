"""Reading of images as grey values of 8 bits, by OpenCV.

16-bit images (TUM-VI) lose their lower byte. Cameras of 10 or 12 bits in 16-bit files keep their
upper 8 bits: the first image decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
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


def grey_images(
    images: Iterable[tuple[NDArray[Any], str]], size: tuple[int, int] | None
) -> Iterator[NDArray[np.uint8]]:
    """Yield the images of one camera with values of 8 bits; the first decides their scale.

    ``images``: grey values of 8 or 16 bits, and the place for messages. ``size``: width and height
    of the calibration; None: those of the first image.
    """
    shift: int | None = None
    for image, place in images:
        found = image.shape[1], image.shape[0]
        if size is not None and found != size:
            raise InputError(
                f"{place}: expected {size[0]} x {size[1]} pixels as the calibration or the first "
                f"image has, found {found[0]} x {found[1]}"
            )
        size = found
        if image.dtype == np.uint8:
            yield np.asarray(image, np.uint8)
            continue
        if image.dtype != np.uint16:
            raise InputError(f"{place}: expected 8 or 16 bits per value, found {image.dtype}")
        if shift is None:
            shift = max(0, int(image.max()).bit_length() - 8)
            if shift > 4:
                shift = 8
        yield np.asarray(np.minimum(image >> shift, 255), np.uint8)


def images_of_files(paths: Sequence[Path]) -> Iterator[tuple[NDArray[Any], str]]:
    """Yield the images of files with their paths; one at a time is in memory."""
    for path in paths:
        yield decoded(path.read_bytes(), shown(path)), shown(path)


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
