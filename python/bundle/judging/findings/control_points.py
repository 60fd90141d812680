r"""Control points that contradict each other: wrong points, or sigmas that are too small.

If most points fail their test after a solve, no single one is wrong: the sigmas are. The command
sets new ones from the errors: the median of their squares, horizontal and vertical, divided by that
of the chi-squared distribution. A gross error does not enlarge them, and the next run names it. The
model bends to points with small sigmas, so that the error of a point left out may be small where
its residual is not, and the reverse: the larger one is used. If few points fail, a robust loss
removes their influence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.georeference.alignment_result import ControlPointError, is_contradiction
from bundle.georeference.control_point import parse_sigma
from bundle.interface.finding import Finding
from bundle.interface.georeference_options import GCP_SIGMA
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import GROUPS

FLAG = "--gcp-sigma"


def control_points(points: Sequence[ControlPointError], command: NextCommand) -> Finding | None:
    """Return the finding about control points that fail their test after a solve, or None."""
    used = [point for point in points if point.role == "control"]
    wrong = [point for point in used if point.suspect]
    if not wrong:
        return None
    names = [point.name for point in wrong]
    evidence: dict[str, Any] = {"num_points": len(used), "names": names}
    if not is_contradiction(points):
        if command.value("--prior-loss", "trivial") != "trivial":
            return None
        errors = [math.hypot(*np.nan_to_num(point.leave_one_out)) for point in wrong]
        worst = int(np.argmax(errors))
        those = "which contradicts" if len(wrong) == 1 else "which contradict"
        return Finding(
            kind="control_points",
            sentence=f"A robust loss removes the influence of {len(wrong)} of "
            f"{plural(len(used), 'control point')}, {those} the others ({shown(names[worst])} by "
            f"{number(errors[worst])} m).",
            command=command.refine("--prior-loss", "cauchy"),
            evidence=evidence,
        )
    shown_by_errors = [_sigma(used, axes, typical) for axes, typical, _ in GROUPS]
    better = [one for one in shown_by_errors if not math.isnan(one)]
    sigmas = np.array([[point.sigma[axis] for axis in (0, 2)] for point in used])
    given = parse_sigma(FLAG, command.value(FLAG, GCP_SIGMA))
    differs = np.abs(sigmas - [given.horizontal, given.vertical]) > 1e-9 * sigmas
    is_of_flag = not differs.any()  # an unknown height differs from nothing
    text = "/".join(f"{one:.2g}" for one in better)
    return Finding(
        kind="control_points",
        sentence="Sigmas of control points are too small: their errors suggest "
        f"{text} m. Use these sigmas{'' if is_of_flag else ' in the file'}.",
        command=command.refine(FLAG, text) if is_of_flag else "",
        evidence=evidence | {"sigmas": better},
    )


def _sigma(points: Sequence[ControlPointError], axes: slice, typical: float) -> float:
    """Estimate the sigma [m] of these axes from the larger errors; NaN if unknown."""
    errors = np.array([(point.residual, point.leave_one_out) for point in points])
    squares = (errors[..., axes] ** 2).sum(axis=2).max(axis=1)
    known = squares[~np.isnan(squares)]
    return math.sqrt(float(np.median(known)) / typical) if len(known) else math.nan
