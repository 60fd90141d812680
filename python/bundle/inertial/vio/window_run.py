"""A sliding window over the images of a sequence, from its start on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.inertial.vio.initialize import find_start
from bundle.inertial.vio.keyframe_record import KeyframeRecord, alarms_by_kind
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.trajectory_sanity import PathSanity
from bundle.inertial.vio.window_alarms import INDEFINITE, NO_EXCITATION, QUIET_KEYFRAMES
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.sequence.sequence import Sequence

__all__ = ["WindowRun"]

Array = np.ndarray[Any, Any]

START_KEYFRAMES = 4
MOST_CONTRADICTED = 0.4  # of the keyframes


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
        self._sanity = PathSanity(self.stamps[-1], self.states[-1])

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
        objection = self._sanity.objection(newest.stamp, newest.state)
        if objection:
            seconds = 1e-9 * (newest.stamp - self.stamps[0])
            self.lost = f"the motion was lost {seconds:.2f} s after the start: {objection}"
        return record

    def trajectory(self) -> Trajectory:
        """Return the states of all images so far."""
        return Trajectory(np.array(self.stamps, np.int64), np.array(self.states))

    def failure(self) -> str:
        """Return why this is no estimate of the motion, "" where it is one."""
        return self.lost or _lost_reason(self.window.records)

    def records(self) -> tuple[KeyframeRecord, ...]:
        """Return the telemetry; a run too short for persistence, and quiet throughout, says so."""
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
    by_kind = alarms_by_kind(records)
    if "prior costs less than nothing" in by_kind:
        return f"{by_kind['prior costs less than nothing'][0][1]}"
    contradicted = len(by_kind.get("prior contradicted", []))
    if contradicted > MOST_CONTRADICTED * len(records):
        return f"the prior was contradicted at {contradicted} of {len(records)} keyframes"
    return ""
