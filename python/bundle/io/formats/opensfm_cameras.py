"""OpenSfM's projection types as camera models.

Coordinates of OpenSfM are relative to max(width, height), from the centre of the image, x right and
y down: pixels are size * x + width / 2 in COLMAP's convention. p = (X, Y) / Z, r2 = p.p; fisheye
types have p = theta / q (X, Y), with q = |(X, Y)| and theta = atan2(q, Z).

    perspective, simple_radial, radial    p (1 + k1 r2 + k2 r4)             (RADIAL, OPENCV)
    brown             p (1 + k1 r2 + k2 r4 + k3 r6) + tangential            (FULL_OPENCV)
    fisheye           p (1 + k1 r2 + k2 r4)                                 (RADIAL_FISHEYE)
    fisheye_opencv    p (1 + k1 r2 + k2 r4 + k3 r6 + k4 r8)                 (OPENCV_FISHEYE)
    fisheye62         p (1 + k1 r2 + ... + k6 r12) + tangential             (see below)
    fisheye624        the same + (s0 r2 + s1 r4, s2 r2 + s3 r4)             (see below)
    dual              a mixture of perspective and fisheye: l p_1 + (1 - l) p_2     (fitted)
    spherical         (atan2(X, Z), atan2(Y, |(X, Z)|)) / 2 pi              (EQUIRECTANGULAR)

The result is multiplied by the focal lengths, and the principal point is added. tangential =
(2 p1 x y + p2 (r2 + 2 x^2), p1 (r2 + 2 y^2) + 2 p2 x y).

All terms of fisheye62 and fisheye624 act on p. RAD_TAN_THIN_PRISM_FISHEYE (Project Aria's
Fisheye624) has the same terms, but those after the radial polynomial act on its result. Both are
one lens if there is only the polynomial or only the other terms. THIN_PRISM_FISHEYE acts on p and
has k1 to k4, p1, p2, s0 and s2. Any other lens is fitted by RAD_TAN_THIN_PRISM_FISHEYE.

Source: opensfm/src/geometry/camera_projections_functions.h, camera_distortions_functions.h.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.io.formats.fitted_lens import NUM_DIRECTIONS, NUM_RADII, fitted_lens, fitted_to_rays
from bundle.io.formats.json_fields import Node

Array = NDArray[np.float64]

_TWO_FOCALS = ("focal_x", "focal_y", "c_x", "c_y")
RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6")
PRISM = ("s0", "s1", "s2", "s3")
_PARAMS = {
    "perspective": ("focal", "k1", "k2"),
    "fisheye": ("focal", "k1", "k2"),
    "dual": ("focal", "k1", "k2", "transition"),
    "brown": (*_TWO_FOCALS, "k1", "k2", "p1", "p2", "k3"),
    "radial": (*_TWO_FOCALS, "k1", "k2"),
    "simple_radial": (*_TWO_FOCALS, "k1"),
    "fisheye_opencv": (*_TWO_FOCALS, "k1", "k2", "k3", "k4"),
    "fisheye62": (*_TWO_FOCALS, *RADIAL, "p1", "p2"),
    "fisheye624": (*_TWO_FOCALS, *RADIAL, "p1", "p2", *PRISM),
    "spherical": (),
}
_OLD_NAMES = {"equirectangular": "spherical"}
_WIDEST = {"dual": 1.2, "fisheye62": 2.0, "fisheye624": 2.0}
"""Largest angle to the axis in radians at which a lens is fitted."""


@dataclass(frozen=True)
class SfmCamera:
    """A camera of OpenSfM: its type, size and parameters by name."""

    type: str
    width: int
    height: int
    params: dict[str, float]

    @property
    def size(self) -> int:
        """Pixels per unit."""
        return max(self.width, self.height)


class Camera(NamedTuple):
    """A camera model with its parameters, and the error of a fit in pixels."""

    model: str
    params: Array
    error: float = 0.0


def read_camera(node: Node) -> SfmCamera:
    """Read a camera.

    Raises:
        InputError: the type is not supported, or a value is invalid.
    """
    given = node.get("projection_type").text()
    kind = _OLD_NAMES.get(given, given)
    if kind not in _PARAMS:
        node.get("projection_type").fail(f"one of {', '.join(_PARAMS)}")
    width, height = (node.get(name).whole() for name in ("width", "height"))
    if not width or not height:
        node.fail("a width and a height above 0")
    params = {name: node.get(name).number() for name in _PARAMS[kind]}
    for name in params:
        if name.startswith("focal") and params[name] <= 0:
            node.get(name).fail("a number above 0")
    return SfmCamera(kind, width, height, params)


def as_model(camera: SfmCamera, place: str) -> Camera:
    """Return the camera model of a camera.

    Raises:
        InputError: no model can represent it.
    """
    p, size = camera.params, camera.size
    if camera.type == "spherical":
        if camera.width != 2 * camera.height:
            raise InputError(
                f"{place}: expected a spherical image twice as wide as high, found "
                f"{camera.width} x {camera.height}"
            )
        return Camera("EQUIRECTANGULAR", np.array([camera.width, camera.height], float))
    middle = np.array([camera.width, camera.height]) / 2
    if "focal" in p:
        base = [p["focal"] * size, *middle]
        if camera.type == "dual":
            return _fitted(camera, middle, place)
        model = "RADIAL" if camera.type == "perspective" else "RADIAL_FISHEYE"
        return Camera(model, np.array([*base, p["k1"], p["k2"]]))
    center = middle + size * np.array([p["c_x"], p["c_y"]])
    base = [p["focal_x"] * size, p["focal_y"] * size, *center]
    if camera.type in ("fisheye62", "fisheye624"):
        return _fisheye624(camera, base, place)
    if camera.type == "fisheye_opencv":
        return Camera("OPENCV_FISHEYE", np.array([*base, p["k1"], p["k2"], p["k3"], p["k4"]]))
    four = [p["k1"], p.get("k2", 0.0), p.get("p1", 0.0), p.get("p2", 0.0)]
    if p.get("k3"):
        return Camera("FULL_OPENCV", np.array([*base, *four, p["k3"], 0, 0, 0]))
    return Camera("OPENCV", np.array([*base, *four]))


def project(camera: SfmCamera, inside: Array) -> Array:
    """Project points (n, 3) in the camera frame by OpenSfM's formula, into its coordinates."""
    p, (x, y, z) = camera.params, inside.T
    if camera.type == "spherical":
        turn = np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        spherical: Array = turn / (2 * np.pi)
        return spherical
    flat = inside[:, :2] / z[:, None]
    radius = np.hypot(x, y)
    angle = np.arctan2(radius, z)
    round_ = inside[:, :2] * np.divide(angle, radius, out=1 / z, where=radius > 0)[:, None]
    if camera.type == "dual":
        uv = p["transition"] * flat + (1 - p["transition"]) * round_
    else:
        uv = round_ if camera.type.startswith("fisheye") else flat
    r2 = (uv * uv).sum(axis=1)
    radial = np.zeros(len(r2))
    for name in reversed(RADIAL):
        radial = r2 * (p.get(name, 0.0) + radial)
    distorted = uv * (1 + radial)[:, None]
    if "s0" in p:
        s0, s1, s2, s3 = (p[name] for name in PRISM)
        distorted += np.column_stack([r2 * (s0 + s1 * r2), r2 * (s2 + s3 * r2)])
    if "p1" in p:
        u, v = uv.T
        distorted[:, 0] += 2 * p["p1"] * u * v + p["p2"] * (r2 + 2 * u * u)
        distorted[:, 1] += p["p1"] * (r2 + 2 * v * v) + 2 * p["p2"] * u * v
    if "focal" in p:
        projected: Array = p["focal"] * distorted
        return projected
    focal, center = np.array([p["focal_x"], p["focal_y"]]), np.array([p["c_x"], p["c_y"]])
    shifted: Array = focal * distorted + center
    return shifted


