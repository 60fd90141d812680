"""GPS positions in the EXIF tags of images (EXIF 2.32, section 4.6.6).

Latitude and longitude are three rationals, degrees, minutes and seconds, and a letter. The altitude
is in metres, with its sign in a separate tag. EXIF does not define whether it is above sea level or
above the ellipsoid, and receivers differ. It is used unchanged
(``bundle.georeference.reference_system`` has the consequence).

Pillow reads the tags of JPEG, TIFF, DNG, PNG and WebP without decoding pixels. (The package
ExifRead cannot read tags of WebP and the tag of the accuracy.)
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

from bundle.base.optional_packages import allow_heic
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.dji_xmp import read_dji
from bundle.georeference.gps_positions import EXIF_TAGS, GpsPositions
from bundle.georeference.image_index import last_part
from bundle.georeference.reference_system import WGS84

_GPS = 0x8825
"""Tag of the directory of GPS tags."""
_LATITUDE, _LONGITUDE, _ALTITUDE_REFERENCE, _ALTITUDE, _POSITIONING_ERROR = 2, 4, 5, 6, 31
"""Tags of latitude and longitude. The tag of the letter (N, S, E, W) precedes each of them."""
_BELOW = (1, 3)
"""Altitude references of negative heights: below sea level, and (EXIF 3.0) below the ellipsoid."""


def read_exif_gps(folder: str | os.PathLike[str], names: Iterable[str]) -> GpsPositions:
    """Read the positions of images from their EXIF tags.

    Images without a position are left out, and a note counts them. Receivers without a fix write
    latitude and longitude 0; such images count as images without a position.

    Args:
        folder: folder of the images.
        names: names of the images in the reconstruction: paths relative to the folder. If the path
            does not exist, a file of that name directly in the folder is used if it is unique.

    Raises:
        InputError: the folder does not exist, or contains none of the images.
        OSError: an image cannot be read.
    """
    files, missing = files_of_images(folder, names)
    found: dict[str, tuple[float, ...]] = {}
    silent: list[str] = []
    with _any_size():
        for name, path in files.items():
            position = _position(path)
            if position is None:
                silent.append(name)
            else:
                found[name] = position
    table = np.array(list(found.values()), dtype=np.float64).reshape(-1, 5)
    return GpsPositions(
        names=tuple(found),
        geodetic=table[:, :3],
        accuracy=table[:, 3:],
        reference_system=WGS84,
        source=f"{EXIF_TAGS} in {shown(folder)}",
        notes=(
            *counted_images(missing, f"not in {shown(folder)}"),
            *counted_images(silent, "without a GPS position in the EXIF tags"),
        ),
    )


def files_of_images(
    folder: str | os.PathLike[str], names: Iterable[str]
) -> tuple[dict[str, Path], list[str]]:
    """Return the files of images by name, and the names without a file.

    Args:
        folder: folder of the images.
        names: names of the images; see :func:`read_exif_gps`.

    Raises:
        InputError: the folder does not exist, or contains none of the images.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{shown(folder)}: expected the folder of the images; it does not exist")
    wanted = [name for name in dict.fromkeys(names) if name]
    parts = Counter(map(last_part, wanted))
    files: dict[str, Path] = {}
    missing: list[str] = []
    for name in wanted:
        path = _file(root, name, alone=parts[last_part(name)] == 1)
        if path is None:
            missing.append(name)
        else:
            files[name] = path
    if not files:
        example = f" such as {brief(wanted[0])}" if wanted else ", which have no names"
        raise InputError(
            f"{shown(folder)}: expected the images of the reconstruction{example}, found 0 of them"
        )
    return files, missing


def _position(path: Path) -> tuple[float, float, float, float, float] | None:
    """Return latitude, longitude [degrees], height, and two accuracies [m]; nan where unknown.

    The accuracies are horizontal and vertical: RTK's standard deviations of DJI's XMP, otherwise
    EXIF's positioning error.

    Returns:
        None without a position: tags are missing, not numeric, or out of range.
    """
    from PIL import Image  # start-up: loads slowly

    allow_heic(path)
    with path.open("rb") as file:
        try:
            with Image.open(file) as image:
                tags = image.getexif().get_ifd(_GPS)
        except Exception as error:  # broken files may raise anything; skip them
            if isinstance(error, OSError) and error.errno is not None:
                raise  # a disk error, not an error of the format
            return None
    latitude = _angle(tags, _LATITUDE, "NS", 90)
    longitude = _angle(tags, _LONGITUDE, "EW", 180)
    if latitude is None or longitude is None or latitude == longitude == 0:
        return None
    (height,) = _numbers(tags, _ALTITUDE, 1) or (math.nan,)
    if _numbers(tags, _ALTITUDE_REFERENCE, 1) in {(below,) for below in _BELOW}:
        height = -height
    (accuracy,) = _numbers(tags, _POSITIONING_ERROR, 1) or (math.nan,)
    rtk = read_dji(path)
    if math.isfinite(rtk.horizontal):
        accuracy = rtk.horizontal
    return latitude, longitude, height, accuracy if accuracy > 0 else math.nan, rtk.vertical


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
    """Return a tag's numbers; None if it is missing or a denominator is 0."""
    value = tags.get(tag)
    given = value if isinstance(value, tuple | bytes) else (value,)
    try:
        values = tuple(float(entry) for entry in given)
    except (TypeError, ValueError, ArithmeticError):
        return None
    if len(values) != count or not all(map(math.isfinite, values)):
        return None
    return values


def counted_images(names: list[str], what: str) -> tuple[str, ...]:
    """Return a note that counts images and names three of them; empty without any."""
    if not names:
        return ()
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (f"{plural(len(names), 'image')} {what}: {', '.join(map(shown, names[:3]))}{more}.",)


@contextmanager
def _any_size() -> Iterator[None]:
    """Let Pillow open images of any size, without warnings on their tags."""
    from PIL import Image  # start-up: loads slowly

    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit
