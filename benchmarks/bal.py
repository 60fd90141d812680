"""BAL files through NumPy, for the peers: nothing here uses bundle.

A BAL camera is (rotation vector, translation, f, k1, k2) of a frame that looks along -z:
``P = R X + t``, ``p = -P[:2] / P[2]``, pixel ``f (1 + k1 |p|^2 + k2 |p|^4) p``, y upwards. With
``D = diag(1, -1, -1)`` applied to the frame and image y negated this is COLMAP's RADIAL model with
principal point (0, 0).
"""

from __future__ import annotations

import bz2
import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# BAL frame -> COLMAP frame, and the sign of image coordinates.
FLIP_FRAME = np.array([1.0, -1.0, -1.0])
FLIP_IMAGE = np.array([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Bal:
    """The numbers of a BAL file.

    Attributes:
        camera_index: (num_observations,) camera of each observation.
        point_index: (num_observations,) point of each observation.
        xy: (num_observations, 2) pixels, y upwards.
        cameras: (num_cameras, 9) rotation vector, translation, f, k1, k2.
        points: (num_points, 3) world coordinates.
    """

    camera_index: NDArray[np.int64]
    point_index: NDArray[np.int64]
    xy: NDArray[np.float64]
    cameras: NDArray[np.float64]
    points: NDArray[np.float64]


def open_text(path: Path) -> bytes:
    """Return the decompressed content of a .txt, .bz2 or .gz file."""
    opener: Any = {".bz2": bz2.open, ".gz": gzip.open}.get(path.suffix, open)
    with opener(path, "rb") as file:
        content: bytes = file.read()
    return content


def read(path: Path) -> Bal:
    """Read a BAL file; ``fromstring`` with a separator is NumPy's quickest parser of text."""
    numbers = np.fromstring(open_text(path).decode("ascii"), sep=" ")
    num_cameras, num_points, num_observations = (int(count) for count in numbers[:3])
    observations_end = 3 + 4 * num_observations
    cameras_end = observations_end + 9 * num_cameras
    observations = numbers[3:observations_end].reshape(num_observations, 4)
    return Bal(
        camera_index=observations[:, 0].astype(np.int64),
        point_index=observations[:, 1].astype(np.int64),
        xy=np.ascontiguousarray(observations[:, 2:]),
        cameras=numbers[observations_end:cameras_end].reshape(num_cameras, 9).copy(),
        points=numbers[cameras_end:].reshape(num_points, 3).copy(),
    )


def write(bal: Bal, path: Path) -> None:
    """Write plain BAL text; every number reads back exactly."""
    rows = np.column_stack([bal.camera_index, bal.point_index, bal.xy]).ravel().tolist()
    num_observations = len(bal.xy)
    with path.open("w") as file:
        file.write(f"{len(bal.cameras)} {len(bal.points)} {num_observations}\n")
        # One formatting call for all rows: several times quicker than numpy.savetxt.
        file.write(("%d %d %.17g %.17g\n" * num_observations) % tuple(rows))
        for block in (bal.cameras, bal.points):
            file.write("\n".join(map(repr, block.ravel().tolist())) + "\n")


def rotation_matrices(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, 3, 3) rotations of (n, 3) rotation vectors, by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.where(angles > 0, angles, 1.0)[:, None]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
    cross -= cross.transpose(0, 2, 1)
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    rotations: NDArray[np.float64] = np.eye(3) + sin * cross + (1.0 - cos) * (cross @ cross)
    return rotations


def rotation_vectors(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, 3) rotation vectors of (n, 3, 3) rotations, through quaternions.

    The quaternion is the eigenvector of Bar-Itzhack's symmetric matrix, accurate at every angle.
    """
    matrix = np.empty((len(matrices), 4, 4))
    trace = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    matrix[:, :3, :3] = matrices + matrices.transpose(0, 2, 1) - trace * np.eye(3)
    skew = matrices - matrices.transpose(0, 2, 1)
    matrix[:, 3, :3] = matrix[:, :3, 3] = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], 1)
    matrix[:, 3, 3] = trace[:, 0, 0]
    quaternions = np.linalg.eigh(matrix)[1][:, :, -1]
    quaternions *= np.where(quaternions[:, 3:] < 0, -1.0, 1.0)
    sines = np.linalg.norm(quaternions[:, :3], axis=1, keepdims=True)
    angles = 2.0 * np.arctan2(sines, quaternions[:, 3:])
    return quaternions[:, :3] * np.where(sines > 0, angles / np.where(sines > 0, sines, 1.0), 2.0)


def residuals(bal: Bal, behind: str = "zero") -> NDArray[np.float64]:
    """Return (num_observations, 2) projection minus measurement in pixels.

    An observation whose point lies behind its camera counts as zero, as in COLMAP and GTSAM, or
    keeps its "algebraic" residual, as in Ceres' example.
    """
    cameras = bal.cameras[bal.camera_index]
    rotations = rotation_matrices(bal.cameras[:, :3])[bal.camera_index]
    points = np.einsum("nij,nj->ni", rotations, bal.points[bal.point_index]) + cameras[:, 3:6]
    in_front = (points[:, 2] < 0.0) if behind == "zero" else (points[:, 2] != 0.0)
    plane = -points[:, :2] / np.where(in_front, points[:, 2], -1.0)[:, None]
    square = np.einsum("ni,ni->n", plane, plane)
    scale = cameras[:, 6] * (1.0 + square * (cameras[:, 7] + square * cameras[:, 8]))
    return np.where(in_front[:, None], scale[:, None] * plane - bal.xy, 0.0)


def cost(bal: Bal, behind: str = "zero") -> float:
    """Return half the sum of squared residuals: the oracle every solver's final cost is held to."""
    errors = residuals(bal, behind).ravel()
    return 0.5 * float(errors @ errors)
