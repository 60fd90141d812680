"""Rows of one track: its innovations, and their Jacobians by poses and landmark.

A landmark X is at c = R_c R^T (X - p) + t_c in the camera of a state with rotation R and position p
(world_from_imu), (R_c, t_c) camera_from_imu, and its image is (c_x, c_y) / c_z. With y = R^T (X -
p), rotating R to R Exp(d) moves y by [y]x d, so that

    dc/dd = R_c [y]x,        dc/dp = -R_c R^T,        dc/dX = R_c R^T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arguments import as_array, as_integers
from bundle.base.display import Display, Displayed
from bundle.errors import InputError
from bundle.interface.option_fields import number
from bundle.model.rotations import cross_matrices, rotation_matrices

__all__ = ["TrackRows", "track_rows"]

Array = NDArray[np.float64]

_STEPS = 10  # Gauss-Newton steps for the landmark
_SMALL = 1e-12  # step size at which it stops


@dataclass(frozen=True, eq=False, repr=False)
class TrackRows(Displayed):
    """Linearised track of a landmark.

    Attributes:
        innovation: (m,) observation - prediction, in sigmas.
        by_state: (m, n) derivative of the prediction with respect to the state's tangent
            coordinates.
        by_point: (m, 3) derivative with respect to the landmark.
    """

    innovation: Array
    by_state: Array
    by_point: Array

    def __post_init__(self) -> None:
        for name in ("innovation", "by_state", "by_point"):
            array = as_array(f"TrackRows: {name}", getattr(self, name))
            if not np.isfinite(array).all():
                raise InputError(
                    f"TrackRows: {name}: expected finite numbers, found nan or infinity"
                )
            object.__setattr__(self, name, array)
        rows = len(self.innovation) if self.innovation.ndim == 1 else -1
        if self.by_state.ndim != 2 or len(self.by_state) != rows:
            raise InputError(
                f"TrackRows: expected innovation (m,) and by_state (m, n), found "
                f"{self.innovation.shape} and {self.by_state.shape}"
            )
        if self.by_point.shape != (rows, 3):
            raise InputError(
                f"TrackRows: by_point: expected shape ({rows}, 3), found {self.by_point.shape}"
            )

    def _display(self) -> Display:
        rms = np.sqrt(np.mean(self.innovation**2)) if len(self.innovation) else 0.0
        return Display(
            title=f"TrackRows: {len(self.innovation)} rows",
            facts=(("rms innovation", f"{rms:.3g} sigmas"),),
        )


def track_rows(
    poses: ArrayLike,
    xy: ArrayLike,
    columns: ArrayLike,
    size: int,
    *,
    camera_from_imu: ArrayLike = (0.0, 0, 0, 1, 0, 0, 0),
    sigma: float,
    point: ArrayLike | None = None,
) -> TrackRows:
    """Return the rows of a track observed from k poses.

    Args:
        poses: (k, 7) world_from_imu, qx qy qz qw tx ty tz, one per observation.
        xy: (k, 2) normalised image coordinates.
        columns: (k,) first of the 6 tangent coordinates of each pose in the state: rotation (R
            Exp(d)), position (world).
        size: number n of tangent coordinates of the state.
        camera_from_imu: (7,).
        sigma: standard deviation of the observations in normalised coordinates: pixels / focal
            length.
        point: (3,) landmark in the world; None: triangulated by least squares of the image
            coordinates.

    Raises:
        InputError: shapes do not fit, numbers are not finite, or the landmark is behind a camera;
            if it was triangulated, the track has too little parallax.
    """
    given = _finite("poses", poses, 7)
    image = _finite("xy", xy, 2)
    first = as_integers("columns", columns)
    size = number("size", size, whole=True, minimum=6)
    sigma = number("sigma", sigma, above=0)
    extrinsics = _finite("camera_from_imu", [camera_from_imu], 7)
    if not len(given) == len(image) == first.size or first.ndim != 1 or not len(given):
        raise InputError(
            "poses, xy, columns: expected the same number of rows, at least 1, found "
            f"{len(given)}, {len(image)} and {first.size}"
        )
    if (first < 0).any() or (first + 6 > size).any():
        raise InputError(f"columns: expected from 0 to {size - 6}, found {first.tolist()}")
    world_from_imu = rotation_matrices(given[:, :4])
    camera = rotation_matrices(extrinsics[:, :4])[0]
    cam_from_world = camera @ world_from_imu.transpose(0, 2, 1)
    offset = extrinsics[0, 4:] - np.einsum("kij,kj->ki", cam_from_world, given[:, 4:])
    if point is None:
        landmark = _triangulate(cam_from_world, offset, image)
    else:
        landmark = _finite("point", [point], 3)[0]
    in_camera = cam_from_world @ landmark + offset
    if not (in_camera[:, 2] > 0).all():
        if point is None:
            raise InputError(
                "xy: expected a track with parallax, found one with its least-squares landmark "
                "behind its cameras"
            )
        depth = in_camera[:, 2].min()
        raise InputError(f"point: expected in front of all cameras, found a depth of {depth:.3g}")
    by_camera = _project_jacobian(in_camera) / sigma
    by_point = by_camera @ cam_from_world
    in_imu = np.einsum("kji,kj->ki", world_from_imu, landmark - given[:, 4:])
    by_rotation = by_camera @ camera @ cross_matrices(in_imu)
    by_state = np.zeros((len(given), 2, size))
    for k, column in enumerate(first):
        by_state[k, :, column : column + 3] += by_rotation[k]
        by_state[k, :, column + 3 : column + 6] -= by_point[k]
    innovation = (image - in_camera[:, :2] / in_camera[:, 2:]) / sigma
    return TrackRows(innovation.ravel(), by_state.reshape(-1, size), by_point.reshape(-1, 3))


def _triangulate(rotations: Array, offsets: Array, image: Array) -> Array:
    """Return the landmark of least squares; nan if it is behind the first camera or at infinity.

    Gauss-Newton on (a, b, 1 / z) in the first camera, starting at infinity: c ~ R (a, b, 1) + t /
    z.
    """
    turns = rotations @ rotations[0].T
    shifts = offsets - turns @ offsets[0]
    landmark = np.array([image[0, 0], image[0, 1], 0.0])
    with np.errstate(divide="ignore", invalid="ignore"):  # a point on a camera's plane becomes nan
        for _ in range(_STEPS):
            in_camera = turns @ np.append(landmark[:2], 1.0) + landmark[2] * shifts
            by_camera = _project_jacobian(in_camera)
            by_depth = np.einsum("kij,kj->ki", by_camera, shifts)
            jacobian = np.concatenate([by_camera @ turns[:, :, :2], by_depth[:, :, None]], axis=2)
            residual = in_camera[:, :2] / in_camera[:, 2:] - image
            if not np.isfinite(residual).all():
                break
            step = np.linalg.lstsq(jacobian.reshape(-1, 3), -residual.ravel(), rcond=None)[0]
            landmark = landmark + step
            if np.abs(step).max() < _SMALL * max(1.0, np.abs(landmark).max()):
                break
    if not landmark[2] > 0:
        return np.full(3, np.nan)
    point: Array = rotations[0].T @ (np.append(landmark[:2], 1.0) / landmark[2] - offsets[0])
    return point


def _project_jacobian(in_camera: Array) -> Array:
    """Return the derivative (k, 2, 3) of (x, y) / z."""
    jacobian = np.zeros((len(in_camera), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1 / in_camera[:, 2]
    jacobian[:, :, 2] = -in_camera[:, :2] / in_camera[:, 2:] ** 2
    return jacobian


def _finite(name: str, value: Any, width: int) -> Array:
    array = as_array(name, value)
    if array.ndim != 2 or array.shape[1] != width:
        raise InputError(f"{name}: expected shape (k, {width}), found {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, found nan or infinity")
    return array