def _fisheye624(camera: SfmCamera, base: list[float], place: str) -> Camera:
    """Return the exact model of a fisheye62 or fisheye624 lens, or a fitted one.

    Args:
        camera: the camera.
        base: focal lengths and principal point in pixels.
        place: place of the camera for messages.
    """
    p = camera.params
    k = [p[name] for name in RADIAL]
    p1, p2 = p["p1"], p["p2"]
    s0, s1, s2, s3 = (p.get(name, 0.0) for name in PRISM)
    others = [p2, p1, s0, s1, s2, s3]
    if not any(others) and not any(k[4:]):
        return Camera("OPENCV_FISHEYE", np.array([*base, *k[:4]]))
    full = Camera("RAD_TAN_THIN_PRISM_FISHEYE", np.array([*base, *k, *others]))
    if not any(others) or not any(k):
        return full
    if not any([*k[4:], s1, s3]):
        thin = [*base, k[0], k[1], p1, p2, k[2], k[3], s0, s2]
        return Camera("THIN_PRISM_FISHEYE", np.array(thin))
    rays, xy = _rays_inside(camera)
    fit = fitted_to_rays(full.model, (full.model, full.params), rays, xy) if len(rays) else None
    if fit is None:
        raise InputError(f"{place}: expected a lens that {full.model} can represent, found another")
    return Camera(full.model, fit.params, fit.error)


def _rays_inside(camera: SfmCamera) -> tuple[Array, Array]:
    """Return rays of the image on a polar grid, and their pixels.

    The grid ends in each direction where the distance from the axis stops growing.
    """
    angles = np.linspace(0, _WIDEST[camera.type], NUM_RADII + 1)[1:]
    turns = np.arange(2 * NUM_DIRECTIONS) * (np.pi / NUM_DIRECTIONS)
    turn, angle = (grid.ravel() for grid in np.meshgrid(turns, angles, indexing="ij"))
    rays = np.column_stack(
        [np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)]
    )
    projected = project(camera, rays)
    axis = np.array([camera.params["c_x"], camera.params["c_y"]])
    radii = np.linalg.norm(projected - axis, axis=1).reshape(len(turns), len(angles))
    grows = np.logical_and.accumulate(np.diff(radii, axis=1, prepend=0.0) > 0, axis=1)
    half = np.array([camera.width, camera.height]) / 2
    xy = camera.size * projected
    inside = grows.ravel() & (np.abs(xy) <= half).all(axis=1)
    return rays[inside], (xy + half)[inside]


def _fitted(camera: SfmCamera, center: Array, place: str) -> Camera:
    """Fit RADIAL to the rays of a dual camera inside the image."""
    farthest = float(np.hypot(*center)) / camera.size
    angles = np.linspace(0, _WIDEST["dual"], 8 * NUM_RADII + 1)[1:]
    rays = np.column_stack([np.sin(angles), np.zeros(len(angles)), np.cos(angles)])
    radii = project(camera, rays)[:, 0]
    folds = np.diff(radii, prepend=0.0) <= 0
    end = int(np.argmax(folds)) if folds.any() else len(radii)
    inside = np.flatnonzero(radii[:end] <= farthest)
    chosen = inside[:: max(1, len(inside) // NUM_RADII)]
    fit = None
    if len(chosen) > 2:
        focal = camera.params["focal"] * camera.size
        fit = fitted_lens("RADIAL", focal, center, angles[chosen], camera.size * radii[chosen])
    if fit is None:
        raise InputError(f"{place}: expected a lens that RADIAL can represent, found another")
    return Camera("RADIAL", fit.params, fit.error)
