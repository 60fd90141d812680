"""Gimbal angles, speeds and RTK sigmas that DJI writes into the XMP packet of a photograph.

The packet is RDF in XML (Adobe, "XMP Specification Part 3"), in an APP1 segment of the JPEG file
that begins with its namespace. DJI's values are in the namespace ``http://www.dji.com/
drone-dji/1.0/``, as attributes of ``rdf:Description`` (most drones) or as its elements:

    GimbalYawDegree, GimbalPitchDegree, GimbalRollDegree   degrees
    FlightXSpeed, FlightYSpeed                             metres per second, to north and east
    RtkStdLon, RtkStdLat, RtkStdHgt                        metres

"NED coordinate system, the rotation order is ZYX" (DJI Mavic 3E/3T user manual, 2022, "Data
storage, photo file"): the angles turn the axes forward, right, down of the camera from north, east,
down, about z by yaw, then y by pitch, then x by roll. These are yaw, pitch and roll of
``attitude_priors``; a camera that looks straight down has pitch -90, and its upper edge points to
the yaw. Yaw is true north as far as the drone's compass and its declination are right: some
degrees, while pitch and roll are good to some tenths.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from bundle.georeference.attitude_priors import OrientationPrior

NAMESPACE = "http://www.dji.com/drone-dji/"
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_START, _SCAN, _APP1 = 0xD8, 0xDA, 0xE1
_LONE = {0x01, *range(0xD0, 0xD8)}
"""Markers without a length."""


class DjiRecord(NamedTuple):
    """Values of a photograph; NaN for values that its packet does not have.

    Attributes:
        yaw: heading in degrees.
        pitch: degrees above the horizon.
        roll: degrees.
        horizontal: standard deviation of the position in each horizontal axis in metres.
        vertical: standard deviation of the height in metres.
        north: speed to the north in metres per second.
        east: speed to the east in metres per second.
    """

    yaw: float = math.nan
    pitch: float = math.nan
    roll: float = math.nan
    horizontal: float = math.nan
    vertical: float = math.nan
    north: float = math.nan
    east: float = math.nan

    @property
    def has_angles(self) -> bool:
        """True if the packet has all three angles."""
        return all(map(math.isfinite, (self.yaw, self.pitch, self.roll)))

    def prior(self, image: int | str, sigmas: tuple[float, float]) -> OrientationPrior:
        """Return the prior of an image, with sigmas of heading and tilt in degrees."""
        return OrientationPrior.from_angles(image, self.yaw, self.pitch, self.roll, sigmas)


def read_dji(path: str | os.PathLike[str]) -> DjiRecord:
    """Return DJI's values of a photograph; all NaN without a packet that can be read.

    Raises:
        OSError: the file cannot be read.
    """
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
    """Return the XMP packet of a JPEG file; None without any, or for another format.

    Raises:
        OSError: the file cannot be read.
    """
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
