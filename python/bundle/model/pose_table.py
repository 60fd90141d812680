"""Poses of any input in one form, world_from_camera, and errors of aligned poses.

Reconstructions store cam_from_world, trajectories world_from_body. Here every pose maps points of
the camera (or of the body that the file describes) to the world, so that the translation is the
centre.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base import arrays
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem, strings
from bundle.model.rigid_motions import (
    inverse_poses,
    multiply_poses,
    quaternion_inverse,
    quaternion_multiply,
    unit_poses,
)

Array = NDArray[np.float64]

LARGEST = 1e100  # largest coordinate; squares of larger ones overflow


@dataclass(frozen=True, eq=False, repr=False)
class PoseTable(Displayed):
    """Poses world_from_camera with names or time stamps.

    Attributes:
        poses: (n, 7) as qx qy qz qw x y z: the rotation world_from_camera as unit quaternion, and
            the centre in the length unit of the source.
        names: n names of images; "" for poses without a name.
        timestamps_ns: (n,) time stamps in nanoseconds; None without time stamps.
        format: "tum", "euroc", "kitti", "poses", "g2o", that of a problem, or "memory".

    Raises:
        InputError: an array has the wrong shape, a number is not finite or too large, or a
            quaternion is zero.
    """

    poses: Array
    names: tuple[str, ...] = ()
    timestamps_ns: NDArray[np.int64] | None = None
    format: str = "memory"

    _ARRAYS = arrays.declare(
        poses=arrays.Array(("n", 7), "pose"),
        timestamps_ns=arrays.Array(("n",), dtype=np.int64, default="none"),
    )

    def __post_init__(self) -> None:
        arrays.check_arrays(self, self._ARRAYS)
        poses = self.poses
        arrays.refuse_row(
            (np.abs(poses[:, 4:]) > LARGEST).any(axis=1),
            lambda row: (
                f"poses[{row}]: expected coordinates up to {LARGEST:g}, found {poses[row, 4:]}"
            ),
        )
        names = strings("names", self.names or ("",) * len(poses))
        if len(names) != len(poses):
            raise InputError(f"names: expected {len(poses)}, found {len(names)}")
        object.__setattr__(self, "poses", arrays.freeze(unit_poses(poses)))
        object.__setattr__(self, "names", names)

    @classmethod
    def of_problem(cls, problem: Problem) -> PoseTable:
        """Return the poses of the images of a problem, in its order."""
        poses = inverse_poses(unit_poses(problem.cam_from_world))
        return cls(poses, problem.image_names, None, problem.format)

    @classmethod
    def of_graph(cls, graph: PoseGraph) -> PoseTable:
        """Return the poses of a graph with their names or ids; 2-D poses have z = 0."""
        poses = graph.poses
        if graph.dimension == 2:
            x, y, half = poses.T * [[1], [1], [0.5]]
            zero = np.zeros(len(poses))
            poses = np.column_stack([zero, zero, np.sin(half), np.cos(half), x, y, zero])
        names = graph.names or tuple(map(str, graph.ids.tolist()))
        return cls(poses, names, None, graph.format or "memory")

    def __len__(self) -> int:
        return len(self.poses)

    def inverse(self) -> PoseTable:
        """Return the table for poses that were given as camera_from_world."""
        return PoseTable(inverse_poses(self.poses), self.names, self.timestamps_ns, self.format)

    def _display(self) -> Display:
        named = sum(map(bool, self.names))
        facts = [("names", f"{named} of {len(self)}")]
        if self.timestamps_ns is not None and len(self):
            first, last = int(self.timestamps_ns.min()), int(self.timestamps_ns.max())
            facts.append(("time", f"{first} to {last} ns"))
        return Display(title=f"{plural(len(self), 'pose')} ({self.format})", facts=tuple(facts))


# Errors of aligned poses: of each pose (APE) and from each pose to the next (RPE).
#
# With the aligned estimate P_i and the reference Q_i, rigid motions world_from_camera, the errors
# are those of evo (https://github.com/MichaelGrupp/evo) and of Sturm et al. (IROS 2012):
#
#     absolute, APE:  |p_i - q_i| and the angle of R(Q_i)^T R(P_i),
#     relative, RPE:  E_k = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j),  i = k delta, j = i + delta,
#
# of which the translation's length and the rotation's angle count. The angle 2 atan2(|v|, |w|) of a
# quaternion (v, w) is accurate to rounding near 0 and near 180 degrees.


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

    ``estimate``: (n, 7) aligned poses world_from_camera. ``reference``: (n, 7) poses of the
    reference.
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
