"""Figures of a check of Jacobians: differences of an entry against the step size."""

from __future__ import annotations

import numpy as np

from bundle.checking.step_curve import StepCurve
from bundle.figures.axes import logarithmic
from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Line

SMALLEST = 1e-16
"""Smallest error drawn; a difference may equal the Jacobian to the last digit."""


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
    lines = [
        Line("to your Jacobian", steps, to_given, colour=1 if curve.is_wrong else 0),
        *(
            [Line("to the reference", steps, to_reference, colour=0, dash=1)]
            if curve.is_wrong
            else []
        ),
        Line("tolerance", ends, np.full(2, tolerance), colour=GREY, dash=1),
    ]
    floor = f" Floor: the error, {error:.1e}." if curve.is_wrong else ""
    return Figure(
        name="step_curve",
        title=f"{curve.parameter}, row {curve.residual}: {'wrong' if curve.is_wrong else 'right'}",
        x=logarithmic(ends, "step size h"),
        y=logarithmic([*to_given, *to_reference, tolerance, 1.0], "relative distance of D(h)"),
        marks=tuple(lines),
        note=f"{curve.place[:1].upper()}{curve.place[1:]}: {curve.analytic:.6g}, should be "
        f"{curve.reference:.6g}.{floor}"
        if curve.is_wrong
        else f"{curve.place[:1].upper()}{curve.place[1:]}: {curve.analytic:.6g}.",
    )


def _relative(distance: np.ndarray, curve: StepCurve) -> np.ndarray:
    relative: np.ndarray = np.maximum(np.abs(distance) / curve.scale, SMALLEST)
    return relative
