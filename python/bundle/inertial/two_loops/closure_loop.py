"""Closure loop: a growing pose graph of keyframes, solved on its own thread, and files of closures.

Consecutive keyframes are connected by their relative motion in the window's world at the time of
their arrival. If the ring has lost a keyframe, the motion between its neighbours connects them. A
solve holds the first keyframe constant and gives the pose X of the newest one. In the window this
keyframe has the pose O. The correction is the motion about the vertical that moves O to X, with the
stamp of that keyframe.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array as Declared
from bundle.base.arrays import as_array, as_declared, check_function, check_type
from bundle.base.display import Display
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.inertial.two_loops.loop_thread import Ring, SolveLoop
from bundle.inertial.two_loops.pose_publisher import Correction, YawMotion
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.io.sequences.trajectory_files import read_csv
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.rigid_motions import inverse_poses, multiply_poses, unit_poses
from bundle.solving.solve import solve

Array = NDArray[np.float64]

_FIRST_ROWS = 64


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Keyframe of a window.

    Attributes:
        timestamp_ns: later than that of the previous keyframe.
        pose: (7,) world_from_imu in the window's world, qx qy qz qw tx ty tz.
        information: (6, 6) of the motion since the previous keyframe, rotation first, or a number
            that multiplies the identity.

    Raises:
        InputError: a number is not finite.
    """

    timestamp_ns: int
    pose: ArrayLike
    information: ArrayLike = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "timestamp_ns", int(self.timestamp_ns))
        object.__setattr__(self, "pose", _as_pose("Keyframe: pose", self.pose))
        matrix = _as_information("Keyframe: information", self.information)
        object.__setattr__(self, "information", matrix)


@dataclass(frozen=True, eq=False)
class Closure:
    """Loop closure: measured relative pose of two keyframes.

    Attributes:
        first_ns: time of a keyframe.
        second_ns: time of another keyframe.
        measurement: (7,) pose of the second in the frame of the first.
        information: (6, 6), rotation first, or a number.

    Raises:
        InputError: a number is not finite, or both times are the same.
    """

    first_ns: int
    second_ns: int
    measurement: ArrayLike
    information: ArrayLike = 1.0

    def __post_init__(self) -> None:
        if self.first_ns == self.second_ns:
            raise InputError("Closure: expected two different keyframes, found the same twice")
        measurement = _as_pose("Closure: measurement", self.measurement)
        object.__setattr__(self, "measurement", measurement)
        matrix = _as_information("Closure: information", self.information)
        object.__setattr__(self, "information", matrix)


