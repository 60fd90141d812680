"""Visual-inertial odometry over a whole sequence."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from bundle.display import Display, Displayed
from bundle.errors import InputError
from bundle.vio.imu_slices import ImuSlices
from bundle.vio.initialize import initialize_vio
from bundle.vio.keyframe_record import KeyframeRecord
from bundle.vio.landmark_table import FrameTracks
from bundle.vio.sequence import Sequence
from bundle.vio.sliding_window import SlidingWindow
from bundle.vio.static_start import find_static_start
from bundle.vio.trajectory_files import Trajectory
from bundle.vio.window_options import WindowOptions

__all__ = ["OdometryResult", "run_odometry"]

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
    images = _Images(sequence, options)
    window = SlidingWindow(
        sequence.calibration.camera_from_imu,
        sequence.calibration.noise,
        sequence.calibration.focal,
        options=options,
    )
    start, next_image = _begin(window, sequence, images)
    stamps = [frame.stamp for frame in window.frames]
    states = [frame.state for frame in window.frames]
    message, usable, interrupted = "done", True, False
    try:
        for image in images.after(next_image):
            record = window.add_frame(
                images.stamp(image),
                images.interval(window.frames[-1].stamp, image),
                images.tracks(image),
            )
            newest = window.frames[-1]
            stamps.append(newest.stamp)
            states.append(newest.state)
            if not _is_sane(newest.state):
                seconds = 1e-9 * (newest.stamp - stamps[0])
                message, usable = f"the motion was lost {seconds:.2f} s after the start", False
                break
            if window.was_interrupted:
                raise KeyboardInterrupt
            if progress is not None and not progress(image + 1, images.count, record):
                message = "stopped by the caller"
                break
    except KeyboardInterrupt:  # what is solved stays
        message, interrupted = "interrupted", True
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


class _Images:
    """The images of a sequence that are solved for."""

    def __init__(self, sequence: Sequence, options: WindowOptions) -> None:
        self.slices = ImuSlices(
            sequence.imu_timestamps_ns, sequence.gyro, sequence.accel, options.integration
        )
        _, self.begin = sequence.frames()
        self.stamps = sequence.image_timestamps_ns[self.begin[:-1]]
        self.xy, self.ids = sequence.normalized(), sequence.track_ids
        self.period = 1e9 / options.frame_rate
        self.velocities = options.refine_time_offset
        t = sequence.imu_timestamps_ns
        self.covered = (self.stamps >= t[0]) & (self.stamps <= t[-1])

    @property
    def count(self) -> int:
        return len(self.stamps)

    def stamp(self, image: int) -> int:
        return int(self.stamps[image])

    def rows(self, image: int) -> slice:
        return slice(self.begin[image], self.begin[image + 1])

    def tracks(self, image: int) -> FrameTracks:
        """What it saw; velocities from the image before, where they matter."""
        rows = self.rows(image)
        ids, xy = self.ids[rows], self.xy[rows]
        velocity = np.zeros_like(xy)
        if self.velocities and image > 0:
            before = self.rows(image - 1)
            _, a, b = np.intersect1d(ids, self.ids[before], assume_unique=True, return_indices=True)
            seconds = 1e-9 * float(self.stamps[image] - self.stamps[image - 1])
            velocity[a] = (xy[a] - self.xy[before][b]) / seconds
        return FrameTracks(ids, xy, velocity)

    def interval(self, since: int, image: int) -> Any:
        return self.slices.between(since, self.stamp(image))

    def after(self, image: int) -> list[int]:
        """Images beyond this one, not closer in time than the frame rate allows."""
        chosen, last = [], self.stamps[image]
        for k in range(image + 1, self.count):
            # Half a millisecond for cameras whose stamps jitter.
            if self.covered[k] and self.stamps[k] - last >= self.period - 5e5:
                chosen.append(k)
                last = self.stamps[k]
        return chosen


def _begin(window: SlidingWindow, sequence: Sequence, images: _Images) -> tuple[str, int]:
    """Start the window; return how, and the image that it ends with."""
    found = find_static_start(sequence, float(np.linalg.norm(window.gravity)))
    if found is None:
        return _begin_moving(window, sequence, images)
    spread = np.linspace(found.first_image, found.last_image, START_KEYFRAMES).round().astype(int)
    chosen = np.unique(spread)
    pairs = pairwise(chosen)
    window.start(
        [images.stamp(int(k)) for k in chosen],
        np.repeat(found.state[None], len(chosen), axis=0),
        [images.tracks(int(k)) for k in chosen],
        [images.interval(images.stamp(int(a)), int(b)) for a, b in pairs],
        at_rest=True,
    )
    return "static", int(chosen[-1])


def _begin_moving(window: SlidingWindow, sequence: Sequence, images: _Images) -> tuple[str, int]:
    gravity = float(np.linalg.norm(window.gravity))
    found = initialize_vio(
        sequence, gravity=gravity, integration=window.options.integration, try_rest=False
    )
    if not found:
        raise InputError(
            "sequence: expected rest for half a second at its begin, or motion that shows scale "
            f"and gravity, found neither ({found.reason})"
        )
    chosen = found.images.tolist()
    window.start(
        found.timestamps_ns,
        found.states,
        [images.tracks(image) for image in chosen],
        [images.interval(images.stamp(a), b) for a, b in pairwise(chosen)],
    )
    return "moving", chosen[-1]


def _is_sane(state: Array) -> bool:
    """Faster than sound, or biases that no sensor has: the window has lost the motion."""
    if not np.all(np.isfinite(state)):
        return False
    gyro, accel = np.linalg.norm(state[10:13]), np.linalg.norm(state[13:16])
    return bool(np.linalg.norm(state[7:10]) < 340 and gyro < 1.0 and accel < 5.0)
