"""Errors of aligned poses: of each pose (APE) and from each pose to the next (RPE).

With the aligned estimate P_i and the reference Q_i, rigid motions world_from_camera, the errors are
those of evo (https://github.com/MichaelGrupp/evo) and of Sturm et al. (IROS 2012):

    absolute, APE:  |p_i - q_i| and the angle of R(Q_i)^T R(P_i),
    relative, RPE:  E_k = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j),  i = k delta, j = i + delta,

of which the translation's length and the rotation's angle count. The angle 2 atan2(|v|, |w|) of a
quaternion (v, w) is accurate to rounding near 0 and near 180 degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.rigid_motions import inverse_poses, multiply_poses
from bundle.model.rotations import quaternion_inverse, quaternion_multiply

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of errors; NaN without errors."""

    rmse: float
    mean: float
    median: float
    max: float

    @classmethod
    def of(cls, errors: Array) -> ErrorStatistics:
        """Return the statistics of errors (n,)."""
        if not len(errors):
            return cls(np.nan, np.nan, np.nan, np.nan)
        top = float(errors.max())
        unit = top if 0 < top < np.inf else 1.0  # squares of extreme lengths must not overflow
        return cls(
            rmse=unit * float(np.sqrt(((errors / unit) ** 2).mean())),
            mean=float(errors.mean()),
            median=float(np.median(errors)),
            max=top,
        )


def absolute_errors(estimate: Array, reference: Array) -> tuple[Array, Array]:
    """Return position errors (n,) in length units, and rotation errors (n,) in degrees.

    Args:
        estimate: (n, 7) aligned poses world_from_camera.
        reference: (n, 7) poses of the reference.
    """
    position = np.linalg.norm(estimate[:, 4:] - reference[:, 4:], axis=1)
    turn = quaternion_multiply(quaternion_inverse(reference[:, :4]), estimate[:, :4])
    return position, angles_of(turn)


def relative_errors(estimate: Array, reference: Array, delta: int = 1) -> tuple[Array, Array]:
    """Return errors of the motions over ``delta`` poses, as :func:`absolute_errors` does.

    The motions do not overlap: they go from pose 0 to pose delta, from there to 2 delta, and so on.
    """
    rows = np.arange(0, len(reference), delta)
    motions = [
        multiply_poses(inverse_poses(poses[rows[:-1]]), poses[rows[1:]])
        for poses in (reference, estimate)
    ]
    error = multiply_poses(inverse_poses(motions[0]), motions[1])
    return np.linalg.norm(error[:, 4:], axis=1), angles_of(error[:, :4])


def angles_of(quaternions: Array) -> Array:
    """Return the rotation angles (n,), in degrees from 0 to 180, of unit quaternions (n, 4)."""
    sine = np.linalg.norm(quaternions[:, :3], axis=1)
    angles: Array = np.degrees(2 * np.arctan2(sine, np.abs(quaternions[:, 3])))
    return angles
