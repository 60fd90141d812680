"""The page of an odometry: what each keyframe knew, over time, and the path from above."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import check_type
from bundle.base.paths import as_path
from bundle.base.words import number, plural
from bundle.figures.line_figure import LineFigure
from bundle.figures.odometry_figures import odometry_figures
from bundle.inertial.vio.keyframe_record import alarms_by_kind
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.reports.page.line_charts import Band, dots, lines
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.scale import Scale, linear, logarithmic
from bundle.reports.page.svg_charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Curve
from bundle.reports.page.table import table

__all__ = ["write_odometry"]

SHAPE = (WIDTH - LEFT - RIGHT) / (HEIGHT - TOP - BOTTOM)
GREY = 6  # a colour of the page
SECTIONS = {
    "Trajectory": ("path", "error"),
    "Work": ("times", "steps", "costs", "sizes", "fill"),
    "What the window knows": (
        "nullity",
        "excitation",
        "imu_excess",
        "yaw_sigma",
        "spectrum",
        "prior",
    ),
    "Biases": ("gyro_bias", "accel_bias"),
    "What left the window": ("ages", "landmarks_left"),
}
ROWS = 12


def write_odometry(
    result: OdometryResult,
    path: str | os.PathLike[str],
    *,
    truth: Trajectory | None = None,
    error: TrajectoryError | None = None,
    name: str = "",
) -> None:
    """Write one HTML page about an odometry, which needs no network and no other file.

    Args:
        result: of :func:`bundle.run_odometry`.
        path: of the page, which appears whole or not at all.
        truth: the true trajectory, drawn beside the estimate.
        error: of :func:`bundle.inertial.vio.trajectory_comparison.compare_trajectories`, for the
        table.
        name: of the sequence, for the title.

    Raises:
        InputError: ``result`` is none, the truth has fewer than three poses in common with the
            trajectory, or the page cannot stand there.
        OSError: the page cannot be written.
    """
    check_type("result", result, OdometryResult)
    check_type("name", name, str)
    figures = {figure.name: figure for figure in odometry_figures(result, truth)}
    sections = [_facts(result, error), _alarms(result)]
    for title, names in SECTIONS.items():
        drawn = [_figure(figures[key]) for key in names if key in figures]
        sections += [tag("h2", title), tag("div", *drawn, class_="grid")]
    title = f"Odometry of {name}" if name else "Odometry"
    data = {"figures": [figure.asdict() for figure in figures.values()]}
    write_page(as_path(path), title, sections, data, script="")


def _facts(result: OdometryResult, error: TrajectoryError | None) -> str:
    stamps = result.trajectory.timestamps_ns
    span = 1e-9 * float(stamps[-1] - stamps[0])
    reasons = Counter(record.reason for record in result.keyframes)
    rows = [
        ["result", result.message],
        ["trajectory", f"{number(span)} s, {plural(result.num_images, 'image')}"],
        ["start", result.start],
        ["keyframes", ", ".join(f"{count} by {reason}" for reason, count in reasons.items())],
        ["time", f"{number(result.solve_time)} s"],
    ]
    if error is not None:
        rows += [
            ["ATE", f"{number(error.ate)} m rms along {number(error.path_length)} m"],
            ["ATE, yaw and position aligned", f"{number(error.ate_yaw)} m rms"],
            ["scale", f"{error.scale:.5f}"],
            ["rotation", f"{number(error.rotation_rms)} degrees rms"],
        ]
    return table(["", "odometry"], rows, words={1})


def _alarms(result: OdometryResult) -> str:
    """Return each alarm once, with the keyframes that raised it."""
    begin = int(result.trajectory.timestamps_ns[0])
    found = alarms_by_kind(result.keyframes)
    heading = tag("h2", "Alarms")
    if not found:
        return heading + tag("p", "None.")
    rows = []
    for raised in found.values():
        first, last = (f"{1e-9 * (raised[k][0] - begin):.2f}" for k in (0, -1))
        rows.append([raised[0][1], f"{len(raised)}", first, last])
    head = ["alarm", "keyframes", "first [s]", "last [s]"]
    return heading + table(head, rows, rows_shown=ROWS)


def _figure(figure: LineFigure) -> str:
    limits = [line for line in figure.lines if line.is_limit]
    curves = [
        Curve(line.label, line.x.tolist(), line.y.tolist(), GREY, 1 + limits.index(line))
        if line.is_limit
        else Curve(line.label, line.x.tolist(), line.y.tolist(), index)
        for index, line in enumerate(figure.lines)
    ]
    bands = [
        Band(curve.x, (line.y - line.sigma).tolist(), (line.y + line.sigma).tolist(), curve.colour)
        for curve, line in zip(curves, figure.lines, strict=True)
        if line.sigma is not None
    ]
    if figure.is_logarithmic:  # zero and below have no place there
        curves = [
            Curve(c.label, c.x, [y if y > 0 else math.nan for y in c.y], c.colour, c.line)
            for c in curves
        ]
    x_scale, y_scale = _scales(figure, bands)
    lonely = [
        dots(curve, x_scale, y_scale)
        for curve, line in zip(curves, figure.lines, strict=True)
        if line.is_dotted or len(curve.x) == 1
    ]
    joined = [
        Curve(c.label, [], [], c.colour, c.line) if line.is_dotted else c
        for c, line in zip(curves, figure.lines, strict=True)
    ]
    chart = lines(
        joined, x_scale, y_scale, figure.x_label, figure.y_label, bands=bands, extra="".join(lonely)
    )
    note = [tag("figcaption", escape(figure.note))] if figure.note else []
    return tag("figure", tag("h3", escape(figure.title)), chart, *note, data_figure=figure.name)


def _scales(figure: LineFigure, bands: Sequence[Band]) -> tuple[Scale, Scale]:
    x = _all([line.x for line in figure.lines])
    y = _all([line.y for line in figure.lines] + [np.array(b.low) for b in bands])
    y = np.concatenate([y, _all([np.array(band.high) for band in bands])])
    if figure.is_plan:
        return _plan(x, y)
    if figure.is_logarithmic:
        return linear(x), logarithmic(y)
    return linear(x), linear(y, low=None if (y < 0).any() else 0.0)


def _plan(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[Scale, Scale]:
    """Return scales on which a metre is as long across as up."""
    middle = [(values.min() + values.max()) / 2 for values in (x, y)]
    half = [(values.max() - values.min()) / 2 for values in (x, y)]
    reach = max(1.05 * half[0] / SHAPE, 1.05 * half[1], 1e-3)
    ends = zip(middle, (reach * SHAPE, reach), strict=True)
    made = [linear([at - width, at + width], low=None) for at, width in ends]
    return made[0], made[1]


def _all(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the finite values of all."""
    values: NDArray[np.float64] = np.concatenate([np.zeros(0), *parts])
    return values[np.isfinite(values)]
