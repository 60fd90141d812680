"""Publisher of poses at the IMU rate.

The latest window solution is propagated by the IMU samples, and the corrections of the graph are
composed.

A window's solution is the state at an earlier frame. The publisher goes back to this frame and
replays the samples since then, by the steps of :func:`bundle.propagate`. A sample holds until the
next one (zero-order hold).

A correction C of a graph is the pose of the window's world in the graph's world. It is composed
into the anchor A, never assigned: with the previous correction C', the anchor becomes

    A <- C C'^-1 A,

so that other motions of the anchor (:meth:`PosePublisher.move`) are kept. The anchor of
the published poses approaches this value in equal shares over a number of poses. Each step moves
heading and position by the remainder divided by the number of remaining poses.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import Array as Declared
from bundle.base.arrays import as_declared, check_type
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.inertial.preintegration.preintegration import as_vector
from bundle.inertial.two_loops.loop_thread import Ring
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import quaternion_multiply

# Motions about the vertical: directions that an IMU leaves free and closures correct.
#
# Gravity determines roll and pitch; heading and position drift. A motion rotates about z and
# translates: x -> Rz(yaw) x + t. The yaw of a rigid motion is its twist about z: the angle 2
# atan2(z, w) of the quaternion (x, y, z, w).


Array = NDArray[np.float64]


def twist_about_z(quaternion: Array) -> float:
    """Return the angle about z of a rotation, in (-pi, pi]."""
    angle = 2 * math.atan2(quaternion[2], quaternion[3])
    return math.remainder(angle, 2 * math.pi)


@dataclass(frozen=True, eq=False, repr=False)
class YawMotion(Displayed):
    """Motion x -> Rz(yaw) x + translation.

    Attributes:
        yaw: angle in radians.
        translation: (3,) m.

    Raises:
        InputError: a number is not finite.
    """

    yaw: float = 0.0
    translation: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "yaw", number("YawMotion: yaw", self.yaw))
        shift = as_declared("YawMotion: translation", self.translation, Declared((3,), "finite"))
        object.__setattr__(self, "translation", shift)

    @property
    def shift(self) -> Array:
        """Translation as an array."""
        return np.asarray(self.translation, np.float64)

    @staticmethod
    def between(start: Array, end: Array) -> YawMotion:
        """Return the motion between two poses, from their positions and headings.

        Args:
            start: qx qy qz qw tx ty tz, followed by any numbers.
            end: likewise.
        """
        back = np.array([-start[0], -start[1], -start[2], start[3]])
        yaw = twist_about_z(quaternion_multiply(end[None, :4], back[None])[0])
        return YawMotion(yaw, end[4:7] - _turned(yaw, start[4:7]))

    def __matmul__(self, other: YawMotion) -> YawMotion:
        """Return the composition: ``other`` first, then this motion."""
        shift = _turned(self.yaw, other.shift) + self.shift
        return YawMotion(math.remainder(self.yaw + other.yaw, 2 * math.pi), shift)

    def inverse(self) -> YawMotion:
        """Return the inverse motion."""
        return YawMotion(-self.yaw, -_turned(-self.yaw, self.shift))

    def moved(self, state: Array) -> Array:
        """Return a state (16,), or one or more poses (7,), moved with the world."""
        out = state.copy()
        x, y, z, w = state[:4].tolist()
        sine, cosine = math.sin(self.yaw / 2), math.cos(self.yaw / 2)
        out[:4] = (  # (0, 0, sine, cosine) times the state's quaternion
            cosine * x - sine * y,
            cosine * y + sine * x,
            cosine * z + sine * w,
            cosine * w - sine * z,
        )
        out[4:7] = self.place(state[4:7])
        if len(out) >= 10:
            out[7:10] = _turned(self.yaw, state[7:10])
        return out

    def place(self, position: Array) -> Array:
        """Return a position (3,) moved with the world."""
        return _turned(self.yaw, position) + self.shift

    def towards(self, target: YawMotion, position: Array, share: float) -> YawMotion:
        """Interpolate between two yaw motions as observed at `position`.

        Heading and the image of ``position`` change by this share of the target's change. A
        rotation about a distant origin therefore does not swing the pose.
        """
        here, there = self.place(position), target.place(position)
        yaw = self.yaw + share * math.remainder(target.yaw - self.yaw, 2 * math.pi)
        return YawMotion(yaw, here + share * (there - here) - _turned(yaw, position))

    def _display(self) -> Display:
        shift = " ".join(f"{value:.4g}" for value in self.shift)
        return Display(
            title="YawMotion",
            facts=(("yaw", f"{math.degrees(self.yaw):.4g} degrees"), ("translation", f"{shift} m")),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Correction(Displayed):
    """Pose of the window's world in the graph's world at a time.

    Attributes:
        timestamp_ns: stamp of the newest keyframe in the graph.
        world_from_window: the motion.
        num_keyframes: number of keyframes in the graph.
        num_closures: number of closures in the graph.
    """

    timestamp_ns: int
    world_from_window: YawMotion
    num_keyframes: int = 0
    num_closures: int = 0

    def _display(self) -> Display:
        return Display(
            title=f"Correction of {self.timestamp_ns} ns",
            facts=(
                ("graph", f"{self.num_keyframes} keyframes, {self.num_closures} closures"),
                *self.world_from_window._display().facts,
            ),
        )


def _turned(yaw: float, vector: Array) -> Array:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    x, y, z = vector.tolist()
    return np.array([cosine * x - sine * y, sine * x + cosine * y, z])


_RULE = "zero_order_hold"


class _Sample(NamedTuple):
    timestamp_ns: int
    gyro: Array
    accel: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Solved state of a window.

    Attributes:
        timestamp_ns: stamp of the frame.
        state: (16,) qx qy qz qw of world_from_imu, position, velocity, gyroscope bias,
            accelerometer bias, in the window's world.

    Raises:
        InputError: the state is not 16 finite numbers.
    """

    timestamp_ns: int
    state: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "timestamp_ns", int(self.timestamp_ns))
        object.__setattr__(self, "state", as_vector("Solution: state", self.state, 16).copy())


