"""Window loop: bounded work on its own thread, with a deadline, and its driver."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bundle.base.arrays import check_function, check_type
from bundle.base.display import Display
from bundle.inertial.two_loops.closure_loop import Closure, ClosureLoop, Keyframe
from bundle.inertial.two_loops.loop_thread import Ring, SolveLoop
from bundle.inertial.two_loops.pose_publisher import Solution
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.inertial.vio.window_run import WindowRun
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import inverse_poses, multiply_poses


class WindowLoop(SolveLoop):
    """Solver of a window for arriving frames, on its own thread.

    It drives any window: ``solve(frames, deadline)`` gets the frames since its last call, oldest
    first, and a time of ``time.monotonic()`` by which it should return its best state. The result,
    a :class:`Solution` or None, goes to the ring of a publisher even if it is late. Until then the
    publisher uses the IMU alone. After a slow solve, several frames are waiting at the next call.
    If they exceed the ring's capacity, the oldest are lost.

    Args:
        solve: function that solves the window.
        solutions: ring of a :class:`PosePublisher`.
        budget: seconds from a call to its deadline.
        capacity: frames that can wait.

    Raises:
        InputError: an argument has the wrong type or range.
    """

    def __init__(
        self,
        solve: Callable[[list[Any], float], Solution | None],
        solutions: Ring[Solution],
        *,
        budget: float = 0.03,
        capacity: int = 64,
    ) -> None:
        check_function("WindowLoop: solve", solve)
        check_type("WindowLoop: solutions", solutions, Ring)
        self._solve = solve
        self._solutions = solutions
        self._budget = number("WindowLoop: budget", budget, above=0)
        self._frames: Ring[Any] = Ring(capacity)
        self._num_late = 0
        self._longest = 0.0
        self._start("bundle window")

    @property
    def num_late(self) -> int:
        """Number of calls that returned after their deadline."""
        return self._num_late

    @property
    def num_lost_frames(self) -> int:
        """Number of frames that no call has processed."""
        return self._frames.num_lost

    @property
    def longest(self) -> float:
        """Duration of the slowest call in seconds."""
        return self._longest

    def put(self, frame: Any) -> None:
        """Queue a frame; return at once."""
        self._frames.put(frame)
        self._news.set()

    def _work(self) -> None:
        frames = self._frames.take_all()
        if not frames:
            return
        begun = time.monotonic()
        solution = self._solve(frames, begun + self._budget)
        took = time.monotonic() - begun
        self._num_solves += 1
        self._num_late += took > self._budget
        self._longest = max(self._longest, took)
        if solution is not None:
            self._solutions.put(solution)

    def _display(self) -> Display:
        return Display(
            title=f"WindowLoop: {self._num_solves} solves, budget {self._budget:g} s",
            facts=(
                ("late", f"{self._num_late}, longest {self._longest:.3g} s"),
                ("lost frames", str(self.num_lost_frames)),
            ),
        )


# Driver of a sliding window in a window loop; it passes keyframes to a closure loop.
#
# After a slow solve, several images are waiting at the next call: the newest is solved, the others
# are skipped, and their samples join its interval.
#
# Closures connect any two times between solved images. Let A and B be the window's poses of the
# nearest keyframes, and a and b the interpolated poses at the times themselves. The closure M of b
# in the frame of a becomes
#
#     (A^-1 a) M (B^-1 b)^-1,
#
# as the pose of keyframe B in the frame of keyframe A. Over fractions of a second the window is
# accurate, even if it has drifted far. The information of the closure is unchanged.
#
# The motion between keyframes has the sigmas EDGE_TURN for rotation, and EDGE_SHIFT plus EDGE_SHARE
# of its length for translation. They weigh the odometry against closures, which have their own
# sigmas.

EDGE_TURN = np.radians(0.1)
EDGE_SHIFT, EDGE_SHARE = 2e-3, 0.01  # m; share of the length


class WindowDriver:
    """Solver of a sequence's images on the thread of a :class:`WindowLoop`.

    ``run``: window that has started. ``closures``: closures sorted by the time of their later end.
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
        assert self._graph is not None
        while self._closures and max(self._ends(self._closures[0])) <= now:
            closure = self._closures.pop(0)
            moved = self._between_keyframes(closure)
            if moved is None:
                self.num_outside += 1
            else:
                self._graph.put_closure(moved)

    def _between_keyframes(self, closure: Closure) -> Closure | None:
        """Return the closure between its nearest keyframes; None if these are equal or gone."""
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
