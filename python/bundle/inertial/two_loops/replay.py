"""Replay of a sequence through two loops: a pose per IMU sample, a window, a closure graph.

Samples are replayed in order, and an image follows the last sample before it. In real time, samples
come at the sensors' rate, and slow solves delay results. The latency of a pose is the time from its
sample to its return. Otherwise the next sample waits until both loops are idle: results are then
reproducible, as if the sensors waited for the solver.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_type
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.inertial.two_loops.closure_loop import Closure, ClosureLoop, solved_on_one_thread
from bundle.inertial.two_loops.loop_thread import deadline_priority
from bundle.inertial.two_loops.pose_publisher import PosePublisher, YawMotion
from bundle.inertial.two_loops.window_loop import WindowDriver, WindowLoop
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.window_run import WindowRun
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import number
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.sequence.sequence import Sequence

if TYPE_CHECKING:
    from bundle.interface.option_keywords import WindowKeywords

# Solver of pose graphs in a separate process, at a lower priority.
#
# A solve on a thread shares the interpreter with the thread that publishes poses. Each Python call
# of the solve, and each copy of an array, may hold the interpreter. If the system suspends the
# thread at this time, a pose is late. A separate process shares nothing. It receives the arrays of
# a graph and returns the refined poses, each as a pickle through a pipe.


Array = NDArray[np.float64]

_FIELDS = ("poses", "edges", "measurements", "information", "fixed")
_NICE = 10


class ProcessSolver:
    """Solver for a :class:`ClosureLoop`; calls return the refined poses of a graph.

    The constructor returns once the process is ready. ``close`` or the end of the program ends it.

    Raises:
        RuntimeError: the process ended, or its solve failed; the message has the reason.
    """

    command = "from bundle.inertial.two_loops.replay import serve; serve()"

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", self.command], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._receive()

    def __call__(self, graph: PoseGraph) -> Array:
        """Return the refined poses (n, 7) of a solve on one thread."""
        check_type("ProcessSolver: graph", graph, PoseGraph)
        assert self._process.stdin is not None
        try:
            pickle.dump({name: getattr(graph, name) for name in _FIELDS}, self._process.stdin, 5)
            self._process.stdin.flush()
        except OSError:
            raise RuntimeError(self._end()) from None
        answer = self._receive()
        if isinstance(answer, str):
            raise RuntimeError(f"solve in another process: {answer}")
        poses: Array = answer
        return poses

    def close(self) -> None:
        """End the process and any solve in it."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None and not pipe.closed:
                try:
                    pipe.close()
                except OSError:  # data not yet sent to it
                    continue

    def _receive(self) -> Any:
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise RuntimeError(self._end()) from None

    def _end(self) -> str:
        return f"the solver's process ended with exit code {self._process.wait()}"


def serve(solver: Callable[[PoseGraph], Array] | None = None) -> None:
    """Solve graphs from standard input until it ends; for :class:`ProcessSolver`."""
    solver = solver or solved_on_one_thread
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries' prints must not mix with answers
    given = sys.stdin.buffer
    answer: Any = None
    while True:
        pickle.dump(answer, answers, 5)
        answers.flush()
        try:
            fields = pickle.load(given)
        except (EOFError, KeyboardInterrupt):
            return
        try:
            answer = np.array(solver(PoseGraph(**fields)))
        except KeyboardInterrupt:
            return
        except Exception as error:  # the caller reports it in its own process
            answer = f"{type(error).__name__}: {error}"


LATE = 5e-3  # seconds after its sample from which a pose counts as late


@dataclass(frozen=True)
class LoopStatistics:
    """Statistics of a replay.

    Attributes:
        real_time: True if samples came at the sensors' rate.
        first_in_line: True if the system gave the publishing thread priority; None if not
            requested.
        num_poses: number of published poses.
        lateness: latency in seconds: p50, p95, max; None unless in real time.
        num_late: poses late by more than 5 ms; None unless in real time.
        num_corrections: corrections of the graph that were composed into the anchor.
        largest_shift: largest motion of a pose by a share of a correction, in metres.
        largest_turn: the same in radians.
        num_closures: closures in the graph.
        num_closures_unknown: closures without keyframes near both ends, or lost by a ring.
        num_graph_solves: solves of the graph of closures.
        num_window_solves: solves of the window.
        num_window_late: solves of the window that took longer than an image's interval.
        longest_window_solve: seconds; None unless in real time.
        num_images_left_out: images that the window skipped to reach the newest one.
        num_solutions_refused: solutions older than the kept samples.
        num_lost: records that a full ring discarded.
    """

    real_time: bool
    first_in_line: bool | None
    num_poses: int
    lateness: dict[str, float] | None
    num_late: int | None
    num_corrections: int
    largest_shift: float
    largest_turn: float
    num_closures: int
    num_closures_unknown: int
    num_graph_solves: int
    num_window_solves: int
    num_window_late: int
    longest_window_solve: float | None
    num_images_left_out: int
    num_solutions_refused: int
    num_lost: int

    def asdict(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False, repr=False)
