"""Visual-inertial odometry over a whole sequence, and statistics of the sequence."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.inertial.preintegration.preintegration import excitation
from bundle.inertial.vio.initialize import rest_at_start
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.window_run import WindowRun
from bundle.interface.option_class import takes_options
from bundle.interface.tabular import Tabular
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import GAP

if TYPE_CHECKING:
    from bundle.interface.option_keywords import WindowKeywords


@dataclass(frozen=True, eq=False, repr=False)
class OdometryResult(Displayed, Tabular):
    """Result of an odometry.

    Attributes:
        trajectory: state of each image right after its solve, as a robot has it in real time; with
            ``marginalize="keep"``, states of the last solve, a batch.
        keyframes: telemetry of keyframes.
        start: "static" or "moving": method of initialisation.
        is_usable: False if the window lost track; ``message`` gives the time.
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

    @property
    def duration(self) -> float:
        """Seconds from the first image to the last."""
        return 1e-9 * float(np.ptp(self.trajectory.timestamps_ns))

    def _display(self) -> Display:
        return Display(
            title=f"Odometry over {self.duration:.2f} s: {self.message}",
            facts=(
                ("start", self.start),
                ("images", f"{self.num_images}, {len(self.keyframes)} keyframes"),
                ("time", f"{self.solve_time:.3g} s"),
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
        trajectory, run.records(), run.start, not failure, interrupted, failure or message,
        len(trajectory), time.perf_counter() - began, options,
    )  # fmt: skip


# Statistics of a sequence: rates, overlap, noise at rest, excitation.
#
# White noise of density s, sampled at f Hz, has a standard deviation of s sqrt(f) per sample.
# Differences of consecutive samples, divided by sqrt(2), measure it without slow changes.

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SequenceStatistics:
    """Statistics of a sequence."""

    imu_rate: float  # from the median step [Hz]
    camera_rate: float
    num_imu_gaps: int  # steps of more than 2.5 periods
    num_image_gaps: int
    overlap: float  # seconds covered by both sensors
    static_start: float  # seconds of rest at the start; 0 if it starts in motion
    gyro_noise_density: float  # measured over the rest at the start; nan without rest
    accel_noise_density: float
    excitation: float  # standard deviation of |specific force| over the images [m/s^2]
    verdict: str  # observability of the scale: "healthy", "marginal" or "unobservable"
    tracks_per_image: dict[str, float]  # min, median, mean, max
    track_length: dict[str, float]


def sequence_statistics(sequence: Sequence) -> SequenceStatistics:
    """Return the statistics of a sequence."""
    stamps, images = sequence.imu_timestamps_ns, sequence.image_timestamps_ns
    frames, begin = sequence.frames()
    steps, image_steps = np.diff(stamps), np.diff(frames)
    period = float(np.median(steps)) * 1e-9
    _, rest = rest_at_start(SequenceImages(sequence))
    seen = (stamps >= images[0]) & (stamps <= images[-1])
    excited = excitation(sequence.accel[seen] if np.count_nonzero(seen) > 1 else sequence.accel)
    return SequenceStatistics(
        imu_rate=1 / period,
        camera_rate=1e9 / float(np.median(image_steps)) if len(image_steps) else float("nan"),
        num_imu_gaps=_gaps(steps),
        num_image_gaps=_gaps(image_steps),
        overlap=1e-9 * float(min(stamps[-1], images[-1]) - max(stamps[0], images[0])),
        static_start=1e-9 * float(stamps[rest - 1] - stamps[0]) if rest else 0.0,
        gyro_noise_density=_white(sequence.gyro[:rest], period),
        accel_noise_density=_white(sequence.accel[:rest], period),
        excitation=excited.spread,
        verdict=excited.verdict,
        tracks_per_image=_spread(np.diff(begin)),
        track_length=_spread(np.unique(sequence.track_ids, return_counts=True)[1]),
    )


def _gaps(steps: NDArray[np.int64]) -> int:
    return int(np.count_nonzero(steps > GAP * np.median(steps))) if len(steps) else 0


def _white(values: Array, period: float) -> float:
    if len(values) < 3:
        return float("nan")
    differences = np.diff(values, axis=0)
    return float(np.sqrt(np.mean(differences.var(axis=0)) / 2 * period))


def _spread(counts: NDArray[np.int64]) -> dict[str, float]:
    return {
        "min": float(counts.min()),
        "median": float(np.median(counts)),
        "mean": float(counts.mean()),
        "max": float(counts.max()),
    }
