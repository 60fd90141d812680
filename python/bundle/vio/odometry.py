"""Visual-inertial odometry over a whole sequence."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bundle.display import Display, Displayed
from bundle.errors import InputError
from bundle.vio.initialize import find_start
from bundle.vio.keyframe_record import KeyframeRecord
from bundle.vio.sequence import Sequence
from bundle.vio.sequence_images import SequenceImages
from bundle.vio.sliding_window import SlidingWindow
from bundle.vio.trajectory_files import Trajectory
from bundle.vio.window_options import WindowOptions
from bundle.vio.window_telemetry import INDEFINITE

__all__ = ["OdometryResult", "begin_window", "is_sane", "lost_reason", "run_odometry"]

Array = np.ndarray[Any, Any]

START_KEYFRAMES = 4


@dataclass(frozen=True, eq=False, repr=False)
class OdometryResult(Displayed):
    """What an odometry found.

    Attributes:
        trajectory: states when their images were solved for, as a robot has them in time; with
            ``marginalize="keep"`` those of the last solve, a batch.
        keyframes: telemetry.
        start: "static" or "moving": how the first states were found.
        is_usable: False where the window lost the motion; ``message`` says when.
        interrupted: Ctrl-C ended it; the trajectory goes as far as it came.
        message: one sentence.
        num_images: solved for.
        solve_time: seconds, without reading.
        options: as used.
    """

    trajectory: Trajectory
    keyframes: tuple[KeyframeRecord, ...]
    start: str
    is_usable: bool
    interrupted: bool
    message: str
    num_images: int
    solve_time: float
    options: WindowOptions

    def _display(self) -> Display:
        stamps = self.trajectory.timestamps_ns
        seconds = 1e-9 * float(stamps[-1] - stamps[0])
        speed = seconds / self.solve_time if self.solve_time > 0 else float("inf")
        return Display(
            title=f"Odometry over {seconds:.2f} s: {self.message}",
            facts=(
                ("start", self.start),
                ("images", f"{self.num_images}, {len(self.keyframes)} keyframes"),
                ("time", f"{self.solve_time:.3g} s, {speed:.3g} times faster than real time"),
            ),
        )


def run_odometry(
    sequence: Sequence,
    options: WindowOptions | None = None,
    *,
    progress: Callable[[int, int, KeyframeRecord | None], bool] | None = None,
    **changes: Any,
) -> OdometryResult:
    """Run a :class:`bundle.SlidingWindow` over a sequence.

    Args:
        sequence: IMU samples, tracks and calibration.
        options: of the window, or some of its fields by name.
        progress: called after each image with (images done, images in all, record of a keyframe or
            None); False ends the odometry there.
        **changes: fields of the options.

    Raises:
        InputError: no start is found, or the options are wrong.
    """
    options = WindowOptions.of(options, changes, "run_odometry")
    began = time.perf_counter()
    images = SequenceImages(sequence, options.integration)
    window = SlidingWindow(
        sequence.calibration.camera_from_imu,
        sequence.calibration.noise,
        sequence.calibration.focal,
        options=options,
    )
    start, next_image = begin_window(window, images)
    stamps = [frame.stamp for frame in window.frames]
    states = [frame.state for frame in window.frames]
    message, usable, interrupted = "done", True, False
    try:
        for image in images.after(next_image, options.frame_rate):
            record = window.add_frame(
                images.stamp(image),
                images.interval(window.frames[-1].stamp, image),
                images.tracks(image, options.refine_time_offset),
            )
            newest = window.frames[-1]
            stamps.append(newest.stamp)
            states.append(newest.state)
            if not is_sane(newest.state):
                seconds = 1e-9 * (newest.stamp - stamps[0])
                message, usable = f"the motion was lost {seconds:.2f} s after the start", False
                break
            if window.was_interrupted:
                raise KeyboardInterrupt
            if progress is not None and not progress(image + 1, len(images), record):
                message = "stopped by the caller"
                break
    except KeyboardInterrupt:  # what is solved stays
        message, interrupted = "interrupted", True
    if usable and (lost := lost_reason(window.records)):
        message, usable = lost, False
    if options.marginalize == "keep":
        stamps = [frame.stamp for frame in window.frames]
        states = [frame.state for frame in window.frames]
    return OdometryResult(
        Trajectory(np.array(stamps, np.int64), np.array(states)),
        tuple(window.records),
        start,
        usable,
        interrupted,
        message,
        len(stamps),
        time.perf_counter() - began,
        options,
    )


def begin_window(window: SlidingWindow, images: SequenceImages) -> tuple[str, int]:
    """Start the window; return how, and the image that it ends with.

    Raises:
        InputError: there is no start; the message has the reason.
    """
    options = window.options
    found = find_start(images, float(np.linalg.norm(window.gravity)), options.integration)
    if not found:
        raise InputError(
            "sequence: expected rest for half a second at its begin, or motion that shows scale "
            f"and gravity, found neither ({found.reason})"
        )
    chosen, states = found.images.tolist(), found.states
    if found.kind == "static":
        spread = np.linspace(chosen[0], chosen[-1], START_KEYFRAMES).round().astype(int)
        chosen = np.unique(spread).tolist()
        states = np.repeat(states[:1], len(chosen), axis=0)
    window.start(
        images.stamps[chosen],
        states,
        [images.tracks(image, options.refine_time_offset) for image in chosen],
        images.intervals(chosen),
        at_rest=found.kind == "static",
    )
    return found.kind, chosen[-1]


def lost_reason(records: list[KeyframeRecord]) -> str:
    """Return what was wrong at most keyframes of a window that is no estimate; "" otherwise."""
    without_step = sum(record.out_of_time and record.num_iterations == 0 for record in records)
    indefinite = sum((record.prior_definiteness or 0.0) < INDEFINITE for record in records)
    if 2 * without_step > len(records):
        return (
            f"the time budget ended {without_step} of {len(records)} solves before their first step"
        )
    if 2 * indefinite > len(records):
        return f"the prior was not positive at {indefinite} of {len(records)} keyframes"
    return ""


def is_sane(state: Array) -> bool:
    """Return whether a state (16,) is one: slower than sound, biases that a sensor can have."""
    if not np.all(np.isfinite(state)):
        return False
    gyro, accel = np.linalg.norm(state[10:13]), np.linalg.norm(state[13:16])
    return bool(np.linalg.norm(state[7:10]) < 340 and gyro < 1.0 and accel < 5.0)
