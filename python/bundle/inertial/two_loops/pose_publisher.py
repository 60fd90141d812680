"""Poses at the rate of the IMU: the last solution, propagated; corrections, composed.

A solution of a window is dated: it is the state at a frame that is past. It is rewound to and the
samples since then are replayed, by the steps of :func:`bundle.propagate`. A sample holds until the
next one (zero-order hold).

A correction C of a graph says where the window's world is in the graph's. It is composed into the
anchor A, never assigned: with the correction before it, C', the anchor becomes

    A <- C C'^-1 A,

so that what anybody else has moved the anchor by (:meth:`PosePublisher.move`) stays. The published
pose goes there in equal shares over a number of poses: each moves heading and place by what is left
divided by the number of poses that are left.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle import _core
from bundle.base.arguments import check_type
from bundle.base.display import Display, Displayed
from bundle.errors import InputError
from bundle.inertial.preintegration.preintegration import as_vector
from bundle.inertial.two_loops.ring import Ring
from bundle.inertial.two_loops.yaw_motion import Correction, YawMotion
from bundle.interface.option_fields import number

__all__ = ["PosePublisher", "PublishedPose", "Solution"]

Array = NDArray[np.float64]

_RULE = "zero_order_hold"


class _Sample(NamedTuple):
    timestamp_ns: int
    gyro: Array
    accel: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved state.

    Attributes:
        timestamp_ns: of the frame.
        state: (16,) qx qy qz qw of world_from_imu, position, velocity, gyroscope bias,
            accelerometer bias, in the window's world.

    Raises:
        InputError: these are not 16 finite numbers.
    """

    timestamp_ns: int
    state: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "timestamp_ns", int(self.timestamp_ns))
        object.__setattr__(self, "state", as_vector("Solution: state", self.state, 16).copy())


@dataclass(frozen=True, eq=False, repr=False)
class PublishedPose(Displayed):
    """What is published for an IMU sample.

    Attributes:
        timestamp_ns: of the sample.
        state: (16,) in the world of the graph: pose, velocity, biases.
        solution_timestamp_ns: of the solution that it is propagated from.
        shift: m by which a correction's share moved this pose.
        turn: radians, likewise.
        replayed: samples that were replayed for a new solution; 0 where there is none.
    """

    timestamp_ns: int
    state: Array
    solution_timestamp_ns: int
    shift: float
    turn: float
    replayed: int

    def _display(self) -> Display:
        place = " ".join(f"{value:.4g}" for value in self.state[4:7])
        age = 1e-9 * (self.timestamp_ns - self.solution_timestamp_ns)
        return Display(
            title=f"PublishedPose of {self.timestamp_ns} ns",
            facts=(("position", f"{place} m"), ("solution's age", f"{age:.3g} s")),
        )