class TwoLoopsResult(Displayed):
    """Published poses of a replay.

    Attributes:
        published: one state per IMU sample, corrected by closures.
        odometry: states of the window, without closures.
        correction: motion from the window's world to the published one, at the end.
        statistics: statistics of the loops.
    """

    published: Trajectory
    odometry: OdometryResult
    correction: YawMotion
    statistics: LoopStatistics

    def _display(self) -> Display:
        found = self.statistics
        late = "not in real time" if found.num_late is None else f"{found.num_late} late"
        return Display(
            title=f"Two loops: {found.num_poses} poses, {late}",
            facts=(
                ("closures", f"{found.num_closures}, {found.num_corrections} corrections"),
                ("largest share", f"{found.largest_shift:.3g} m, {found.largest_turn:.3g} rad"),
                ("window", f"{found.num_window_solves} solves, {found.num_window_late} late"),
            ),
        )


@takes_options(WindowOptions)
def run_two_loops(
    sequence: Sequence,
    options: WindowOptions | None = None,
    *,
    closures: Iterable[Closure] = (),
    real_time: bool = False,
    num_shares: int = 100,
    solver: Callable[..., Array] | None = None,
    progress: Callable[[int, int], bool] | None = None,
    **changes: Unpack[WindowKeywords],
) -> TwoLoopsResult:
    """Replay a sequence and publish a pose per IMU sample.

    Args:
        sequence: IMU samples, tracks and calibration.
        options: options of the window, or some of its fields by name.
        closures: loop closures at any times of the sequence; each is added with the first
            keyframe at or after its later end.
        real_time: samples come at the sensors' rate, otherwise as fast as the loops permit.
        num_shares: poses over which a correction is spread.
        solver: pose graph solver for the :class:`ClosureLoop`; None: :func:`bundle.solve`, in real
            time in a separate process.
        progress: called about 10 times per second of the sequence with (finished samples, all
            samples); returning False ends the replay.
        **changes: fields of the options by name.

    Raises:
        InputError: no start is found, no sample follows it, or an argument is wrong.
    """
    options = WindowOptions.of(options, changes, "run_two_loops")
    shares = number("run_two_loops: num_shares", num_shares, whole=True, minimum=1)
    given = tuple(closures)
    for closure in given:
        check_type("run_two_loops: closures", closure, Closure)
    given = tuple(sorted(given, key=lambda closure: max(closure.first_ns, closure.second_ns)))
    driver = WindowDriver(WindowRun(sequence, options), given)
    replay = _Replay(sequence, driver, shares)
    began = time.perf_counter()
    with ExitStack() as stack:
        if solver is None and real_time and given:
            solver = ProcessSolver()
            stack.callback(solver.close)
        replay.run(real_time, solver, progress)
    return replay.result(time.perf_counter() - began)