class ClosureLoop(SolveLoop):
    """Solver of a pose graph when a closure arrives; it corrects a publisher.

    The solve releases the interpreter, and the loop itself only copies arrays. The solve therefore
    delays no pose, even if it takes long.

    Args:
        corrections: ring of a :class:`PosePublisher`.
        solver: function from a :class:`bundle.PoseGraph` with a fixed first pose to its refined
            poses (n, 7); None: :func:`bundle.solve` on one thread.
        capacity: keyframes, and closures, that can wait during a solve.

    Raises:
        InputError: an argument has the wrong type or range.
    """

    def __init__(
        self,
        corrections: Ring[Correction],
        *,
        solver: Callable[[PoseGraph], Array] | None = None,
        capacity: int = 64,
    ) -> None:
        check_type("ClosureLoop: corrections", corrections, Ring)
        check_function("ClosureLoop: solver", solver)
        self._corrections = corrections
        self._solver = solver or solved_on_one_thread
        self._keyframes: Ring[Keyframe] = Ring(capacity)
        self._closures: Ring[Closure] = Ring(capacity)
        self._places: dict[int, int] = {}  # by timestamp
        self._window_poses = _Rows(7)
        self._poses = _Rows(7)  # in the graph's world
        self._edges = _Rows(2)
        self._measurements = _Rows(7)
        self._information = _Rows(36)
        self._newest_ns = 0
        self._last_put_ns: int | None = None
        self._num_closures = self._num_unknown = 0
        self._start("bundle closures")

    @property
    def num_lost(self) -> int:
        """Number of keyframes and closures that the rings lost during a solve."""
        return self._keyframes.num_lost + self._closures.num_lost

    @property
    def num_closures(self) -> int:
        """Number of closures in the graph."""
        return self._num_closures

    @property
    def num_unknown(self) -> int:
        """Number of closures whose keyframes are unknown or lost."""
        return self._num_unknown

    def put_keyframe(self, keyframe: Keyframe) -> None:
        """Queue a keyframe; return at once.

        Raises:
            InputError: its time is not after that of the previous keyframe.
        """
        check_type("ClosureLoop.put_keyframe", keyframe, Keyframe)
        if self._last_put_ns is not None and keyframe.timestamp_ns <= self._last_put_ns:
            raise InputError(
                f"Keyframe: timestamp_ns: expected after {self._last_put_ns}, "
                f"found {keyframe.timestamp_ns}"
            )
        self._last_put_ns = keyframe.timestamp_ns
        self._keyframes.put(keyframe)
        self._news.set()

    def put_closure(self, closure: Closure) -> None:
        """Queue a closure, after its keyframes; return at once."""
        check_type("ClosureLoop.put_closure", closure, Closure)
        self._closures.put(closure)
        self._news.set()

    def _work(self) -> None:
        closures = self._closures.take_all()  # before the keyframes, which were queued earlier
        for keyframe in self._keyframes.take_all():
            self._add_keyframe(keyframe)
        known = [self._add_closure(closure) for closure in closures]
        if not any(known):
            return
        count = len(self._poses.rows)
        fixed = np.zeros(count, bool)
        fixed[0] = True
        graph = PoseGraph(
            poses=self._poses.rows.copy(),
            edges=self._edges.rows.astype(np.int32),
            measurements=self._measurements.rows.copy(),
            information=self._information.rows.reshape(-1, 6, 6).copy(),
            fixed=fixed,
        )
        refined = self._solver(graph)
        self._poses.rows[:] = refined
        self._num_solves += 1
        motion = YawMotion.between(self._window_poses.rows[-1], refined[-1])
        self._corrections.put(Correction(self._newest_ns, motion, count, self._num_closures))

    def _add_keyframe(self, keyframe: Keyframe) -> None:
        pose = np.asarray(keyframe.pose)[None]
        place = len(self._places)
        if place:
            moved = multiply_poses(inverse_poses(self._window_poses.rows[-1:]), pose)
            self._edges.append((place - 1, place))
            self._measurements.append(moved[0])
            self._information.append(np.asarray(keyframe.information).ravel())
            self._poses.append(multiply_poses(self._poses.rows[-1:], moved)[0])
        else:
            self._poses.append(pose[0])
        self._window_poses.append(pose[0])
        self._places[keyframe.timestamp_ns] = place
        self._newest_ns = keyframe.timestamp_ns

    def _add_closure(self, closure: Closure) -> bool:
        places = [self._places.get(int(t)) for t in (closure.first_ns, closure.second_ns)]
        if places[0] is None or places[1] is None:
            self._num_unknown += 1
            return False
        self._edges.append((places[0], places[1]))
        self._measurements.append(closure.measurement)
        self._information.append(np.asarray(closure.information).ravel())
        self._num_closures += 1
        return True

    def _display(self) -> Display:
        return Display(
            title=f"ClosureLoop: {len(self._places)} keyframes, {self._num_closures} closures",
            facts=(
                ("solves", str(self._num_solves)),
                ("lost", f"{self.num_lost}, closures of unknown keyframes {self._num_unknown}"),
            ),
        )