@dataclass(frozen=True, eq=False, repr=False)
class PublishedPose(Displayed):
    """Published pose of an IMU sample.

    Attributes:
        timestamp_ns: stamp of the sample.
        state: (16,) in the world of the graph: pose, velocity, biases.
        solution_timestamp_ns: stamp of the solution from which it is propagated.
        shift: metres by which the share of a correction moved this pose.
        turn: the same in radians.
        replayed: samples replayed for a new solution; 0 without one.
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
    """Publisher of a pose for each IMU sample, without waiting.

    Call :meth:`publish` from one thread only. Other threads put into the rings ``solutions`` and
    ``corrections``; only the newest entry of a ring is used.

    Args:
        timestamp_ns: stamp of the start.
        state: (16,) at the start: qx qy qz qw of world_from_imu, position (m), velocity (m/s),
            biases of gyroscope (rad/s) and accelerometer (m/s^2).
        gravity: (3,) m/s^2 in the world.
        num_shares: poses over which a correction is spread; 1: at once.
        memory: seconds of samples that are kept for earlier solutions.

    Raises:
        InputError: a number is out of range, or state or gravity is invalid.
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
        self._early: Solution | None = None  # for a frame after the newest sample
        self._state = np.asarray(self._solution.state)  # at that sample, in the window's world
        self._samples: deque[_Sample] = deque()
        self._anchor = self._target = self._last_correction = YawMotion()
        self._shares_left = 0
        self._num_published = self._num_refused = self._num_corrections = 0

    @property
    def anchor(self) -> YawMotion:
        """Current pose of the window's world in the published world."""
        return self._anchor

    @property
    def target(self) -> YawMotion:
        """Pose that the anchor approaches."""
        return self._target

    @property
    def num_refused(self) -> int:
        """Number of solutions older than the kept samples, or than an earlier solution."""
        return self._num_refused

    @property
    def num_corrections(self) -> int:
        """Number of corrections composed into the anchor."""
        return self._num_corrections

    def move(self, motion: YawMotion) -> None:
        """Move the published world, for example after relocalisation.

        Call it from one thread only.
        """
        check_type("PosePublisher.move: motion", motion, YawMotion)
        self._moves.put(motion)

    def publish(self, timestamp_ns: int, gyro: ArrayLike, accel: ArrayLike) -> PublishedPose:
        """Accept a sample and return the pose at its time.

        Args:
            timestamp_ns: stamp of the sample, after that of the previous sample.
            gyro: (3,) rad/s.
            accel: (3,) m/s^2, specific force.

        Raises:
            InputError: time goes back, or a number is not finite; the sample is then ignored.
        """
        sample = self._checked(timestamp_ns, gyro, accel)
        if not self._samples and sample.timestamp_ns > self._solution.timestamp_ns:
            # The first sample also holds from the start to its stamp.
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
        newest = self._samples[-1].timestamp_ns
        begin = max(self._solution.timestamp_ns, newest - self._memory_ns)
        while len(self._samples) > 2 and self._samples[1].timestamp_ns <= begin:
            self._samples.popleft()
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
                "timestamp_ns: expected at least that of the start, "
                f"{self._solution.timestamp_ns}, found {stamp}"
            )
        return _Sample(stamp, rate.copy(), force.copy())

    def _usable_solution(self) -> Solution | None:
        """Return the newest solution within the kept samples, if there is a new one."""
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
        """Return the state at the last sample, from `state` at `from_ns`, the first sample."""
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

    def _follow_target(self) -> tuple[float, float]:
        """Add new corrections to the target, move one share; return shift [m], turn [rad]."""
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
            self._anchor = self._target  # without accumulated rounding errors
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