class _Replay:
    def __init__(self, sequence: Sequence, driver: WindowDriver, num_shares: int) -> None:
        self.sequence, self.driver = sequence, driver
        newest = driver.run.window.frames[-1]
        self.publisher = PosePublisher(
            newest.stamp, newest.state, gravity=driver.run.window.gravity, num_shares=num_shares
        )
        stamps = sequence.imu_timestamps_ns
        self.first = int(np.searchsorted(stamps, newest.stamp, "right"))
        if self.first == len(stamps):
            raise InputError("sequence: expected IMU samples after the start, found 0")
        self.stamps: list[int] = []
        self.states: list[Array] = []
        self.late: list[float] = []
        self.largest_shift = self.largest_turn = 0.0
        self.message, self.interrupted = "done", False

    def run(
        self,
        real_time: bool,
        solver: Callable[..., Array] | None,
        progress: Callable[[int, int], bool] | None,
    ) -> None:
        """Publish all samples, then end the loops."""
        driver, publisher = self.driver, self.publisher
        self.real_time = real_time
        self.graph = ClosureLoop(publisher.corrections, solver=solver)
        driver.join(self.graph)
        rate = driver.run.window.options.frame_rate
        self.loop = WindowLoop(driver.solve, publisher.solutions, budget=1 / rate)
        self.first_in_line: bool | None = None
        try:
            if real_time:
                with deadline_priority() as self.first_in_line:
                    self._publish_all(rate, progress)
            else:
                self._publish_all(rate, progress)
        except KeyboardInterrupt:  # keep the published poses
            self.message, self.interrupted = "interrupted", True
        finally:
            try:
                self.loop.close()
            finally:
                self.graph.close(1.0 if self.interrupted else None)

    def _publish_all(self, rate: float, progress: Callable[[int, int], bool] | None) -> None:
        sequence, images = self.sequence, self.driver.run.images
        waiting = images.after(self.driver.run.next_image, rate)
        arrivals = images.stamps[waiting].tolist()
        stamps, count = sequence.imu_timestamps_ns, len(sequence.imu_timestamps_ns)
        every = max(1, round(0.1 * (count - 1) / max(sequence.duration, 1e-9)))
        begun, origin, image = time.monotonic(), int(stamps[self.first]), 0
        for k in range(self.first, count):
            due = begun + 1e-9 * (int(stamps[k]) - origin)
            if self.real_time:
                time.sleep(max(0.0, due - time.monotonic()))
            self._publish(k)
            self.late.append(time.monotonic() - due)
            while image < len(waiting) and arrivals[image] <= stamps[k]:
                self.loop.put(waiting[image])
                image += 1
                if not self.real_time:
                    self.loop.settle()
                    self.graph.settle()
            if progress is not None and k % every == 0 and not progress(k + 1, count):
                self.message = "stopped by the caller"
                return

    def _publish(self, k: int) -> None:
        sequence = self.sequence
        pose = self.publisher.publish(
            int(sequence.imu_timestamps_ns[k]), sequence.gyro[k], sequence.accel[k]
        )
        self.stamps.append(pose.timestamp_ns)
        self.states.append(pose.state)
        self.largest_shift = max(self.largest_shift, pose.shift)
        self.largest_turn = max(self.largest_turn, pose.turn)

    def result(self, seconds: float) -> TwoLoopsResult:
        """Return the published poses, once the loops have ended."""
        run = self.driver.run
        trajectory, failure = run.trajectory(), run.failure()
        odometry = OdometryResult(
            trajectory,
            run.records(),
            run.start,
            not failure,
            self.interrupted,
            failure or self.message,
            len(trajectory),
            seconds,
            run.window.options,
        )
        return TwoLoopsResult(
            Trajectory(np.array(self.stamps, np.int64), np.array(self.states).reshape(-1, 16)),
            odometry,
            self.publisher.target,
            self._statistics(),
        )

    def _statistics(self) -> LoopStatistics:
        late, graph, loop, publisher = np.array(self.late), self.graph, self.loop, self.publisher
        lateness = None
        if self.real_time and len(late):
            p50, p95, most = np.percentile(late, [50, 95, 100]).tolist()
            lateness = {"p50": p50, "p95": p95, "max": most}
        return LoopStatistics(
            real_time=self.real_time,
            first_in_line=self.first_in_line,
            num_poses=len(self.stamps),
            lateness=lateness,
            num_late=int((late > LATE).sum()) if self.real_time else None,
            num_corrections=publisher.num_corrections,
            largest_shift=self.largest_shift,
            largest_turn=self.largest_turn,
            num_closures=graph.num_closures,
            num_closures_unknown=graph.num_unknown
            + self.driver.num_outside
            + self.driver.num_closures_left,
            num_graph_solves=graph.num_solves,
            num_window_solves=loop.num_solves,
            num_window_late=loop.num_late if self.real_time else 0,
            longest_window_solve=loop.longest if self.real_time else None,
            num_images_left_out=self.driver.num_left_out,
            num_solutions_refused=publisher.num_refused,
            num_lost=graph.num_lost + loop.num_lost_frames,
        )
