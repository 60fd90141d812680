"""Sliding window of visual-inertial odometry (a fixed-lag smoother with telemetry).

Each new image is solved together with the previous keyframes, their landmarks and the IMU factors
between them. If it becomes a keyframe, it stays, and the oldest keyframe is marginalised with its
anchored landmarks and its IMU factor into a prior on the remaining states. Otherwise the next image
replaces it, and its IMU samples join the next interval, so that no sample is lost.

Every observation counts once. Tracks of marginalised landmarks start again with the next images.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

import bundle._core as _core
from bundle.base.arrays import refuse_row
from bundle.errors import InputError
from bundle.inertial.preintegration.preintegration import as_vector
from bundle.inertial.vio.keyframe_record import KeyframeRecord, keyframe_reason
from bundle.inertial.vio.landmark_depths import LandmarkDepths
from bundle.inertial.vio.landmark_table import (
    FrameTracks,
    LandmarkTable,
    TrackNumbers,
    landmark_table,
)
from bundle.inertial.vio.marginal_prior import MarginalPrior, start_prior, steady_speed
from bundle.inertial.vio.window_frame import ImuInterval, WindowFrame, repropagate
from bundle.inertial.vio.window_telemetry import WindowTelemetry, window_arrays
from bundle.interface.option_class import takes_options
from bundle.interface.window_options import WindowOptions
from bundle.model.sequence.calibration import ImuNoise

if TYPE_CHECKING:
    from bundle.interface.option_keywords import WindowKeywords

Array = np.ndarray[Any, Any]

# Sigmas beyond which a whole track is an outlier.
OUTLIER = 6.0
FEWEST = 4  # observations of an image that say something about it


class SlidingWindow:
    """Visual-inertial odometry over the last keyframes.

    Args:
        camera_from_imu: (7,) qx qy qz qw tx ty tz.
        noise: IMU noise of the data sheet; ``imu_noise_scale`` of the options multiplies the two
            white noises.
        focal: pixels per unit of normalised image coordinates, for sigmas and limits in pixels.
        gravity: m/s^2 in the world, z up.
        options: a :class:`bundle.WindowOptions`, or some of its fields by name.

    Attributes:
        far_share: share of outliers after the last solve, in the newest image, with parallax.

    Raises:
        InputError: an argument has a wrong shape or value.
    """

    @takes_options(WindowOptions)
    def __init__(
        self,
        camera_from_imu: Any,
        noise: ImuNoise,
        focal: float,
        *,
        gravity: Any = (0.0, 0.0, -9.81),
        time_offset: float = 0.0,
        options: WindowOptions | None = None,
        **changes: Unpack[WindowKeywords],
    ) -> None:
        self.options = WindowOptions.of(options, changes, "SlidingWindow")
        self.camera_from_imu = as_vector("camera_from_imu", camera_from_imu, 7)
        if not abs(np.linalg.norm(self.camera_from_imu[:4]) - 1) < 1e-3:
            raise InputError("camera_from_imu: expected a unit quaternion x y z w first")
        self.gravity = as_vector("gravity", gravity)
        self.noise = noise.scaled(self.options.imu_noise_scale, walks=False)
        self.focal = float(focal)
        if not self.focal > 0:
            raise InputError(f"focal: expected pixels above 0, found {focal}")
        self.sigma = (self.options.pixel_sigma or 1.0) / self.focal
        self.time_offset = float(time_offset)
        self.frames: list[WindowFrame] = []
        self.prior: MarginalPrior | None = None
        self.records: list[KeyframeRecord] = []
        self.was_interrupted = False
        self.far_share = 0.0
        self._depths = LandmarkDepths()
        self._numbers = TrackNumbers()
        self._telemetry = WindowTelemetry(self)

    @property
    def stamps(self) -> Array:
        """Stamps of the frames, ns (n,)."""
        return np.array([frame.stamp for frame in self.frames], np.int64)

    @property
    def states(self) -> Array:
        """States of the frames (n, 16): qx qy qz qw, position, velocity, two biases."""
        return np.array([frame.state for frame in self.frames]).reshape(-1, 16)

    @property
    def covariance(self) -> Array | None:
        """Covariance (15, 15) of the newest state after the last solve, with ``covariance=True``.

        Rotation (R Exp(d), rad), position, velocity, biases. If the start has no prior on position
        and yaw, they are relative to those of the oldest frame. None if the covariance does not
        exist.
        """
        return self._telemetry.covariance

    def start(
        self,
        stamps: Any,
        states: Any,
        tracks: Sequence[FrameTracks],
        intervals: Sequence[ImuInterval],
        *,
        at_rest: bool = False,
    ) -> KeyframeRecord:
        """Start with keyframes of known states, from an initialisation.

        Args:
            stamps: ns, ascending (n,).
            states: (n, 16) states.
            tracks: tracks of each image.
            intervals: IMU samples of n - 1 intervals, from each image to the next.
            at_rest: the platform does not move in these images.

        Raises:
            InputError: there are fewer than two keyframes, or sizes do not fit.
        """
        rows = np.asarray(states, float)
        if rows.ndim != 2 or rows.shape[1] != 16 or len(rows) < 2:
            raise InputError(f"states: expected at least two rows of 16, found {rows.shape}")
        refuse_row(
            ~(np.linalg.norm(rows[:, :4], axis=1) > 0),
            lambda row: f"states[{row}]: expected a quaternion x y z w, found norm 0",
        )
        if not (len(rows) == len(stamps) == len(tracks) == len(intervals) + 1):
            raise InputError("start: expected one stamp, state and set of tracks per image")
        for k, seen in enumerate(tracks):
            seen.check(f"tracks[{k}]")
            if k and not int(stamps[k]) > int(stamps[k - 1]):
                raise InputError(f"stamps[{k}]: expected more than {stamps[k - 1]}")
        self.frames = [
            WindowFrame(int(stamp), row.copy(), self._numbers.of(seen), is_keyframe=True)
            for stamp, row, seen in zip(stamps, rows, tracks, strict=True)
        ]
        for before, frame, interval in zip(self.frames, self.frames[1:], intervals, strict=False):
            self._attach(frame, interval, before.state)
        options = self.options
        self.prior = start_prior(
            [frame.stamp for frame in self.frames],
            rows,
            position=options.start_position_sigma,
            yaw=np.radians(options.start_yaw_sigma),
            gyro_bias=options.start_gyro_bias_sigma,
            accel_bias=options.start_accel_bias_sigma,
            at_rest=at_rest,
            square_root=options.prior_form == "square_root",
            camera=self.camera_from_imu if options.refine_extrinsics else None,
        )
        self._anchor(self.prior)
        self._telemetry.begin()
        self._solve(generous=True)
        while self._is_full(len(self.frames)):
            self._marginalize_oldest()
        return self._record("start", 0.0)

    def add_frame(
        self, stamp: int, interval: ImuInterval, tracks: FrameTracks
    ) -> KeyframeRecord | None:
        """Add an image and the samples since the previous one; solve.

        Returns:
            Record if the image became a keyframe, otherwise None.

        Raises:
            InputError: there is no start, the stamp is not later, or the samples are invalid.
        """
        if not self.frames:
            raise InputError("add_frame: expected a call of start() before")
        self._telemetry.begin()
        newest = self.frames[-1]
        if stamp <= newest.stamp:
            raise InputError(f"stamp: expected more than {newest.stamp}, found {stamp}")
        tracks.check(f"tracks of {stamp}")
        tracks = self._numbers.of(tracks)
        if not newest.is_keyframe:
            interval = self._drop_newest().then(interval)
            newest = self.frames[-1]
        frame = WindowFrame(int(stamp), newest.state.copy(), tracks)
        self._attach(frame, interval, newest.state)
        assert frame.inertia is not None
        frame.state = frame.inertia.predict(newest.state, self.gravity)
        self.frames.append(frame)
        self._telemetry.lap("preintegration")
        self._solve()
        reason, parallax = keyframe_reason(
            newest.tracks,
            frame.tracks,
            self.focal,
            float(np.linalg.norm(frame.state[4:7] - newest.state[4:7])),
            1e-9 * (frame.stamp - newest.stamp),
            self.options,
        )
        if not reason:
            return None
        frame.is_keyframe = True
        if self._is_full(len(self.frames) - 1):
            self._marginalize_oldest()
        return self._record(reason, parallax)

    def _is_full(self, count: int) -> bool:
        return self.options.marginalize != "keep" and count > self.options.window

    def _attach(self, frame: WindowFrame, interval: ImuInterval, state: Array) -> None:
        frame.interval = interval
        frame.inertia = interval.integrated(self.noise, state, self.options.integration)

    def _drop_newest(self) -> ImuInterval:
        """Remove the newest frame, which is not a keyframe; its samples join the next interval."""
        frame = self.frames.pop()
        assert frame.interval is not None
        self._depths.leave(frame, self.frames, self.camera_from_imu)
        return frame.interval

    def _anchor(self, prior: MarginalPrior | None) -> None:
        """Fix the first estimates of frames in a prior (first-estimate Jacobians, FEJ)."""
        touched = prior.frames() if prior is not None else set()
        for frame in self.frames:
            if frame.stamp in touched and frame.anchor is None:
                frame.anchor = frame.state.copy()

    def _priors(self, steady: list[WindowFrame]) -> list[dict[str, Any]]:
        priors, sigma = [self.prior], self.options.steady_speed_sigma
        if sigma > 0 and self._telemetry.excitation()[1] == "unobservable":
            priors.append(steady_speed(steady, sigma, self.options.prior_form == "square_root"))
        places = {frame.stamp: place for place, frame in enumerate(self.frames)}
        return [prior.at(places) for prior in priors if prior is not None]

    def _table(self) -> tuple[LandmarkTable, Array]:
        """Return the landmarks of the window, and x, y, 1 / z of each in its anchor."""
        table = landmark_table([frame.tracks for frame in self.frames])
        return self._depths.of(table, self.frames, self.camera_from_imu, self.sigma)

    def _solve(self, generous: bool = False) -> None:
        options = self.options
        self._telemetry.num_repropagated += repropagate(self.frames)
        table, points = self._table()
        window = window_arrays(self, table, points)
        if options.jacobians == "relinearize_prior" and self.prior is not None:
            self.prior = self.prior.relinearized({f.stamp: f.state for f in self.frames})
        window["priors"] = self._priors(self.frames)
        self._telemetry.lap("assembly")
        checks = self._telemetry.wants_expected_cost()
        solved = _core.solve_window(
            window,
            {
                "max_num_iterations": 50 if generous else options.max_num_iterations,
                "time_budget": 10.0 if generous else options.time_budget,
                "function_tolerance": options.function_tolerance,
                "spectrum": options.nullity,
                "covariance": options.covariance or self._telemetry.is_quiet or checks,
                "expected_imu_cost": checks,
                "fix_gauge": self._telemetry.expected_nullity == 4,
            },
            None,
        )
        self.was_interrupted |= solved["interrupted"]
        for frame, state in zip(self.frames, solved["states"], strict=True):
            frame.state = state
        self.camera_from_imu = np.array(solved["camera_from_imu"])
        self.time_offset = solved["time_offset"]
        self._depths.put(table, self.frames, solved["points"])
        self._reject(table, solved["residual_norms"])
        self._telemetry.solved(table, window, solved)
        self._telemetry.lap("solve")

    def _reject(self, table: LandmarkTable, norms: Array) -> None:
        """Discard tracks far from their prediction in most of their images, or behind one."""
        moved = self.focal * table.parallax() >= self.options.marginal_parallax
        now = norms[(table.observers == len(self.frames) - 1) & moved[table.landmarks]]
        self.far_share = float(np.mean(~(now <= OUTLIER))) if len(now) >= FEWEST else 0.0
        count = np.maximum(np.bincount(table.landmarks, minlength=len(table.ids)), 1)
        far = np.bincount(table.landmarks, norms > OUTLIER, len(table.ids))
        behind = np.bincount(table.landmarks, ~np.isfinite(norms), len(table.ids)) > 0
        wrong = table.ids[(far > 0.5 * count) | behind]
        self._telemetry.num_rejected_tracks += len(wrong)
        if len(wrong):
            self._forget(wrong)

    def _forget(self, ids: Array) -> None:
        for frame in self.frames:
            frame.tracks = frame.tracks.without(ids)
        self._depths.forget(ids)

    def _marginalize_oldest(self) -> None:
        oldest = self.frames[0]
        if self.options.marginalize == "drop":
            self.prior = None
            self._depths.leave(oldest, self.frames[1:], self.camera_from_imu)
            self.frames.pop(0)
            self._cut_inertia()
            self._telemetry.left(oldest, "drop", 0, 0)
            self._telemetry.lap("marginalization")
            return
        table, points = self._table()
        goes = table.anchors == 0
        moved = self.focal * table.parallax() >= self.options.marginal_parallax
        absorbed = goes & moved
        carried = goes & ~moved
        kept = table.only(~carried)
        window = window_arrays(self, kept, points[~carried])
        window["priors"] = self._priors(self.frames[:2])
        flags = np.zeros(len(self.frames), np.uint8)
        flags[0] = 1
        found = _core.marginalize_window(
            window,
            {
                "states": flags,
                "landmarks": absorbed[~carried].astype(np.uint8),
                "imu": flags[: len(self.frames) - 1],
                "keep_points": self.options.jacobians != "relinearize_prior",
                "square_root": self.options.prior_form == "square_root",
                "single_precision": self.options.precision == "single",
            },
        )
        self.prior = MarginalPrior.of(found, [frame.stamp for frame in self.frames])
        self._anchor(self.prior)
        self._forget(table.ids[absorbed])
        self._depths.leave(oldest, self.frames[1:], self.camera_from_imu)
        self.frames.pop(0)
        self._cut_inertia()
        self._telemetry.left(oldest, "marginalize", int(absorbed.sum()), int(carried.sum()))
        self._telemetry.lap("marginalization")

    def _cut_inertia(self) -> None:
        self._numbers.keep(np.unique(np.concatenate([frame.tracks.ids for frame in self.frames])))
        self.frames[0].interval = self.frames[0].inertia = None

    def _record(self, reason: str, parallax: float) -> KeyframeRecord:
        record = self._telemetry.record(reason, parallax, time.perf_counter())
        self.records.append(record)
        return record
