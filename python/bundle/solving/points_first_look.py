"""Alarm of a solve of a model that eliminates the cameras first.

The points' system after eliminating the cameras couples all points of an image. The 3 k coordinates
of the k points of an image form a clique, whose elimination needs the sum of c^2 + 3 c for c below
3 k in every order, about (3 k)^3 / 3. Ceres does not count the flops of this system: the bound of
the largest image replaces them. The other order, points first, is counted exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.interface.options import SolveOptions
from bundle.interface.ordering_alarm import BestOrder, with_ordering_alarm
from bundle.model.problem import Problem

ADVICE = "Leave --ordering (linear_solver_ordering) at points-first."


def with_model_alarm(
    summary: Mapping[str, Any], problem: Problem, options: SolveOptions
) -> dict[str, Any]:
    """Return the fields of a summary, with a warning if points first is far cheaper."""
    is_asked = options.linear_solver_ordering == "cameras_first" and "points" in options.refine
    direct = ("DENSE_SCHUR", "SPARSE_SCHUR", "SPARSE_NORMAL_CHOLESKY")
    is_direct = summary["linear_solver_type_used"] in direct
    look = (lambda: _look(summary, problem, options)) if is_asked and is_direct else None
    return with_ordering_alarm(
        summary,
        lambda: (problem.observation_image, problem.observation_point),
        look,
        ADVICE if look is not None else "",
    )


def _look(summary: Mapping[str, Any], problem: Problem, options: SolveOptions) -> BestOrder:
    points_first = options.replace(linear_solver_ordering="points_first").asdict()
    if summary["linear_solver_type_used"] == "SPARSE_NORMAL_CHOLESKY":
        pattern, order, _ = _core.ordered_full_pattern(
            problem, points_first, _core.MOST_ENTRIES_FOR_AMD
        )
    else:
        pattern = _core.reduced_pattern(problem, points_first)
        order = _core.order_blocks(*pattern, "amd")
    counts = _core.count_factor(*pattern, order)
    return BestOrder(
        ordering="points first, amd",
        flops=counts["flops"],
        nonzeros=counts["entries"],
        used_flops=0.0 if summary["factor_flops"] else _least_flops(problem, options),
    )


def _least_flops(problem: Problem, options: SolveOptions) -> float:
    """Return the flops of the clique of the image with most free points."""
    free = ~np.isin(problem.point_ids, np.array(options.fixed_point_ids, np.int64))
    seen = problem.observation_image[free[problem.observation_point]]
    if not len(seen):
        return 0.0
    c = 3.0 * float(np.bincount(seen).max()) - 1
    return c * (c + 1) * (2 * c + 1) / 6 + 1.5 * c * (c + 1)
