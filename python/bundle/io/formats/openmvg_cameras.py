"""OpenMVG's intrinsics as camera models.

With p = (X, Y) / Z, r2 = p.p, the focal length f and the principal point c, a pixel is f d(p) + c:

    pinhole                  p                                              (SIMPLE_PINHOLE)
    pinhole_radial_k1        p (1 + k1 r2)                                  (SIMPLE_RADIAL)
    pinhole_radial_k3        p (1 + k1 r2 + k2 r4 + k3 r6)                  (RADIAL, FULL_OPENCV)
    pinhole_brown_t2         the same + (2 t1 x y + t2 (r2 + 2 x^2),
                                         t1 (r2 + 2 y^2) + 2 t2 x y)        (OPENCV, FULL_OPENCV)
    fisheye                  p theta (1 + k1 theta^2 + ... + k4 theta^8) / r, theta = atan(r)
                                                                            (OPENCV_FISHEYE)
    spherical                size (atan2(X, Z), atan2(Y, |(X, Z)|)) / 2 pi + (w, h) / 2, with
                             size = max(w, h)                               (EQUIRECTANGULAR)

Source: openMVG/cameras/Camera_Pinhole*.hpp, Camera_Spherical.hpp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.io.formats.json_fields import Node

Array = NDArray[np.float64]

KINDS = {
    "pinhole": ("", 0),
    "pinhole_radial_k1": ("disto_k1", 1),
    "pinhole_radial_k3": ("disto_k3", 3),
    "pinhole_brown_t2": ("disto_t2", 5),
    "fisheye": ("fisheye", 4),
    "spherical": ("", 0),
}
"""Member with the distortion, and the number of its coefficients, by polymorphic_name."""


@dataclass(frozen=True)
class MvgCamera:
    """Intrinsics of OpenMVG."""

    kind: str
    width: int
    height: int
    focal: float
    center: tuple[float, float]
    distortion: tuple[float, ...]


def read_camera(kind: str, data: Node) -> MvgCamera:
    """Read intrinsics from their ``data``.

    Raises:
        InputError: a value is invalid.
    """
    base = data.find("value0") or data
    width, height = (base.get(name).whole() for name in ("width", "height"))
    if kind == "spherical":
        if not width or width != 2 * height:
            base.fail("a spherical image twice as wide as high")
        return MvgCamera(kind, width, height, 1.0, (width / 2, height / 2), ())
    focal = base.get("focal_length").number()
    if focal <= 0:
        base.get("focal_length").fail("a number above 0")
    cx, cy = base.get("principal_point").numbers(2).tolist()
    member, count = KINDS[kind]
    distortion = tuple(data.get(member).numbers(count).tolist()) if count else ()
    return MvgCamera(kind, width, height, focal, (cx, cy), distortion)


def as_model(camera: MvgCamera) -> tuple[str, list[float]]:
    """Return name and parameters of the camera model."""
    one = [camera.focal, *camera.center]
    two = [camera.focal, *one]
    k = camera.distortion
    if camera.kind == "pinhole":
        return "SIMPLE_PINHOLE", one
    if camera.kind == "pinhole_radial_k1":
        return "SIMPLE_RADIAL", [*one, *k]
    if camera.kind == "fisheye":
        return "OPENCV_FISHEYE", [*two, *k]
    if camera.kind == "spherical":
        return "EQUIRECTANGULAR", [camera.width, camera.height]
    t1, t2 = k[3:] if len(k) == 5 else (0.0, 0.0)
    if k[2]:
        return "FULL_OPENCV", [*two, k[0], k[1], t1, t2, k[2], 0.0, 0.0, 0.0]
    return ("OPENCV", [*two, k[0], k[1], t1, t2]) if len(k) == 5 else ("RADIAL", [*one, *k[:2]])


def project(camera: MvgCamera, inside: Array) -> Array:
    """Project points (n, 3) in the camera frame by OpenMVG's formula, in pixels."""
    x, y, z = inside.T
    if camera.kind == "spherical":
        turn = np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        size = max(camera.width, camera.height)
        spherical: Array = turn * size / (2 * np.pi) + np.array(camera.center)
        return spherical
    p = inside[:, :2] / z[:, None]
    r2 = (p * p).sum(axis=1)
    if camera.kind == "fisheye":
        k = camera.distortion
        radius = np.sqrt(r2)
        t = np.arctan(radius)
        s = t * t
        bent = t * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
        p = p * np.divide(bent, radius, out=np.ones_like(bent), where=radius > 0)[:, None]
    elif camera.distortion:
        k1, k2, k3 = (*camera.distortion, 0.0, 0.0)[:3]
        u, v = p.T
        p = p * (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))[:, None]
        if camera.kind == "pinhole_brown_t2":
            t1, t2 = camera.distortion[3:]
            p[:, 0] += 2 * t1 * u * v + t2 * (r2 + 2 * u * u)
            p[:, 1] += t1 * (r2 + 2 * v * v) + 2 * t2 * u * v
    pixels: Array = camera.focal * p + np.array(camera.center)
    return pixels
