"""Solves that rank 0 runs alone while the other ranks wait, and the reasons.

The fused backend divides points among ranks. A solve by Ceres is not divided. A solve that needs
points of several ranks at once is not divided either: three points that fix the gauge, or a factor
of several points.
"""

from __future__ import annotations

from typing import Any

import bundle._core as _core

_OPEN = ("gauge", "cheirality")
"""Options that depend on the problem and have no effect on the division among ranks."""


def reason_in_options(options: dict[str, Any]) -> str:
    """Return why no solve with these options can be divided; "" if it can."""
    if options["gauge"] == "three_points":
        return "The three points that fix the gauge may be in different parts (gauge)."
    return _core.reason_for_ceres(options | {name: _core.default_options()[name] for name in _OPEN})


def reason_to_be_alone(options: dict[str, Any], core_factors: Any) -> str:
    """Return why a solve cannot be divided; "" if it can.

    Args:
        core_factors: variables, factors and places in the form of ``_core.solve``; None without
            factors.
    """
    reason = reason_in_options(options)
    if reason or core_factors is None:
        return reason
    _, factors, places = core_factors
    for factor in factors:
        kinds = [places[variable][0] for variable in factor[2]]
        if "point" in kinds and len(kinds) > 1:
            return f"{factor[1]} couples a point with another variable (factors)."
    return ""


def warning(reason: str, num_ranks: int) -> str:
    """Return the warning that the other ranks waited."""
    others = "the other one" if num_ranks == 2 else f"the other {num_ranks - 1}"
    return f"One process solved, and {others} waited. {reason}"
