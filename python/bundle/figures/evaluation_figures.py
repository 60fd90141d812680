"""Figures of a comparison with a reference: errors of images, paths from above, lenses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number
from bundle.figures.axes import SHAPE, linear, round_down, square
from bundle.figures.drawing import Figure, over_image
from bundle.figures.marks import GREY, Array, Cells, Dots, Line, Mark, Vectors
from bundle.judging.evaluation.evaluation_result import Evaluation
from bundle.judging.evaluation.lens_difference import LensDifference
from bundle.model.pose_errors import ErrorStatistics

MOST_DOTS = 2000
"""Number of poses that a figure draws, in addition to those with the largest errors."""

LONGEST = 0.15
"""Drawn length of the largest error, relative to the height of the figure."""


def error_figures(found: Evaluation) -> list[Figure]:
    """Return figures of position errors, rotation errors and sigmas against the images."""
    unit = found.unit if found.unit == "m" else "units of B"
    rows = [
        ("position_errors", "Position error", f"position error [{unit}]", found.position_errors),
        ("rotation_errors", "Rotation error", "rotation error [degrees]", found.rotation_errors),
    ]
    if found.movement is not None:
        rows.append(("sigmas", "Difference in sigmas", "sigmas of A", found.movement.sigmas))
    x = np.arange(found.num_shared, dtype=float)
    is_image = found.association.by in ("name", "base name", "stem")
    label = "image in the order of names" if is_image else "pose in the order of time"
    shown = _drawn(found)
    names = [found.association.names[row] for row in shown.tolist()]
    return [
        _errors(name, title, (label, y_label), x[shown], y[shown], names, y)
        for name, title, y_label, y in rows
    ]


def _drawn(found: Evaluation) -> NDArray[np.int64]:
    """Return evenly spaced poses, and those with the largest position errors."""
    count = found.num_shared
    even = np.linspace(0, count - 1, min(count, MOST_DOTS)).round().astype(np.int64)
    worst = np.argsort(-found.position_errors, kind="stable")[: MOST_DOTS // 20]
    return np.union1d(even, worst)


def _errors(
    name: str,
    title: str,
    labels: tuple[str, str],
    x: Array,
    y: Array,
    names: Sequence[str],
    whole: Array,
) -> Figure:
    known = np.isfinite(y)
    shown = tuple(n for n, is_known in zip(names, known, strict=True) if is_known)
    rms = ErrorStatistics.of(whole[np.isfinite(whole)]).rmse
    ends = x[[0, -1]]
    limit = Line(f"rms {number(rms)}", ends, np.full(2, rms), is_limit=True, colour=GREY, dash=1)
    return Figure(
        name=name,
        title=title,
        x=linear(x.tolist(), labels[0]),
        y=linear([0.0, *(1.05 * y[known]).tolist()], labels[1]),
        marks=(Dots(np.column_stack([x, y])[known], (), shown), limit),
    )


def paths_figure(found: Evaluation) -> Figure:
    """Return the centres of A and B, seen along the direction in which B extends least."""
    middle = found.reference.mean(axis=0)
    axes = np.linalg.svd(found.reference - middle, full_matrices=False)[2][:2]
    there, here = ((points - middle) @ axes.T for points in (found.reference, found.estimate))
    step = there - here
    both = np.vstack([there, here])
    low, high = both.min(axis=0), both.max(axis=0)
    half, center = (high - low) / 2, (low + high) / 2
    reach = 1.1 * max(float(half[0]) / SHAPE, float(half[1])) or 1.0
    unit = found.unit if found.unit == "m" else "units of B"
    x, y = square(
        (float(center[0]), float(center[1])),
        reach,
        (f"first axis [{unit}]", f"second axis [{unit}]"),
    )
    rows = _drawn(found)
    names = tuple(found.association.names[row] for row in rows.tolist())
    longest = float(np.hypot(*step.T).max())
    is_exact = longest <= 1e-9 * reach
    factor = 1.0 if is_exact else max(round_down(LONGEST * reach / longest), 1.0)
    marks: list[Mark] = [
        *_path(found, "B", there[rows], 1),
        *_path(found, "A, aligned", (there - factor * step)[rows], 0),
        Dots(there[rows], (1,) * len(rows), names),
        Vectors(there[rows], -factor * step[rows], colour=0),
    ]
    return Figure(
        name="paths",
        title="Centres from above",
        x=x,
        y=y,
        marks=tuple(marks),
        note="Seen along the direction in which B extends least. Dots: B; lines lead to A"
        + (f", {factor:g} times as long." if factor > 1 else "."),
        is_plan=True,
    )


def _path(found: Evaluation, label: str, points: Array, colour: int) -> list[Line]:
    """Return a line through poses in the order of time; images have no order."""
    if found.association.by not in ("time", "frame number", "order"):
        return []
    return [Line(label, points[:, 0], points[:, 1], colour=colour)]


def lens_difference_figure(lens: LensDifference) -> Figure:
    """Return the difference of two lenses over the image: length as cells, direction as lines."""
    rows, columns = lens.field.shape[:2]
    lengths = np.linalg.norm(lens.field, axis=-1)
    cell = (lens.box[2:] - lens.box[:2]) / (columns, rows)
    x = lens.box[0] + cell[0] * (np.arange(columns) + 0.5)
    y = lens.box[1] + cell[1] * (np.arange(rows) + 0.5)
    at = np.stack(np.meshgrid(x, y), axis=-1)
    known = np.isfinite(lengths)
    known[1::2] = False
    known[:, 1::2] = False
    top = lens.pixels.max if lens.pixels.max > 0 else 1.0
    factor = round_down(1.5 * float(cell.min()) / top)
    titles = tuple(f"{number(value)} px" for value in lengths.ravel().tolist())
    note = f"{number(lens.pixels.rmse)} px rms, at most {number(lens.pixels.max)}"
    if lens.angle > 0:
        note += f"; without a rotation of {number(lens.angle)} degrees"
    note += f"; lines {factor:g} times as long" if lens.pixels.max > 0 else ""
    return over_image(
        lens.box,
        f"lens_difference_{lens.camera_a}_{lens.camera_b}",
        f"Camera {lens.camera_a} of A, camera {lens.camera_b} of B",
        Cells(lengths, top, "px", titles),
        Vectors(at[known], factor * lens.field[known]),
        note=note,
    )