class PosePublisher(Displayed):
    """Answers each IMU sample with a pose, and waits for nobody.

    :meth:`publish` belongs to one thread. ``solutions`` and ``corrections`` are rings that other
    threads put into; the newest of each counts.

    Args:
        timestamp_ns: of the start.
        state: (16,) there: qx qy qz qw of world_from_imu, position (m), velocity (m/s), biases of
            gyroscope (rad/s) and accelerometer (m/s^2).
        gravity: (3,) m/s^2 in the world.
        num_shares: poses over which a correction is spread; 1: all at once.
        memory: seconds of samples that are kept for solutions of the past.

    Raises:
        InputError: a number is out of its range, or the state or gravity is none.
    """

    def __init__(
        self,
        timestamp_ns: int,
        state: ArrayLike,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        num_shares: int = 100,
        memory: float = 10.0,
    ) -> None:
        self._gravity = as_vector("PosePublisher: gravity", gravity).copy()
        self._num_shares = number("PosePublisher: num_shares", num_shares, whole=True, minimum=1)
        self._memory_ns = round(1e9 * number("PosePublisher: memory", memory, above=0))
        self.solutions: Ring[Solution] = Ring()
        self.corrections: Ring[Correction] = Ring()
        self._moves: Ring[YawMotion] = Ring()
        self._solution = Solution(timestamp_ns, state)
        self._early: Solution | None = None  # of a frame after the newest sample
        self._state = np.asarray(self._solution.state)  # at that sample, in the window's world
        self._samples: deque[_Sample] = deque()
        self._anchor = self._target = self._last_correction = YawMotion()
        self._shares_left = 0
        self._num_published = self._num_refused = self._num_corrections = 0

    @property
    def anchor(self) -> YawMotion:
        """Where the window's world is in the published one, now."""
        return self._anchor

    @property
    def target(self) -> YawMotion:
        """Where the anchor goes."""
        return self._target

    @property
    def num_refused(self) -> int:
        """Solutions that were older than the samples that are kept, or than one before."""
        return self._num_refused

    @property
    def num_corrections(self) -> int:
        """Corrections that were composed into the anchor."""
        return self._num_corrections

    def move(self, motion: YawMotion) -> None:
        """Move the published world, as of a map that was recognised; from any one thread."""
        check_type("PosePublisher.move: motion", motion, YawMotion)
        self._moves.put(motion)

    def publish(self, timestamp_ns: int, gyro: ArrayLike, accel: ArrayLike) -> PublishedPose:
        """Take a sample and return the pose at its time.

        Args:
            timestamp_ns: of the sample, after that of the sample before.
            gyro: (3,) rad/s.
            accel: (3,) m/s^2, specific force.

        Raises:
            InputError: time goes back, or a number is not finite; the sample is not taken then.
        """
        sample = self._checked(timestamp_ns, gyro, accel)
        if not self._samples and sample.timestamp_ns > self._solution.timestamp_ns:
            # The first sample holds from the start on.
            self._samples.append(sample._replace(timestamp_ns=self._solution.timestamp_ns))
        self._samples.append(sample)
        solution = self._usable_solution()
        if solution is None:
            replayed = 0
            if len(self._samples) > 1:
                before = self._samples[-2]
                self._state = self._advanced(self._state, before.timestamp_ns, [before, sample])
        else:
            since = [s for s in self._samples if s.timestamp_ns > solution.timestamp_ns]
            replayed = len(since)
            held = self._samples[len(self._samples) - replayed - 1]
            self._solution = solution
            self._state = self._advanced(
                np.asarray(solution.state), solution.timestamp_ns, [held, *since]
            )
        self._forget_samples()
        shift, turn = self._follow_target()
        self._num_published += 1
        return PublishedPose(
            sample.timestamp_ns,
            self._anchor.moved(self._state),
            self._solution.timestamp_ns,
            shift,
            turn,
            replayed,
        )

    def _checked(self, timestamp_ns: int, gyro: ArrayLike, accel: ArrayLike) -> _Sample:
        stamp = int(timestamp_ns)
        rate, force = as_vector("gyro", gyro), as_vector("accel", accel)
        if self._samples and stamp <= self._samples[-1].timestamp_ns:
            raise InputError(
                f"timestamp_ns: expected after {self._samples[-1].timestamp_ns}, found {stamp}"
            )
        if stamp < self._solution.timestamp_ns:
            raise InputError(
                f"timestamp_ns: expected from the start at {self._solution.timestamp_ns} on, "
                f"found {stamp}"
            )
        return _Sample(stamp, rate.copy(), force.copy())

    def _usable_solution(self) -> Solution | None:
        """Return the newest solution that samples reach back to, if there is a new one."""
        newest = self.solutions.take_newest() or self._early
        self._early = None
        if newest is None:
            return None
        if newest.timestamp_ns > self._samples[-1].timestamp_ns:
            self._early = newest
            return None
        oldest = max(self._samples[0].timestamp_ns, self._solution.timestamp_ns)
        if newest.timestamp_ns < oldest:
            self._num_refused += 1
            return None
        return newest

    def _advanced(self, state: Array, from_ns: int, samples: list[_Sample]) -> Array:
        """Return the state at the last of some samples, the first of which holds at `from_ns`."""
        if len(samples) < 2:
            return state
        stamps = np.array([from_ns, *(s.timestamp_ns for s in samples[1:])], np.int64)
        held = samples[:-1]
        states = _core.propagate(
            state,
            self._gravity,
            _RULE,
            np.array([s.gyro for s in held]),
            np.array([s.accel for s in held]),
            1e-9 * np.diff(stamps),
        )
        last: Array = states[-1]
        return last

    def _forget_samples(self) -> None:
        """Keep what a later solution can need: back to the one that is used, but not too far."""
        newest = self._samples[-1].timestamp_ns
        begin = max(self._solution.timestamp_ns, newest - self._memory_ns)
        while len(self._samples) > 2 and self._samples[1].timestamp_ns <= begin:
            self._samples.popleft()

    def _follow_target(self) -> tuple[float, float]:
        """Compose what arrived into the target, take a share of the way; return m and radians."""
        for motion in self._moves.take_all():
            self._target = motion @ self._target
            self._shares_left = self._num_shares
        correction = self.corrections.take_newest()
        if correction is not None:
            change = correction.world_from_window @ self._last_correction.inverse()
            self._last_correction = correction.world_from_window
            self._num_corrections += 1
            self._target = change @ self._target
            self._shares_left = self._num_shares
        if not self._shares_left:
            return 0.0, 0.0
        before = self._anchor
        position = self._state[4:7]
        self._anchor = before.towards(self._target, position, 1 / self._shares_left)
        self._shares_left -= 1
        if not self._shares_left:
            self._anchor = self._target  # without the rounding of the way
        shift = self._anchor.place(position) - before.place(position)
        turn = math.remainder(self._anchor.yaw - before.yaw, 2 * math.pi)
        return float(np.linalg.norm(shift)), abs(turn)

    def _display(self) -> Display:
        yaw = math.degrees(self._target.yaw - self._anchor.yaw)
        return Display(
            title=f"PosePublisher: {self._num_published} poses",
            facts=(
                ("solution", f"{self._solution.timestamp_ns} ns, {self._num_refused} refused"),
                ("samples", f"{len(self._samples)} kept"),
                ("to go", f"{self._shares_left} shares, {yaw:.3g} degrees"),
            ),
        )
