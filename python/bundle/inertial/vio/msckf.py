"""Update of a multi-state constraint Kalman filter (MSCKF) by tracks without landmark states.

Mourikis and Roumeliotis, "A Multi-State Constraint Kalman Filter for Vision-aided Inertial
Navigation", ICRA 2007. A track's innovation is r = H d + F f + n with the error d of the state, the
error f of the landmark, and white noise n of variance 1. The orthonormal columns of N, with N^T F =
0, span the left null space of F:

    N^T r = (N^T H) d + N^T n,

with 2 M - 3 rows for M views; N^T n is white like n. This eliminates the landmark exactly as a
Schur complement does: with the projection N N^T = I - F (F^T F)^-1 F^T,

    (N^T H)^T (N^T H) = H^T H - H^T F (F^T F)^-1 F^T H.

The rows of all tracks together outnumber the coordinates of the state. A QR factorisation A = Q T
compresses them: T replaces A, and Q^T r the innovation. The update is Kalman's in Joseph's form,
with S = T P T^T + I and K = P T^T S^-1:

    d = K r,        P <- (I - K T) P (I - K T)^T + K K^T.

The rows of one track are its innovations and their Jacobians. A landmark X is at c = R_c R^T (X -
p) + t_c in the camera of a state with rotation R and position p (world_from_imu), (R_c, t_c)
camera_from_imu, and its image is (c_x, c_y) / c_z. With y = R^T (X - p), rotating R to R Exp(d)
moves y by [y]x d, so that

    dc/dd = R_c [y]x,        dc/dp = -R_c R^T,        dc/dX = R_c R^T.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array as Declared
from bundle.base.arrays import as_array, as_declared, as_integers, check_arrays, check_type, declare
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import cross_matrices, rotation_matrices

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

    _ARRAYS = declare(
        innovation=Declared(("m",), "finite"),
        by_state=Declared(("m", "n"), "finite"),
        by_point=Declared(("m", 3), "finite"),
    )

    def __post_init__(self) -> None:
        check_arrays(self, self._ARRAYS, "TrackRows: ")

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
    given = as_declared("poses", poses, Declared(("k", 7), "finite"))
    image = as_declared("xy", xy, Declared(("k", 2), "finite"))
    first = as_integers("columns", columns)
    size = number("size", size, whole=True, minimum=6)
    sigma = number("sigma", sigma, above=0)
    extrinsics = as_declared("camera_from_imu", [camera_from_imu], Declared(("k", 7), "finite"))
    if not len(given) == len(image) == first.size or first.ndim != 1 or not len(given):
        raise InputError(
            "poses, xy, columns: expected the same number of rows, at least 1, found "
            f"{len(given)}, {len(image)} and {first.size}"
        )
    if (first < 0).any() or (first + 6 > size).any():
        raise InputError(f"columns: expected indices from 0 to {size - 6}, found {first.tolist()}")
    world_from_imu = rotation_matrices(given[:, :4])
    camera = rotation_matrices(extrinsics[:, :4])[0]
    cam_from_world = camera @ world_from_imu.transpose(0, 2, 1)
    offset = extrinsics[0, 4:] - np.einsum("kij,kj->ki", cam_from_world, given[:, 4:])
    if point is None:
        landmark = _triangulate(cam_from_world, offset, image)
    else:
        landmark = as_declared("point", [point], Declared(("k", 3), "finite"))[0]
    in_camera = cam_from_world @ landmark + offset
    if not (in_camera[:, 2] > 0).all():
        if point is None:
            raise InputError(
                "xy: expected a track with parallax, found a track whose least-squares landmark is "
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
    """Return the least-squares landmark, or nan, by Gauss-Newton on (a, b, 1 / z) from infinity."""
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


_NO_PARALLAX = 1e-7  # smallest singular value of F with columns scaled to 1


@dataclass(frozen=True, eq=False, repr=False)
class MsckfUpdate(Displayed):
    """Update of a state by tracks.

    Attributes:
        step: (n,) step of the state's tangent coordinates.
        covariance: (n, n) after the update.
        rejected: position of each left-out track, and the reason.
        nis: (number of tracks,) normalised innovation squared per row of the null space; about 1
            for a healthy track, nan without a null space.
        num_rows: rows of all used tracks, without their landmarks.
        num_compressed_rows: rows after the compression.
    """

    step: Array
    covariance: Array
    rejected: tuple[tuple[int, str], ...]
    nis: Array
    num_rows: int
    num_compressed_rows: int

    def _display(self) -> Display:
        used = len(self.nis) - len(self.rejected)
        return Display(
            title=f"MsckfUpdate: {used} of {len(self.nis)} tracks",
            facts=(
                ("rows", f"{self.num_rows}, compressed to {self.num_compressed_rows}"),
                *((f"track {place}", why) for place, why in self.rejected),
            ),
        )


def msckf_update(
    covariance: ArrayLike, tracks: Sequence[TrackRows], *, max_nis: float | None = None
) -> MsckfUpdate:
    """Return the update of a state by tracks, with their landmarks projected out.

    Args:
        covariance: (n, n) in the state's tangent coordinates, symmetric positive semidefinite.
        tracks: tracks from :func:`bundle.track_rows`, at one estimate.
        max_nis: tracks with a larger NIS per row are left out; None: no limit. 2 leaves out 3 % of
            healthy tracks of 6 views.

    Raises:
        InputError: shapes do not fit, or numbers are not finite.
    """
    before = as_array("covariance", covariance)
    size = len(before) if before.ndim else 0
    if before.shape != (size, size) or not size or not np.isfinite(before).all():
        raise InputError(f"covariance: expected finite numbers (n, n), found shape {before.shape}")
    scale = np.abs(before).max()
    if np.abs(before - before.T).max() > 1e-9 * scale:
        raise InputError("covariance: expected a symmetric matrix, found an asymmetric matrix")
    limit = np.inf if max_nis is None else number("max_nis", max_nis, above=0)
    rejected, nis, rows, innovations = [], np.full(len(tracks), np.nan), [], []
    for place, track in enumerate(tracks):
        check_type(f"tracks[{place}]", track, TrackRows)
        if track.by_state.shape[1] != size:
            raise InputError(
                f"tracks[{place}]: expected {size} coordinates, as in the covariance, found "
                f"{track.by_state.shape[1]}"
            )
        null_space = _left_null_space(track.by_point)
        if null_space is None:
            rejected.append((place, "no parallax: the views do not determine a landmark"))
            continue
        by_state, innovation = null_space.T @ track.by_state, null_space.T @ track.innovation
        spread = by_state @ before @ by_state.T + np.eye(len(by_state))
        nis[place] = innovation @ np.linalg.solve(spread, innovation) / len(innovation)
        if nis[place] > limit:
            rejected.append((place, f"NIS {nis[place]:.3g} per row, above {limit:g}"))
            continue
        rows.append(by_state)
        innovations.append(innovation)
    if not rows:
        nothing = before.copy()
        return MsckfUpdate(np.zeros(size), nothing, tuple(rejected), nis, 0, 0)
    stacked, right = np.vstack(rows), np.concatenate(innovations)
    compressed = stacked
    if len(stacked) > size:
        q, compressed = np.linalg.qr(stacked)
        right = q.T @ right
    gain = np.linalg.solve(
        compressed @ before @ compressed.T + np.eye(len(compressed)), compressed @ before
    ).T
    keep = np.eye(size) - gain @ compressed
    after = keep @ before @ keep.T + gain @ gain.T
    return MsckfUpdate(
        step=gain @ right,
        covariance=(after + after.T) / 2,
        rejected=tuple(rejected),
        nis=nis,
        num_rows=len(stacked),
        num_compressed_rows=len(compressed),
    )


def _left_null_space(by_point: Array) -> Array | None:
    """Return N (m, m - 3), or None if the views determine fewer than 3 landmark directions."""
    if len(by_point) < 4:
        return None
    scaled = by_point / np.maximum(np.linalg.norm(by_point, axis=0), np.finfo(float).tiny)
    if np.linalg.svd(scaled, compute_uv=False)[-1] < _NO_PARALLAX:
        return None
    q, _ = np.linalg.qr(by_point, mode="complete")
    return q[:, 3:]
