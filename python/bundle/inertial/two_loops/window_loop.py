"""Window loop: bounded work on its own thread, with a deadline."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bundle.base.arguments import check_function, check_type
from bundle.base.display import Display
from bundle.inertial.two_loops.loop_thread import SolveLoop
from bundle.inertial.two_loops.pose_publisher import Solution
from bundle.inertial.two_loops.ring import Ring
from bundle.interface.option_fields import number


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
        self._worker.notify()

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
