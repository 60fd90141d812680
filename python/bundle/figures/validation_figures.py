"""Figures of a validation: errors against parameters, differences, and errors by image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bundle.figures.axes import linear, logarithmic
from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Array, Dots, Line, Mark
from bundle.judging.validation.validation_result import ValidatedCandidate, Validation

MOST_CURVES = 4
"""Number of candidates in the distribution of errors."""


def error_figure(found: Validation) -> Figure:
    """Return fitted and held-out error against the number of lens parameters, by sharing."""
    marks: list[Mark] = []
    values: list[float] = []
    counts: list[float] = []
    chosen = [one for one in found.candidates if one.loss == _loss(found) and not one.error]
    for colour, share in enumerate(dict.fromkeys(one.share for one in chosen)):
        rows = sorted((one for one in chosen if one.share == share), key=_size)
        x = np.array([max(_size(one), 1) for one in rows], float)
        for dash, (name, kind) in enumerate(
            (("held out", "held_out_rmse"), ("fitted", "fitted_clipped_rmse"))
        ):
            y = np.array([getattr(one, kind) for one in rows])
            marks.append(
                Line(
                    f"{rows[0].sharing}, {name}",
                    x,
                    y,
                    colour=colour,
                    dash=dash,
                )
            )
            values += y[np.isfinite(y)].tolist()
        counts += x.tolist()
    names = tuple(_label(one) for one in chosen)
    marks.append(Dots(_points(chosen), (GREY,) * len(chosen), names=names))
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
    """Return the difference of each candidate to the best, with two standard errors."""
    order = [k for k in np.argsort(found.decision.scores) if not found.candidates[k].error]
    place = np.arange(1.0, len(order) + 1)
    y = found.decision.differences[order]
    spread = 2 * found.decision.standard_errors[order]
    limit = found.rule.threshold * found.decision.scores[found.best]
    ends = np.array([0.5, len(order) + 0.5])
    return Figure(
        name="difference",
        title="Difference to the best, with two standard errors",
        x=linear([0.0, len(order) + 1.0], "rank of the candidate"),
        y=linear([*(y - spread), *(y + spread), limit], "difference [sigma]", low=None),
        marks=(
            Line("candidates", place, y, is_dotted=True, error=spread),
            Line(
                f"{100 * found.rule.threshold:g} % of the best",
                ends,
                np.full(2, limit),
                colour=GREY,
                dash=1,
            ),
            Dots(
                np.column_stack([place, y]),
                tuple(int(k == found.recommended) for k in order),
                names=tuple(_label(found.candidates[k]) for k in order),
                is_labelled=len(order) <= 12,
            ),
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
    """Return the short name of a candidate."""
    return f"{one.lens}, {one.sharing}"


def _points(chosen: Sequence[ValidatedCandidate]) -> Array:
    rows = [(max(_size(one), 1), one.held_out_rmse) for one in chosen]
    return np.array(rows, float).reshape(-1, 2)


def _loss(found: Validation) -> str:
    return found.candidates[found.recommended].loss


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
