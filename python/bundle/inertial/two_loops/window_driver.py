"""Driver of a sliding window in a window loop; it passes keyframes to a closure loop.

After a slow solve, several images are waiting at the next call: the newest is solved, the others
are skipped, and their samples join its interval.

Closures connect any two times between solved images. Let A and B be the window's poses of the
nearest keyframes, and a and b the interpolated poses at the times themselves. The closure M of b in
the frame of a becomes

    (A^-1 a) M (B^-1 b)^-1,

as the pose of keyframe B in the frame of keyframe A. Over fractions of a second the window is
accurate, even if it has drifted far. The information of the closure is unchanged.

The motion between keyframes has the sigmas EDGE_TURN for rotation, and EDGE_SHIFT plus EDGE_SHARE
of its length for translation. They weigh the odometry against closures, which have their own
sigmas.
"""

from __future__ import annotations

import numpy as np

from bundle.inertial.two_loops.closure_loop import Closure, ClosureLoop, Keyframe
from bundle.inertial.two_loops.pose_publisher import Solution
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.inertial.vio.window_run import WindowRun
from bundle.model.rigid_motions import inverse_poses, multiply_poses

EDGE_TURN = np.radians(0.1)
EDGE_SHIFT, EDGE_SHARE = 2e-3, 0.01  # m; share of the length


class WindowDriver:
    """Solver of a sequence's images on the thread of a :class:`WindowLoop`.

    Args:
        run: window that has started.
        closures: closures sorted by the time of their later end.
    """

    def __init__(self, run: WindowRun, closures: tuple[Closure, ...]) -> None:
        self.run = run
        self.num_left_out = 0
        self.num_outside = 0
        self._keyframes: list[int] = []  # in the stamps of the run
        self._closures = list(closures)
        self._graph: ClosureLoop | None = None

    def join(self, graph: ClosureLoop) -> None:
        """Pass keyframes and closures to a loop from now on."""
        self._graph = graph
        for place in range(len(self.run.stamps)):
            self._put_keyframe(place)

    def solve(self, frames: list[int], deadline: float) -> Solution | None:
        """Solve the newest of some images; return None if tracking is lost."""
        del deadline  # the window's own budget is within that of the loop
        run = self.run
        if run.lost:
            return None
        self.num_left_out += len(frames) - 1
        record = run.add(frames[-1])
        if run.lost:
            return None
        if record is not None and self._graph is not None:
            self._put_keyframe(len(run.stamps) - 1)
            self._put_closures(run.stamps[-1])
        return Solution(run.stamps[-1], run.states[-1])

    @property
    def num_closures_left(self) -> int:
        """Number of closures with a later end after the newest keyframe."""
        return len(self._closures)

    def _put_keyframe(self, place: int) -> None:
        assert self._graph is not None
        stamp, state = self.run.stamps[place], self.run.states[place]
        length = 0.0
        if self._keyframes:
            before = self.run.states[self._keyframes[-1]]
            length = float(np.linalg.norm(state[4:7] - before[4:7]))
        sigmas = np.repeat([EDGE_TURN, EDGE_SHIFT + EDGE_SHARE * length], 3)
        self._graph.put_keyframe(Keyframe(stamp, state[:7], np.diag(sigmas**-2.0)))
        self._keyframes.append(place)

    def _put_closures(self, now: int) -> None:
        """Queue the closures whose later end is not after the newest keyframe."""
        assert self._graph is not None
        while self._closures and max(self._ends(self._closures[0])) <= now:
            closure = self._closures.pop(0)
            moved = self._between_keyframes(closure)
            if moved is None:
                self.num_outside += 1
            else:
                self._graph.put_closure(moved)

    def _between_keyframes(self, closure: Closure) -> Closure | None:
        """Return the closure between its nearest keyframes.

        Return None if an end is before the first keyframe, or if both ends have the same nearest
        keyframe.
        """
        ends = np.array(self._ends(closure), np.int64)
        if ends.min() < self.run.stamps[0]:
            return None
        trajectory = self.run.trajectory()
        stamps = trajectory.timestamps_ns[self._keyframes]
        near = [int(np.argmin(np.abs(stamps - end))) for end in ends]
        if near[0] == near[1]:
            return None
        at = states_at(trajectory, ends)[:, :7]
        keyframes = trajectory.states[self._keyframes][near, :7]
        away = multiply_poses(inverse_poses(keyframes), at)
        measured = np.asarray(closure.measurement)[None]
        moved = multiply_poses(multiply_poses(away[:1], measured), inverse_poses(away[1:]))
        first, second = stamps[near].tolist()
        return Closure(first, second, moved[0], closure.information)

    @staticmethod
    def _ends(closure: Closure) -> tuple[int, int]:
        return int(closure.first_ns), int(closure.second_ns)
