"""Solves that rank 0 does alone while the others wait, and the reasons.

The fused backend divides points. A solve by Ceres is not divided, nor one that needs points of
several ranks at once: three points that hold the gauge, a factor of several points.
"""

from __future__ import annotations

from typing import Any

from bundle import _core

__all__ = ["reason_in_options", "reason_to_be_alone", "warning"]

_OPEN = ("gauge", "cheirality")
"""Options that depend on the problem, and do not decide who solves."""


def reason_in_options(options: dict[str, Any]) -> str:
    """Return why no solve with these options can be divided; "" if it can."""
    if options["gauge"] == "three_points":
        return "Three points, which may be in different parts, hold the gauge (gauge)."
    return _core.reason_for_ceres(options | {name: _core.default_options()[name] for name in _OPEN})


def reason_to_be_alone(options: dict[str, Any], core_factors: Any) -> str:
    """Return why a solve cannot be divided; "" if it can.

    Args:
        options: resolved.
        core_factors: variables, factors and places, as ``_core.solve`` takes them; None: none.
    """
    reason = reason_in_options(options)
    if reason or core_factors is None:
        return reason
    _, factors, places = core_factors
    for factor in factors:
        kinds = [places[variable][0] for variable in factor[2]]
        if "point" in kinds and len(kinds) > 1:
            return f"{factor[1]} joins a point and something else (factors)."
    return ""


def warning(reason: str, num_ranks: int) -> str:
    """Return the warning that the others waited."""
    others = "the other one" if num_ranks == 2 else f"the other {num_ranks - 1}"
    return f"One process solved, and {others} waited. {reason}"
