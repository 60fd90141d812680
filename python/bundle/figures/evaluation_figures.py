"""Figures of evaluations, of validations and of checks of Jacobians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number
from bundle.checking.step_curve import StepCurve
from bundle.figures.marks import (
    GREY,
    Array,
    Cells,
    Dots,
    Figure,
    Line,
    Mark,
    Vectors,
    linear,
    logarithmic,
    over_image,
    round_down,
    square,
)
from bundle.judging.evaluation.evaluation_result import Evaluation
from bundle.judging.evaluation.lens_difference import LensDifference
from bundle.judging.validation.validation_result import ValidatedCandidate, Validation
from bundle.model.pose_table import ErrorStatistics

MOST_DOTS = 2000
"""Number of poses that a figure draws, in addition to those with the largest errors."""

LONGEST = 0.15  # drawn length of the largest error, relative to the height of the figure


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
    drawn, figures = _drawn(found), []
    for name, title, y_label, y in rows:
        shown = drawn[np.isfinite(y[drawn])]
        names = tuple(found.association.names[row] for row in shown.tolist())
        rms = ErrorStatistics.of(y[np.isfinite(y)]).rmse
        ends, level = x[[0, -1]], np.full(2, rms)
        limit = Line(f"rms {number(rms)}", ends, level, is_limit=True, colour=GREY, dash=1)
        dots = Dots(np.column_stack([x, y])[shown], (), names)
        y_axis = linear([0.0, *(1.05 * y[shown]).tolist()], y_label)
        figures.append(
            Figure(name=name, title=title, x=linear(x, label), y=y_axis, marks=(dots, limit))
        )
    return figures


def _drawn(found: Evaluation) -> NDArray[np.int64]:
    """Return evenly spaced poses, and those with the largest position errors."""
    count = found.num_shared
    even = np.linspace(0, count - 1, min(count, MOST_DOTS)).round().astype(np.int64)
    worst = np.argsort(-found.position_errors, kind="stable")[: MOST_DOTS // 20]
    return np.union1d(even, worst)


def paths_figure(found: Evaluation) -> Figure:
    """Return the centres of A and B, seen along the direction in which B extends least."""
    middle = found.reference.mean(axis=0)
    axes = np.linalg.svd(found.reference - middle, full_matrices=False)[2][:2]
    there, here = ((points - middle) @ axes.T for points in (found.reference, found.estimate))
    step = there - here
    both = np.vstack([there, here])
    low, high = both.min(axis=0), both.max(axis=0)
    unit = found.unit if found.unit == "m" else "units of B"
    x, y = square(low, high, (f"first axis [{unit}]", f"second axis [{unit}]"), 0.1)
    reach = (y.high - y.low) / 2
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


MOST_CURVES = 4  # number of candidates in the distribution of errors


def error_figure(found: Validation) -> Figure:
    """Return fitted and held-out error against the number of lens parameters, by sharing."""
    marks: list[Mark] = []
    values: list[float] = []
    counts: list[float] = []
    loss = found.candidates[found.recommended].loss
    chosen = [one for one in found.candidates if one.loss == loss and not one.error]
    for colour, share in enumerate(dict.fromkeys(one.share for one in chosen)):
        rows = sorted((one for one in chosen if one.share == share), key=_size)
        x = np.array([max(_size(one), 1) for one in rows], float)
        kinds = {"held out": "held_out_rmse", "fitted": "fitted_clipped_rmse"}
        for dash, (name, kind) in enumerate(kinds.items()):
            y = np.array([getattr(one, kind) for one in rows])
            marks.append(Line(f"{rows[0].sharing}, {name}", x, y, colour=colour, dash=dash))
            values += y[np.isfinite(y)].tolist()
        counts += x.tolist()
    names = tuple(_label(one) for one in chosen)
    at = np.array([(max(_size(one), 1), one.held_out_rmse) for one in chosen], float).reshape(-1, 2)
    marks.append(Dots(at, (GREY,) * len(chosen), names=names))
    return Figure(
        name="held_out_error",
        title="Error against the number of lens parameters",
        x=logarithmic(counts, "free lens parameters"),
        y=linear(values, f"RMSE, errors at most {found.clip:g} px [px]", low=None),
        marks=tuple(marks),
        note="The fitted error falls with every parameter. The held-out error tells which "
        "parameters predict.",
    )


def difference_figure(found: Validation) -> Figure:
    """Return the difference of each candidate to the best, with its standard errors that decide."""
    order = [k for k in np.argsort(found.decision.scores) if not found.candidates[k].error]
    place = np.arange(1.0, len(order) + 1)
    y = found.decision.differences[order]
    num_errors = found.decision.num_standard_errors
    spread = num_errors * found.decision.standard_errors[order]
    limit = found.rule.threshold * found.decision.scores[found.best]
    ends = np.array([0.5, len(order) + 0.5])
    words = f"{100 * found.rule.threshold:g} % of the best"
    names = tuple(_label(found.candidates[k]) for k in order)
    colours = tuple(int(k == found.recommended) for k in order)
    return Figure(
        name="difference",
        title=f"Difference to the best, with {num_errors:.1f} standard errors",
        x=linear([0.0, len(order) + 1.0], "rank of the candidate"),
        y=linear([*(y - spread), *(y + spread), limit], "difference [sigma]", low=None),
        marks=(
            Line("candidates", place, y, is_dotted=True, error=spread),
            Line(words, ends, np.full(2, limit), colour=GREY, dash=1),
            Dots(np.column_stack([place, y]), colours, names, is_labelled=len(order) <= 12),
        ),
    )


def distribution_figure(found: Validation) -> Figure:
    """Return the share of predictions beyond an error, for a few candidates."""
    marks = []
    grid = np.linspace(0.0, 2 * found.clip, 161)
    for colour, k in enumerate(_few(found)):
        errors = np.where(np.isfinite(found.errors[k]), found.errors[k], np.inf)
        beyond = 1.0 - np.searchsorted(np.sort(errors), grid) / max(len(errors), 1)
        marks.append(
            Line(_label(found.candidates[k]), grid, np.maximum(beyond, 1e-5), colour=colour)
        )
    lowest = min((float(mark.y[mark.y > 1e-5].min(initial=1.0)) for mark in marks), default=0.1)
    return Figure(
        name="distribution",
        title="Predictions beyond an error",
        x=linear([0.0, 2 * found.clip], "error [px]"),
        y=logarithmic([lowest, 1.0], "share of the predictions"),
        marks=tuple(marks),
    )


def image_figure(found: Validation) -> Figure:
    """Return the held-out error of each image, recommended against the input's or the next best."""
    first, second = found.recommended, _other(found)
    count = int(found.image.max(initial=0)) + 1
    clipped = np.minimum(np.where(np.isfinite(found.errors), found.errors, found.clip), found.clip)
    seen = np.bincount(found.image, minlength=count)
    pair = [
        np.sqrt(np.bincount(found.image, clipped[k] ** 2, count)[seen > 0] / seen[seen > 0])
        for k in (first, second)
    ]
    reach = [0.0, float(np.max(pair, initial=0.1))]
    names = [_label(found.candidates[k]) for k in (first, second)]
    return Figure(
        name="images",
        title="Held-out error by image",
        x=linear(reach, f"{names[0]} [px]"),
        y=linear(reach, f"{names[1]} [px]"),
        marks=(
            Line("equal", np.array(reach), np.array(reach), colour=GREY, dash=1),
            Dots(np.column_stack(pair)),
        ),
        note="Below the line, the other candidate predicts the image better.",
    )


