"""GPS positions that cameras write into their images (EXIF 2.32, section 4.6.6).

Latitude and longitude are three rationals, degrees, minutes and seconds, and a letter. The altitude
is metres, its sign in a separate tag. EXIF leaves open whether it counts from sea level or from the
ellipsoid, and receivers differ. It is taken as it stands (``bundle.georeference.reference_system``
has the consequence).

Pillow reads the tags, without decoding pixels, in JPEG, TIFF, DNG, PNG and WebP. (ExifRead, which
does nothing else, misses those of WebP and the accuracy.)
"""

from __future__ import annotations

import math
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.gps_positions import EXIF_TAGS, GpsPositions
from bundle.georeference.image_index import last_part
from bundle.georeference.reference_system import WGS84

__all__ = ["read_exif_gps"]

_GPS = 0x8825
"""The tag of the directory of GPS tags."""
_LATITUDE, _LONGITUDE, _ALTITUDE_REFERENCE, _ALTITUDE, _POSITIONING_ERROR = 2, 4, 5, 6, 31
"""The letters of latitude and longitude are one tag before."""
_BELOW = (1, 3)
"""Altitude references of heights below zero: of sea level, and since EXIF 3.0 of the ellipsoid."""


def read_exif_gps(folder: str | os.PathLike[str], names: Iterable[str]) -> GpsPositions:
    """Read the positions of images from their EXIF tags.

    An image without a position is no error: it is not in the result, and a note counts those. So
    is one at latitude and longitude 0, which receivers write that have no fix.

    Args:
        folder: of the images.
        names: of the images, as in the reconstruction: paths from the folder on. Where there is no
            such file, one of that name directly in the folder is taken, if one image alone could
            be meant.

    Raises:
        InputError: there is no such folder, or no image in it.
        OSError: an image cannot be read.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{shown(folder)}: expected the folder of the images, found none")
    wanted = [name for name in dict.fromkeys(names) if name]
    found: dict[str, tuple[float, ...]] = {}
    missing: list[str] = []
    silent: list[str] = []
    parts = Counter(map(last_part, wanted))
    with _any_size():
        for name in wanted:
            path = _file(root, name, alone=parts[last_part(name)] == 1)
            if path is None:
                missing.append(name)
            elif (position := _position(path)) is None:
                silent.append(name)
            else:
                found[name] = position
    if len(missing) == len(wanted):
        example = f" such as {brief(wanted[0])}" if wanted else ", which have no names"
        raise InputError(
            f"{shown(folder)}: expected the images of the reconstruction{example}, found none"
        )
    table = np.array(list(found.values()), dtype=np.float64).reshape(-1, 4)
    return GpsPositions(
        names=tuple(found),
        geodetic=table[:, :3],
        accuracy=np.column_stack([table[:, 3], np.full(len(table), math.nan)]),
        reference_system=WGS84,
        source=f"{EXIF_TAGS} in {shown(folder)}",
        notes=(
            *_counted(missing, f"not in {shown(folder)}"),
            *_counted(silent, "without a GPS position in the EXIF tags"),
        ),
    )


def _position(path: Path) -> tuple[float, float, float, float] | None:
    """Return latitude, longitude [degrees], height, horizontal accuracy [m]; nan where unknown.

    Returns:
        None where there is no position: tags are missing, no numbers, or out of range.
    """
    from PIL import Image

    with path.open("rb") as file:
        try:
            with Image.open(file) as image:
                tags = image.getexif().get_ifd(_GPS)
        except Exception as error:  # whatever broken files make of it: they have no position
            if isinstance(error, OSError) and error.errno is not None:
                raise  # the disk, not the format
            return None
    latitude = _angle(tags, _LATITUDE, "NS", 90)
    longitude = _angle(tags, _LONGITUDE, "EW", 180)
    if latitude is None or longitude is None or latitude == longitude == 0:
        return None
    (height,) = _numbers(tags, _ALTITUDE, 1) or (math.nan,)
    if _numbers(tags, _ALTITUDE_REFERENCE, 1) in {(below,) for below in _BELOW}:
        height = -height
    (accuracy,) = _numbers(tags, _POSITIONING_ERROR, 1) or (math.nan,)
    return latitude, longitude, height, accuracy if accuracy > 0 else math.nan


def _file(root: Path, name: str, *, alone: bool) -> Path | None:
    for path in (root / name, *([root / last_part(name)] if alone else [])):
        if path.is_file():
            return path
    return None


def _angle(tags: Mapping[int, Any], tag: int, letters: str, largest: float) -> float | None:
    parts, letter = _numbers(tags, tag, 3), tags.get(tag - 1)
    if parts is None or not isinstance(letter, str) or letter[:1] not in tuple(letters):
        return None
    degrees, minutes, seconds = parts
    angle = degrees + minutes / 60 + seconds / 3600
    if not 0 <= angle <= largest:
        return None
    return -angle if letter[:1] == letters[1] else angle


def _numbers(tags: Mapping[int, Any], tag: int, count: int) -> tuple[float, ...] | None:
    """Return a tag's numbers; None where it is missing, or one of them is x/0."""
    value = tags.get(tag)
    given = value if isinstance(value, tuple | bytes) else (value,)
    try:
        values = tuple(float(entry) for entry in given)
    except (TypeError, ValueError, ArithmeticError):
        return None
    if len(values) != count or not all(map(math.isfinite, values)):
        return None
    return values


def _counted(names: list[str], what: str) -> tuple[str, ...]:
    if not names:
        return ()
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (f"{plural(len(names), 'image')} {what}: {', '.join(map(shown, names[:3]))}{more}.",)


@contextmanager
def _any_size() -> Iterator[None]:
    """Let Pillow open images of any size, without remarks on their tags."""
    from PIL import Image

    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit
