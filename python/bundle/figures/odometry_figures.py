"""Figures of an odometry's telemetry: values per keyframe over time, and the path from above.

Times of the keyframes count from the first pose of the trajectory. Missing values are NaN: the
prior is missing before the first keyframe is marginalised, sigmas are missing without
``covariance``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.figures.marks import Figure, Line, line_figure
from bundle.inertial.preintegration.preintegration import HEALTHY, UNOBSERVABLE
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import aligned_in_yaw
from bundle.inertial.vio.window_alarms import LARGEST_ASYMMETRY, LARGEST_IMU_EXCESS, SMALLEST_RATIO
from bundle.io.sequences.trajectory_files import Trajectory

Array = NDArray[np.float64]

AXES = ("x", "y", "z")
PHASES = ("preintegration", "assembly", "solve", "marginalization", "total")
FAMILIES = ("visual", "imu", "bias_walk", "prior")
TIME = "s since the first pose"


def odometry_figures(result: OdometryResult, truth: Trajectory | None = None) -> tuple[Figure, ...]:
    """Return the figures of an odometry; each has a ``name``.

    Args:
        result: result of :func:`bundle.run_odometry`.
        truth: true trajectory for comparison, aligned in yaw and position; None: no comparison.

    Raises:
        InputError: the truth has fewer than three poses in common with the trajectory.
    """
    return (*_paths(result, truth), *_of_keyframes(result))


class _Keyframes:
    """Values per keyframe as lines over time."""

    def __init__(self, result: OdometryResult) -> None:
        self.records = result.keyframes
        self._begin = int(result.trajectory.timestamps_ns[0])
        self.seconds = np.array([self.since_begin(r.timestamp_ns) for r in self.records])

    def since_begin(self, stamp: int) -> float:
        return 1e-9 * (stamp - self._begin)

    def values(self, of: Callable[[KeyframeRecord], float | None]) -> Array:
        found = [of(record) for record in self.records]
        return np.array([np.nan if value is None else value for value in found], float)

    def line(self, label: str, of: Callable[[KeyframeRecord], float | None], **look: Any) -> Line:
        return Line(label, self.seconds, self.values(of), **look)

    def limit(self, label: str, value: float) -> Line:
        ends = self.seconds[[0, -1]]
        return Line(label, ends, np.full(2, value), is_limit=True)


def _of_keyframes(result: OdometryResult) -> list[Figure]:
    frames = _Keyframes(result)
    return [
        *_work(frames, 1e3 * result.options.time_budget),
        *_sizes(frames),
        *_prior(frames),
        *_nullity(frames),
        _excitation(frames),
        _contradiction(frames),
        _bias(frames, "gyro", "gyroscope", "rad/s"),
        _bias(frames, "accel", "accelerometer", "m/s²"),
        *_yaw_sigma(frames),
        *_departures(frames),
    ]


def _work(frames: _Keyframes, budget: float) -> list[Figure]:
    def milliseconds(phase: str) -> Line:
        return frames.line(phase, lambda r: 1e3 * r.times[phase] if phase in r.times else None)

    def cost(family: str) -> Line:
        return frames.line(family.replace("_", " "), lambda r: r.costs.get(family))

    return [
        line_figure(
            name="times", title="Time per keyframe", x_label=TIME, y_label="ms",
            lines=(*map(milliseconds, PHASES), frames.limit("budget of a solve", budget)),
            is_logarithmic=True,
        ),
        line_figure(
            name="steps", title="Steps of the solve", x_label=TIME, y_label="steps",
            lines=(
                frames.line("tried", lambda r: r.num_iterations),
                frames.line("rejected", lambda r: r.num_rejected),
            ),
        ),
        line_figure(
            name="costs", title="Cost by factor family", x_label=TIME, y_label="1/2 sum of rho",
            lines=tuple(map(cost, FAMILIES)), is_logarithmic=True,
            note="A wrong calibration shows in one family.",
        ),
    ]  # fmt: skip


def _contradiction(frames: _Keyframes) -> Figure:
    return line_figure(
        name="imu_excess", title="IMU cost divided by its expected value", x_label=TIME,
        y_label="ratio",
        lines=(
            frames.line("ratio", lambda r: r.imu_excess),
            frames.limit("alarm above", LARGEST_IMU_EXCESS),
        ),
        note="Large where camera and IMU contradict each other.",
    )  # fmt: skip


def _sizes(frames: _Keyframes) -> list[Figure]:
    return [
        line_figure(
            name="sizes", title="Size of the solve", x_label=TIME, y_label="count",
            lines=(
                frames.line("rows", lambda r: r.num_rows),
                frames.line("columns", lambda r: r.num_columns),
                frames.line("landmarks", lambda r: r.num_landmarks),
            ),
        ),
        line_figure(
            name="fill", title="Fill-in of the factor", x_label=TIME, y_label="nnz(L) / nnz(Λ)",
            lines=(frames.line("nnz(L) / nnz(Λ)", lambda r: r.fill_ratio),),
            note="Of the reduced matrix of the states; 1 where it is dense.",
        ),
    ]  # fmt: skip


def _prior(frames: _Keyframes) -> list[Figure]:
    def size(value: float | None) -> float | None:
        return None if value is None else abs(value)

    return [
        line_figure(
            name="spectrum", title="Eigenvalues of the prior", x_label=TIME,
            y_label="information", is_logarithmic=True,
            lines=(
                frames.line("largest", lambda r: r.prior_max_eigenvalue),
                frames.line("smallest, absolute", lambda r: size(r.prior_min_eigenvalue)),
            ),
            note="The smallest is rounding error where position and yaw are unobservable.",
        ),
        line_figure(
            name="prior", title="Health of the prior", x_label=TIME, y_label="ratio",
            is_logarithmic=True,
            lines=(
                frames.line("eigenvalue ratio", lambda r: r.prior_ratio),
                frames.limit("alarm where the ratio is below", SMALLEST_RATIO),
                frames.line("asymmetry", lambda r: r.prior_asymmetry),
                frames.limit("alarm where the asymmetry is above", LARGEST_ASYMMETRY),
            ),
            note="Eigenvalue ratio: of the information on the oldest frame, given all others.",
        ),
    ]  # fmt: skip


def _nullity(frames: _Keyframes) -> list[Figure]:
    if all(record.nullity is None for record in frames.records):  # counted with --nullity
        return []
    return [line_figure(
        name="nullity", title="Unobservable directions", x_label=TIME, y_label="nullity",
        lines=(
            frames.line("nullity", lambda r: r.nullity),
            frames.line("expected", lambda r: r.expected_nullity, is_limit=True),
        ),
        note="Fewer than expected: the window gained information that no sensor measures.",
    )]  # fmt: skip


def _excitation(frames: _Keyframes) -> Figure:
    verdicts = [record.excitation_verdict for record in frames.records]
    counts = [f"{name} {verdicts.count(name)}" for name in dict.fromkeys(verdicts)]
    return line_figure(
        name="excitation", title="Excitation of the accelerometer", x_label=TIME, y_label="m/s²",
        is_logarithmic=True,
        lines=(
            frames.line("standard deviation of |a|", lambda r: r.excitation),
            frames.limit("healthy above", HEALTHY),
            frames.limit("scale unobservable below", UNOBSERVABLE),
        ),
        note=f"Keyframes by verdict: {', '.join(counts)}.",
    )  # fmt: skip


def _bias(frames: _Keyframes, name: str, words: str, unit: str) -> Figure:
    lines = []
    known = False
    for axis, label in enumerate(AXES):
        sigma = frames.values(lambda r, axis=axis: _entry(r, f"{name}_bias_sigma", axis))  # type: ignore[misc]
        known = known or bool(np.isfinite(sigma).any())
        line = frames.line(label, lambda r, axis=axis: _entry(r, f"{name}_bias", axis))  # type: ignore[misc]
        lines.append(Line(label, line.x, line.y, sigma if np.isfinite(sigma).any() else None))
    return line_figure(
        name=f"{name}_bias", title=f"Bias of the {words}", x_label=TIME, y_label=unit,
        lines=tuple(lines),
        note="Band: one standard deviation." if known else "With --covariance also its sigmas.",
    )  # fmt: skip


def _entry(record: KeyframeRecord, field: str, axis: int) -> float | None:
    values = getattr(record, field)
    return None if values is None else float(values[axis])


def _yaw_sigma(frames: _Keyframes) -> list[Figure]:
    sigma = np.degrees(frames.values(lambda r: r.yaw_sigma))
    rotation = np.degrees(frames.values(lambda r: r.accumulated_rotation))
    if not np.isfinite(sigma).any():  # unknown without --covariance and the sigmas of the start
        return []
    return [line_figure(
        name="yaw_sigma", title="Sigma of yaw against rotation",
        x_label="rotation since the start, degrees", y_label="sigma of yaw, degrees",
        lines=(Line("sigma of yaw", rotation, sigma),),
        note="No sensor measures yaw: it must not fall.",
    )]  # fmt: skip


def _departures(frames: _Keyframes) -> list[Figure]:
    records = frames.records
    ways = dict.fromkeys(r.marginalized["how"] for r in records if r.marginalized is not None)

    def age(record: KeyframeRecord, how: str) -> float | None:
        gone = record.marginalized
        if gone is None or gone["how"] != how:
            return None
        return 1e-9 * float(record.timestamp_ns - gone["timestamp_ns"])

    names = {"marginalize": "into the prior", "drop": "dropped"}
    ages = [
        frames.line(names[how], lambda r, how=how: age(r, how), is_dotted=True)  # type: ignore[misc]
        for how in ways
    ]
    left = sum(r.marginalized is not None for r in records)
    return [
        line_figure(
            name="ages", title="Keyframes that left the window", x_label=TIME,
            y_label="age when it left, s", lines=tuple(ages),
            note=f"{left} of {len(records)} keyframes have left.",
        ),
        line_figure(
            name="landmarks_left", title="Landmarks of keyframes that left", x_label=TIME,
            y_label="landmarks",
            lines=(
                frames.line("into the prior", lambda r: r.num_absorbed),
                frames.line("go on from their next image", lambda r: r.num_carried),
                frames.line("rejected as outliers", lambda r: r.num_rejected_tracks),
            ),
        ),
    ]  # fmt: skip


def _paths(result: OdometryResult, truth: Trajectory | None) -> list[Figure]:
    labels: dict[str, Any] = {
        "name": "path", "title": "Path from above", "x_label": "x [m]", "y_label": "y [m]",
        "is_plan": True,
    }  # fmt: skip
    if truth is None:
        x, y = result.trajectory.states[:, 4:6].T
        return [line_figure(lines=(Line("estimate", x, y),), **labels)]
    stamps, found, wanted = aligned_in_yaw(result.trajectory, truth)
    lines = (
        Line("estimate", found[:, 4], found[:, 5]),
        Line("ground truth", wanted[:, 4], wanted[:, 5]),
    )
    seconds = 1e-9 * (stamps - result.trajectory.timestamps_ns[0]).astype(float)
    error = found[:, 4:7] - wanted[:, 4:7]
    errors = (
        Line("horizontal", seconds, np.linalg.norm(error[:, :2], axis=1)),
        Line("vertical", seconds, np.abs(error[:, 2])),
    )
    note = "Aligned in yaw and position."
    return [
        line_figure(lines=lines, note=note, **labels),
        line_figure(
            name="error", title="Error of the position", x_label=TIME, y_label="error [m]",
            lines=errors, note=note,
        ),
    ]  # fmt: skip