class _Rows:
    """Growing array of rows that is not copied for every new row."""

    def __init__(self, width: int) -> None:
        self._all = np.empty((_FIRST_ROWS, width))
        self._count = 0

    @property
    def rows(self) -> Array:
        return self._all[: self._count]

    def append(self, row: ArrayLike) -> None:
        if self._count == len(self._all):
            self._all = np.vstack([self._all, np.empty_like(self._all)])
        self._all[self._count] = row
        self._count += 1


def solved_on_one_thread(graph: PoseGraph) -> Array:
    """Return the refined poses (n, 7)."""
    return solve(graph, num_threads=1).problem.poses


def _as_pose(name: str, value: ArrayLike) -> Array:
    pose = as_declared(name, value, Declared((7,), "pose"))
    unit: Array = unit_poses(pose[None])[0]
    return unit


def _as_information(name: str, value: ArrayLike) -> Array:
    matrix = as_array(name, value)
    if matrix.ndim == 0:
        matrix = float(matrix) * np.eye(6)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise InputError(
            f"{name}: expected finite numbers (6, 6) or one number, found {matrix.shape}"
        )
    return matrix


# Files of loop closures: a csv of stamps and relative poses, or the edges of a g2o file.
#
# A line of the csv is ``first_timestamp_ns, second_timestamp_ns, tx, ty, tz, qx, qy, qz, qw,
# sigma_position, sigma_rotation``: the IMU pose at the second stamp in its frame at the first, and
# standard deviations in metres and degrees. In a g2o file the ids of the vertices are the stamps.

_STAMPS = ("first_timestamp_ns", "second_timestamp_ns")
_NUMBERS = ("tx", "ty", "tz", "qx", "qy", "qz", "qw", "sigma_position", "sigma_rotation")


def load_closures(path: str | os.PathLike[str]) -> tuple[Closure, ...]:
    """Read the closures of a file, sorted by the stamp of their later end.

    Raises:
        InputError: a line has a wrong format, a sigma is not above 0, a quaternion does not have
            norm 1, or an edge is planar; one line with file, line, expected and found.
        OSError: the file cannot be read.
    """
    path = as_path(path)
    found = _of_g2o(path) if is_pose_graph_file(path) else _of_csv(path)
    if not found:
        raise InputError(f"{shown(path)}: expected closures, found 0")
    return tuple(sorted(found, key=lambda closure: max(closure.first_ns, closure.second_ns)))


def _of_csv(path: os.PathLike[str]) -> list[Closure]:
    table = read_csv(path, _STAMPS, _NUMBERS)
    closures = []
    for row, (stamps, numbers) in enumerate(zip(table.whole, table.numbers, strict=True)):
        norm = float(np.linalg.norm(numbers[3:7]))
        if not np.isfinite(numbers).all() or not abs(norm - 1) < 0.01:
            raise InputError(
                f"{table.place(row)}: expected finite numbers and a quaternion of norm 1, found "
                f"norm {norm:g}"
            )
        if not (numbers[7:] > 0).all():
            raise InputError(
                f"{table.place(row)}: expected sigmas above 0, found {numbers[7]:g}, {numbers[8]:g}"
            )
        sigmas = np.repeat([np.radians(numbers[8]), numbers[7]], 3)
        if stamps[0] == stamps[1]:
            raise InputError(
                f"{table.place(row)}: expected two different stamps, found the same twice"
            )
        pose = np.concatenate([numbers[3:7], numbers[:3]])
        information = np.diag(sigmas**-2.0)
        closures.append(Closure(int(stamps[0]), int(stamps[1]), pose, information))
    return closures


def _of_g2o(path: str | os.PathLike[str]) -> list[Closure]:
    graph = load_g2o(path)
    if graph.dimension != 3:
        raise InputError(f"{shown(path)}: expected edges EDGE_SE3:QUAT, found planar edges")
    stamps = graph.ids[graph.edges].tolist()
    rows = zip(stamps, graph.measurements, graph.information, strict=True)
    return [Closure(first, second, pose, matrix) for (first, second), pose, matrix in rows]
