"""Method that an inspection recommends, and the reason in a sentence."""

from __future__ import annotations

from collections.abc import Sequence

from bundle.base.memory_sizes import format_size
from bundle.planning.inspection.inspection_result import MethodInspection


def recommend(methods: Sequence[MethodInspection]) -> int:
    """Return the index of the fastest method that is available and fits; -1 if none fits."""
    usable = [i for i, method in enumerate(methods) if method.is_taken and method.fits_in_memory]
    return min(usable, key=lambda i: methods[i].time_per_step_in_seconds, default=-1)


def explain(methods: Sequence[MethodInspection], best: int, density: float) -> str:
    """Return the recommendation and its reason as a sentence; ``density`` is that of S."""
    if best < 0:
        least = min(methods, key=lambda method: method.memory_in_bytes)
        return (
            f"No method fits into the free memory; {least.name} needs the least, "
            f"{format_size(least.memory_in_bytes)}."
        )
    chosen = methods[best]
    reasons = [f"S is {_two_digits(100 * density)} % full"]
    if chosen.ordering:
        order = (
            ""
            if chosen.linear_solver_type == "DENSE_SCHUR"
            else f"the {chosen.ordering} order needs "
        )
        reasons.append(f"{order}{chosen.flops:.2g} flops per step")
    else:
        reasons.append("no factorisation")
    rival = _rival(methods, chosen)
    if rival is not None:
        reasons.append(_against(rival, chosen))
    return f"{chosen.linear_solver_type}: {', '.join(reasons)}."


def _rival(
    methods: Sequence[MethodInspection], chosen: MethodInspection
) -> MethodInspection | None:
    """Return the best method with another linear solver, of the same backend if possible."""
    others = [
        method
        for method in methods
        if method.is_taken
        and method.linear_solver_type != chosen.linear_solver_type
        and method.backend == chosen.backend
    ]
    direct = [method for method in others if method.nnz_factor > 0]
    return min(direct or others, key=lambda m: m.time_per_step_in_seconds, default=None)


def _against(rival: MethodInspection, chosen: MethodInspection) -> str:
    name = rival.linear_solver_type
    if not rival.fits_in_memory:
        return f"{name} needs {format_size(rival.memory_in_bytes)}, more than the free memory"
    times = rival.time_per_step_in_seconds / chosen.time_per_step_in_seconds
    if chosen.flops and rival.flops > chosen.flops:
        more = rival.flops / chosen.flops
        return f"{name} needs {_two_digits(more)} times the flops and takes {_as_long(times)}"
    return f"{name} takes {_as_long(times)}"


def _as_long(times: float) -> str:
    return "as long" if times < 1.05 else f"{_two_digits(times)} times as long"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
