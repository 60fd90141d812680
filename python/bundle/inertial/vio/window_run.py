"""Run of a sliding window over the images of a sequence, with sanity checks of its path.

Positions must agree with velocities.

From image to image a window moves its newest position by its velocity and by new estimates; the
latter amount to some centimetres per second at speed. The remainder is m = (p_j - p_i) - 1/2 (v_i +
v_j) T. It is a jump if it exceeds a metre plus the distance of half a second. Over the whole
flight, the sum of m is a drift if it exceeds two metres plus a tenth of the path.

Tracks must agree with the window. If landmarks or samples are wrong, a robust loss gives up the
tracks, and the window follows its own prediction. Tracking is lost if most observations are far
from their landmarks in six of ten images in a row; with a tenth of wrong tracks, this happens in
two of 260 images, with wrong samples in a third or more. Landmarks without parallax fit any motion
and do not count: where a platform hovers, all new ones would.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.inertial.vio.initialize import find_start
from bundle.inertial.vio.keyframe_record import KeyframeRecord, alarms_by_kind
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.window_alarms import (
    BIASES,
    DISAGREEMENT,
    INDEFINITE,
    LAGS,
    NO_EXCITATION,
    QUIET_KEYFRAMES,
)
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.sequence.sequence import Sequence

Array = np.ndarray[Any, Any]

FASTEST = 340.0  # m/s: about the speed of sound
MOST_GYRO_BIAS, MOST_ACCEL_BIAS = 1.0, 5.0  # rad/s, m/s^2
JUMP, JUMP_TIME = 1.0, 0.5  # m, s
DRIFT, DRIFT_SHARE = 2.0, 0.1  # m, share of the path


class PathSanity:
    """Plausibility check of consecutive states (16,) after a first one; stamps in ns."""

    def __init__(self, stamp: int, state: Array) -> None:
        self._stamp, self._state = stamp, state
        self._drift, self._way = np.zeros(3), 0.0

    def objection(self, stamp: int, state: Array) -> str:
        """Return the error of the next state, "" without one."""
        if not np.all(np.isfinite(state)):
            return "a state is not finite"
        speeds = [float(np.linalg.norm(each[7:10])) for each in (self._state, state)]
        if speeds[1] >= FASTEST:
            return f"a speed of {speeds[1]:.3g} m/s"
        for part, most, what in (
            (slice(10, 13), MOST_GYRO_BIAS, "gyroscope bias of {:.3g} rad/s"),
            (slice(13, 16), MOST_ACCEL_BIAS, "accelerometer bias of {:.3g} m/s^2"),
        ):
            bias = float(np.linalg.norm(state[part]))
            if bias >= most:
                return f"a {what.format(bias)}"
        seconds = 1e-9 * (stamp - self._stamp)
        way = 0.5 * seconds * (self._state[7:10] + state[7:10])
        miss = state[4:7] - self._state[4:7] - way
        self._drift = self._drift + miss
        self._way += float(np.linalg.norm(way))
        self._stamp, self._state = stamp, state
        jump, drift = float(np.linalg.norm(miss)), float(np.linalg.norm(self._drift))
        if jump > JUMP + JUMP_TIME * max(speeds):
            return f"a jump of {jump:.3g} m in {seconds:.2g} s at {max(speeds):.3g} m/s"
        if drift > DRIFT + DRIFT_SHARE * self._way:
            return (
                f"positions {drift:.3g} m from the integral of velocities, along {self._way:.3g} m"
            )
        return ""


START_KEYFRAMES = 4
MOST_FAR, FAR_IMAGES, RECENT = 0.5, 6, 10  # share of observations; of so many recent images
MOST_CONTRADICTED = 0.1  # share of the keyframes, of priors and biases; 0 in healthy runs
MOST_DISAGREEING = 0.2  # share of the keyframes with contradicting sensors or an indefinite prior
LONGEST_DISAGREEMENT = 3.0  # s


class WindowRun:
    """Window that has started, and the states of its images at the time of their solves.

    ``start`` is "static" or "moving"; ``lost`` the reason once tracking is lost, "" before.
    """

    def __init__(self, sequence: Sequence, options: WindowOptions) -> None:
        calibration = sequence.calibration
        sigma = options.pixel_sigma or calibration.pixel_sigma
        options = replace(options, pixel_sigma=sigma)
        self.images = SequenceImages(sequence, options.integration)
        self.window = SlidingWindow(
            calibration.camera_from_imu, calibration.noise, calibration.focal, options=options
        )
        self.lost = ""
        self._far: list[bool] = []
        self.start, self.next_image = self._begin()
        self.stamps = [frame.stamp for frame in self.window.frames]
        self.states = [frame.state for frame in self.window.frames]
        self._sanity = PathSanity(self.stamps[-1], self.states[-1])

    def add(self, image: int) -> KeyframeRecord | None:
        """Solve an image; return the record if it is a keyframe."""
        window, images = self.window, self.images
        stamp, known = images.stamp(image), len(window.records)
        interval = images.interval(window.frames[-1].stamp, image)
        tracks = images.tracks(image, window.options.refine_time_offset)
        try:
            record = window.add_frame(stamp, interval, tracks)
        except InputError as error:  # the window, which the run built, has no solution
            del window.records[known:]
            self._lose(stamp, f"the window has no solution ({error})")
            return None
        newest = window.frames[-1]
        self.stamps.append(newest.stamp)
        self.states.append(newest.state)
        self._far = [*self._far[1 - RECENT :], window.far_share > MOST_FAR]
        objection = self._sanity.objection(newest.stamp, newest.state)
        if not objection and sum(self._far) >= FAR_IMAGES:
            objection = (
                f"most tracks of {sum(self._far)} of the last {len(self._far)} images are far from "
                "where the samples and earlier images place them: a bias jumped, or samples or "
                "tracks are wrong"
            )
        if objection:
            if not np.all(np.isfinite(newest.state)):
                self.stamps.pop()
                self.states.pop()
            self._lose(newest.stamp, objection)
        return record

    def _lose(self, stamp: int, reason: str) -> None:
        seconds = 1e-9 * (stamp - self.stamps[0])
        self.lost = f"tracking was lost {seconds:.2f} s after the start: {reason}"

    def trajectory(self) -> Trajectory:
        """Return the states of all images so far."""
        return Trajectory(np.array(self.stamps, np.int64), np.array(self.states))

    def failure(self) -> str:
        """Return the reason why this is not a valid estimate of the motion; "" if it is valid."""
        records = self.window.records
        return _out_of_time(records) or self.lost or _lost_reason(records)

    def records(self) -> tuple[KeyframeRecord, ...]:
        """Return the telemetry; for a short run without excitation, add its alarm."""
        found = list(self.window.records)
        is_quiet = all(record.excitation_verdict == "unobservable" for record in found)
        if 0 < len(found) < QUIET_KEYFRAMES and is_quiet:
            found[-1] = replace(found[-1], alarms=(*found[-1].alarms, NO_EXCITATION))
        return tuple(found)

    def _begin(self) -> tuple[str, int]:
        window, images, options = self.window, self.images, self.window.options
        found = find_start(images, float(np.linalg.norm(window.gravity)), options.integration)
        if not found:
            raise InputError(
                "sequence: expected half a second without motion at its start, or a motion that "
                f"determines scale and gravity; start failed: {found.reason}"
            )
        chosen, states = found.images.tolist(), found.states
        if found.kind == "static":
            spread = np.linspace(chosen[0], chosen[-1], START_KEYFRAMES).round().astype(int)
            chosen = np.unique(spread).tolist()
            states = np.repeat(states[:1], len(chosen), axis=0)
        tracks = [images.tracks(image, options.refine_time_offset) for image in chosen]
        intervals, at_rest = images.intervals(chosen), found.kind == "static"
        try:
            window.start(images.stamps[chosen], states, tracks, intervals, at_rest=at_rest)
        except InputError as error:
            self.lost = f"tracking was lost at the start: the window has no solution ({error})"
        return found.kind, chosen[-1]


def _out_of_time(records: list[KeyframeRecord]) -> str:
    """Return the error of a window of which most solves took no step; otherwise ""."""
    without_step = sum(record.out_of_time and record.num_iterations == 0 for record in records)
    if 2 * without_step <= len(records):
        return ""
    return f"the time budget ended {without_step} of {len(records)} solves before their first step"


def _lost_reason(records: list[KeyframeRecord]) -> str:
    """Return the error of many keyframes if the window is not a valid estimate; otherwise ""."""
    count = len(records)
    by_kind = alarms_by_kind(records)
    if "prior cost negative" in by_kind:
        return f"{by_kind['prior cost negative'][0][1]}"
    disagreeing = [any(DISAGREEMENT in alarm for alarm in record.alarms) for record in records]
    longest = _longest([record.timestamp_ns for record in records], disagreeing)
    if sum(disagreeing) > MOST_DISAGREEING * count or longest > LONGEST_DISAGREEMENT:
        return (
            f"camera and IMU contradicted each other at {sum(disagreeing)} of {count} keyframes, "
            f"for up to {longest:.1f} s"
        )
    indefinite = sum((record.prior_definiteness or 0.0) < INDEFINITE for record in records)
    if indefinite > MOST_DISAGREEING * count:
        return f"the prior was not positive at {indefinite} of {count} keyframes"
    contradicted = len(by_kind.get("prior contradicted", []))
    if contradicted > MOST_CONTRADICTED * count:
        return f"the prior was contradicted at {contradicted} of {count} keyframes"
    for name in BIASES[0]:
        late = len(by_kind.get(f"{name} bias {LAGS}", []))
        if late > MOST_CONTRADICTED * count:
            return f"the {name} bias changed too fast to follow at {late} of {count} keyframes"
    return ""


def _longest(stamps: list[int], flags: list[bool]) -> float:
    longest, begin = 0, 0
    for k, flag in enumerate(flags):
        begin = begin if flag else k + 1
        longest = max(longest, stamps[k] - stamps[begin] if flag else 0)
    return 1e-9 * longest
