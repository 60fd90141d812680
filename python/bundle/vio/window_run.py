"""A sliding window over the images of a sequence, from its start on."""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.vio.initialize import find_start
from bundle.vio.keyframe_record import KeyframeRecord
from bundle.vio.sequence import Sequence
from bundle.vio.sequence_images import SequenceImages
from bundle.vio.sliding_window import SlidingWindow
from bundle.vio.trajectory_files import Trajectory
from bundle.vio.window_options import WindowOptions
from bundle.vio.window_telemetry import INDEFINITE

__all__ = ["WindowRun"]

Array = np.ndarray[Any, Any]

START_KEYFRAMES = 4


class WindowRun:
    """The window, and the states of its images when they were solved for.

    Args:
        sequence: IMU samples, tracks and calibration.
        options: of the window.

    Attributes:
        images: of the sequence.
        window: which has started.
        start: "static" or "moving": how its first states were found.
        next_image: the image that the start ends with.
        stamps, states: of the start's keyframes, then of each image.
        lost: a sentence once a state is none; "" before.

    Raises:
        InputError: the sequence has no start; the message has the reason.
    """

    def __init__(self, sequence: Sequence, options: WindowOptions) -> None:
        calibration = sequence.calibration
        self.images = SequenceImages(sequence, options.integration)
        self.window = SlidingWindow(
            calibration.camera_from_imu, calibration.noise, calibration.focal, options=options
        )
        self.lost = ""
        self.start, self.next_image = self._begin()
        self.stamps = [frame.stamp for frame in self.window.frames]
        self.states = [frame.state for frame in self.window.frames]

    def add(self, image: int) -> KeyframeRecord | None:
        """Solve for an image; return the record of a keyframe."""
        window, images = self.window, self.images
        record = window.add_frame(
            images.stamp(image),
            images.interval(window.frames[-1].stamp, image),
            images.tracks(image, window.options.refine_time_offset),
        )
        newest = window.frames[-1]
        self.stamps.append(newest.stamp)
        self.states.append(newest.state)
        if not _is_sane(newest.state):
            seconds = 1e-9 * (newest.stamp - self.stamps[0])
            self.lost = f"the motion was lost {seconds:.2f} s after the start"
        return record

    def trajectory(self) -> Trajectory:
        """Return the states of all images so far."""
        return Trajectory(np.array(self.stamps, np.int64), np.array(self.states))

    def failure(self) -> str:
        """Return why this is no estimate of the motion, "" where it is one."""
        return self.lost or _lost_reason(self.window.records)

    def _begin(self) -> tuple[str, int]:
        window, images, options = self.window, self.images, self.window.options
        found = find_start(images, float(np.linalg.norm(window.gravity)), options.integration)
        if not found:
            raise InputError(
                "sequence: expected rest for half a second at its begin, or motion that shows "
                f"scale and gravity, found neither ({found.reason})"
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


def _lost_reason(records: list[KeyframeRecord]) -> str:
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


def _is_sane(state: Array) -> bool:
    """Return whether a state (16,) is one: slower than sound, biases that a sensor can have."""
    if not np.all(np.isfinite(state)):
        return False
    gyro, accel = np.linalg.norm(state[10:13]), np.linalg.norm(state[13:16])
    return bool(np.linalg.norm(state[7:10]) < 340 and gyro < 1.0 and accel < 5.0)
