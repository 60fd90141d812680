"""GPS positions in the EXIF tags of images (EXIF 2.32, section 4.6.6), and DJI's XMP packet.

Latitude and longitude are three rationals, degrees, minutes and seconds, and a letter. The altitude
is in metres, with its sign in a separate tag. EXIF does not define whether it is above sea level or
above the ellipsoid, and receivers differ. It is used unchanged
(``bundle.georeference.reference_system`` states the error).

Pillow reads the tags of JPEG, TIFF, DNG, PNG and WebP without decoding pixels. (The package
ExifRead cannot read tags of WebP and the tag of the accuracy.)
"""

from __future__ import annotations

import math
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from bundle.base.optional_packages import allow_heic
from bundle.errors import InputError, brief, shown
from bundle.georeference.attitude_priors import OrientationPrior
from bundle.georeference.gps_positions import EXIF_TAGS, GpsPositions, counted_images
from bundle.georeference.reference_system import WGS84
from bundle.georeference.text_lines import last_part

_GPS, _EXIF, _CAPTURED = 0x8825, 0x8769, 0x9003  # two directories of tags, DateTimeOriginal
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

    ``names``: names of the images; see :func:`read_exif_gps`.
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
    tags = _tags(path, _GPS)
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


def capture_times(
    folder: str | os.PathLike[str], names: Iterable[str]
) -> tuple[datetime, datetime] | None:
    """Return the first and the last time of capture in the EXIF tags; None without a time.

    The arguments are those of :func:`read_exif_gps`. Times are those of the cameras' clocks.
    """
    times = []
    with suppress(InputError), _any_size():  # no such images
        for path in files_of_images(folder, names)[0].values():
            with suppress(ValueError, OSError):  # no time, as "0000:00:00 00:00:00"
                text = str(_tags(path, _EXIF).get(_CAPTURED, ""))
                times.append(datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S"))
    return (min(times), max(times)) if times else None


def _tags(path: Path, directory: int) -> Mapping[int, Any]:
    """Return the tags of a directory of an image; none of a broken file."""
    from PIL import Image  # start-up: loads slowly

    allow_heic(path)
    with path.open("rb") as file:
        try:
            with Image.open(file) as image:
                return image.getexif().get_ifd(directory)
        except Exception as error:  # broken files may raise anything; skip them
            if isinstance(error, OSError) and error.errno is not None:
                raise  # a disk error, not an error of the format
            return {}


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


# Gimbal angles, speeds and RTK sigmas that DJI writes into the XMP packet of a photograph.
#
# The packet is RDF in XML (Adobe, "XMP Specification Part 3"), in an APP1 segment of the JPEG file
# that begins with its namespace. DJI's values are in the namespace ``http://www.dji.com/
# drone-dji/1.0/``, as attributes of ``rdf:Description`` (most drones) or as its elements:
#
#     GimbalYawDegree, GimbalPitchDegree, GimbalRollDegree   degrees
#     FlightXSpeed, FlightYSpeed                             metres per second, to north and east
#     RtkStdLon, RtkStdLat, RtkStdHgt                        metres
#
# "NED coordinate system, the rotation order is ZYX" (DJI Mavic 3E/3T user manual, 2022, "Data
# storage, photo file"): the angles turn the axes forward, right, down of the camera from north,
# east, down, about z by yaw, then y by pitch, then x by roll. These are yaw, pitch and roll of
# ``attitude_priors``; a camera that looks straight down has pitch -90, and its upper edge points to
# the yaw. Yaw is true north as far as the drone's compass and its declination are right: some
# degrees, while pitch and roll are good to some tenths.

NAMESPACE = "http://www.dji.com/drone-dji/"
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_START, _SCAN, _APP1 = 0xD8, 0xDA, 0xE1
_LONE = {0x01, *range(0xD0, 0xD8)}  # markers without a length


class DjiRecord(NamedTuple):
    """Values of a photograph; NaN for values that its packet does not have."""

    yaw: float = math.nan  # heading in degrees
    pitch: float = math.nan  # degrees above the horizon
    roll: float = math.nan  # degrees
    # standard deviation of the position in each horizontal axis in metres
    horizontal: float = math.nan
    vertical: float = math.nan  # standard deviation of the height in metres
    north: float = math.nan  # speed to the north in metres per second
    east: float = math.nan  # speed to the east in metres per second

    @property
    def has_angles(self) -> bool:
        """True if the packet has all three angles."""
        return all(map(math.isfinite, (self.yaw, self.pitch, self.roll)))

    def prior(self, image: int | str, sigmas: tuple[float, float]) -> OrientationPrior:
        """Return the prior of an image, with sigmas of heading and tilt in degrees."""
        return OrientationPrior.from_angles(image, self.yaw, self.pitch, self.roll, sigmas)


def read_dji(path: str | os.PathLike[str]) -> DjiRecord:
    """Return DJI's values of a photograph; all NaN without a packet that can be read."""
    packet = xmp_packet(path)
    if packet is None:
        return DjiRecord()
    try:
        root = ElementTree.fromstring(packet)
    except (ElementTree.ParseError, ValueError, LookupError):  # or an unknown encoding
        return DjiRecord()
    values: dict[str, float] = {}
    for element in root.iter():
        for name, text in [(element.tag, element.text or ""), *element.attrib.items()]:
            space, _, local = name.rpartition("}")
            if space.startswith("{" + NAMESPACE):
                values.setdefault(local, _number(text))

    def get(name: str) -> float:
        return values.get(name, math.nan)

    east, north, up = (get(name) for name in ("RtkStdLon", "RtkStdLat", "RtkStdHgt"))
    horizontal = math.sqrt((east**2 + north**2) / 2)
    return DjiRecord(
        get("GimbalYawDegree"),
        get("GimbalPitchDegree"),
        get("GimbalRollDegree"),
        horizontal if horizontal > 0 else math.nan,
        up if up > 0 else math.nan,
        get("FlightXSpeed"),
        get("FlightYSpeed"),
    )


def xmp_packet(path: str | os.PathLike[str]) -> bytes | None:
    """Return the XMP packet of a JPEG file; None without any, or for another format."""
    with Path(path).open("rb") as file:
        if file.read(2) != bytes([0xFF, _START]):
            return None
        while file.read(1) == b"\xff":
            marker = file.read(1)
            while marker == b"\xff":  # any number of fill bytes
                marker = file.read(1)
            if not marker or marker[0] == _SCAN:
                return None
            if marker[0] in _LONE:
                continue
            length = int.from_bytes(file.read(2), "big")
            content = file.read(max(length - 2, 0))
            if marker[0] == _APP1 and content.startswith(_XMP):
                return content[len(_XMP) :].strip(b"\0 \r\n\t")
    return None


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
