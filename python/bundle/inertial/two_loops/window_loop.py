"""The loop of a window: bounded work on a thread of its own, with a deadline."""

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

__all__ = ["WindowLoop"]


class WindowLoop(SolveLoop):
    """Solves a window for the frames that arrive, on a thread of its own.

    Of any window: ``solve(frames, deadline)`` gets the frames since its last call, oldest first,
    and a time of ``time.monotonic()`` by which it should be back with its best state so far. What
    it returns, a :class:`Solution` or None, goes to the ring of a publisher, late or not: the
    publisher has gone on by the IMU alone meanwhile. A slow solve meets several frames at its next
    call, and loses the oldest where they are more than the ring holds.

    Args:
        solve: the window.
        solutions: the ring of a :class:`PosePublisher`.
        budget: seconds from a call to its deadline.
        capacity: frames that wait.

    Raises:
        InputError: an argument is none of these.
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
        """Calls that came back after their deadline."""
        return self._num_late

    @property
    def num_lost_frames(self) -> int:
        """Frames that no call has seen."""
        return self._frames.num_lost

    @property
    def longest(self) -> float:
        """Seconds that the slowest call took."""
        return self._longest

    def put(self, frame: Any) -> None:
        """Hand over a frame; returns at once."""
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
