"""Why a solve ended, in plain words."""

from __future__ import annotations

from bundle.base.words import plural
from bundle.interface.summary import Summary

__all__ = ["sentence"]

# How Ceres' messages begin (trust_region_minimizer.cc, solver.cc), the same from 1.14 to 2.2.
_REASONS = {
    "Function tolerance reached. No non-constant": "every parameter is held fixed",
    "Function tolerance reached": (
        "another step would change the cost by no more than the function tolerance"
    ),
    "Gradient tolerance reached": "no entry of the gradient exceeds the gradient tolerance",
    "Parameter tolerance reached": (
        "another step would change the parameters by no more than the parameter tolerance"
    ),
    "Minimum trust region radius reached": (
        "the trust region shrank to nothing, no step lowers the cost any further"
    ),
    "Maximum number of iterations reached": (
        "the limit of iterations came first; what was reached is kept"
    ),
    "Maximum solver time reached": "the limit of time came first; what was reached is kept",
    "Number of consecutive invalid steps": (
        "several steps in a row had no finite cost or did not solve the linear system"
    ),
    "Linear solver failed": "the linear solver gave up for a reason other than numerics",
    "Initial residual and Jacobian evaluation failed": (
        "the cost or its derivatives are not finite at the start"
    ),
    "Residual and Jacobian evaluation failed": ("the cost or its derivatives ceased to be finite"),
}
_VERDICTS = {"CONVERGENCE": "Converged", "NO_CONVERGENCE": "Not converged", "FAILURE": "Failed"}


def sentence(summary: Summary, num_steps: int, num_rejected: int = 0) -> str:
    """Return how a solve of `num_steps` steps ended, `num_rejected` of them not accepted."""
    after = f"after {plural(num_steps, 'step')}"
    if num_rejected:
        after += f" ({num_rejected} rejected)"
    if summary.interrupted:
        return f"Interrupted {after}; the best state so far is kept."
    verdict = _VERDICTS.get(summary.termination_type, "Ended")
    for beginning, reason in _REASONS.items():
        if summary.message.startswith(beginning):
            return f"{verdict} {after}: {reason}."
    return f"{verdict} {after}: {' '.join(summary.message.split()) or summary.termination_type}"
