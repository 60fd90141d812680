"""Visual-inertial odometry over a whole sequence."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Unpack

import numpy as np

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.window_run import WindowRun
from bundle.interface.option_class import takes_options
from bundle.interface.option_keywords import WindowKeywords
from bundle.interface.tabular import Tabular
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.sequence.sequence import Sequence


@dataclass(frozen=True, eq=False, repr=False)
class OdometryResult(Displayed, Tabular):
    """Result of an odometry.

    Attributes:
        trajectory: state of each image right after its solve, as a robot has it in real time; with
            ``marginalize="keep"``, states of the last solve, a batch.
        keyframes: telemetry of keyframes.
        start: "static" or "moving": method of initialisation.
        is_usable: False if the window lost track; ``message`` tells when.
        interrupted: True if Ctrl-C ended it; the trajectory ends there.
        message: one sentence.
        num_images: number of solved images.
        solve_time: seconds, without reading.
        options: options as used.
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


@takes_options(WindowOptions)
def run_odometry(
    sequence: Sequence,
    options: WindowOptions | None = None,
    *,
    progress: Callable[[int, int, KeyframeRecord | None], bool] | None = None,
    **changes: Unpack[WindowKeywords],
) -> OdometryResult:
    """Run a :class:`bundle.SlidingWindow` over a sequence.

    Args:
        sequence: IMU samples, tracks and calibration.
        options: options of the window, or some of its fields by name.
        progress: called after each image with (finished images, all images, record of a keyframe or
            None); returning False ends the odometry.
        **changes: fields of the options by name.

    Raises:
        InputError: no start is found, or the options are wrong.
    """
    options = WindowOptions.of(options, changes, "run_odometry")
    began = time.perf_counter()
    run = WindowRun(sequence, options)
    window, images, options = run.window, run.images, run.window.options
    message, interrupted = "done", False
    try:
        for image in () if run.lost else images.after(run.next_image, options.frame_rate):
            record = run.add(image)
            if run.lost:
                break
            if window.was_interrupted:
                raise KeyboardInterrupt
            if progress is not None and not progress(image + 1, len(images), record):
                message = "stopped by the caller"
                break
    except KeyboardInterrupt:  # keep what is solved
        message, interrupted = "interrupted", True
    trajectory = run.trajectory()
    if options.marginalize == "keep":
        stamps = np.array([frame.stamp for frame in window.frames], np.int64)
        trajectory = Trajectory(stamps, window.states)
    failure = run.failure()
    return OdometryResult(
        trajectory,
        run.records(),
        run.start,
        not failure,
        interrupted,
        failure or message,
        len(trajectory),
        time.perf_counter() - began,
        options,
    )