def _label(one: ValidatedCandidate) -> str:
    return f"{one.lens}, {one.sharing}"


def _size(one: ValidatedCandidate) -> int:
    return one.num_intrinsics


def _few(found: Validation) -> Sequence[int]:
    """Return the recommended, the input's and the best candidates."""
    ranked = [int(k) for k in np.argsort(found.decision.scores) if not found.candidates[k].error]
    wanted = [found.recommended, *([found.present] if found.present >= 0 else []), *ranked]
    usable = [k for k in dict.fromkeys(wanted) if not found.candidates[k].error]
    return usable[:MOST_CURVES]


def _other(found: Validation) -> int:
    """Return the candidate to compare with the recommended one."""
    if found.present not in (-1, found.recommended) and not found.candidates[found.present].error:
        return found.present
    return next((k for k in _few(found) if k != found.recommended), found.recommended)


SMALLEST = 1e-16  # smallest error drawn; a difference may equal the Jacobian to the last digit


def step_figure(curve: StepCurve, tolerance: float) -> Figure:
    """Return the distance of central differences from the Jacobian and from the reference.

    Truncation falls with the step size h as h^2, rounding grows as 1/h: a right Jacobian has a V. A
    wrong one has a floor at its error, and only the reference has a V.
    """
    finite = np.isfinite(curve.differences)
    steps, differences = curve.steps[finite], curve.differences[finite]
    to_given = _relative(differences - curve.analytic, curve)
    to_reference = _relative(differences - curve.reference, curve)
    error = abs(curve.analytic - curve.reference) / curve.scale
    ends = np.array([steps.min(), steps.max()]) if len(steps) else np.array([1e-16, 1.0])
    lines = [Line("to your Jacobian", steps, to_given, colour=1 if curve.is_wrong else 0)]
    note = f"{curve.place[:1].upper()}{curve.place[1:]}: {curve.analytic:.6g}"
    if curve.is_wrong:
        lines.append(Line("to the reference", steps, to_reference, colour=0, dash=1))
        note += f", should be {curve.reference:.6g}. Floor: the error, {error:.1e}"
    lines.append(Line("tolerance", ends, np.full(2, tolerance), colour=GREY, dash=1))
    return Figure(
        name="step_curve",
        title=f"{curve.parameter}, row {curve.residual}: {'wrong' if curve.is_wrong else 'right'}",
        x=logarithmic(ends, "step size h"),
        y=logarithmic([*to_given, *to_reference, tolerance, 1.0], "relative distance of D(h)"),
        marks=tuple(lines),
        note=f"{note}.",
    )


def _relative(distance: np.ndarray, curve: StepCurve) -> np.ndarray:
    relative: np.ndarray = np.maximum(np.abs(distance) / curve.scale, SMALLEST)
    return relative
