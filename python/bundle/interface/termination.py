"""Explanation of the termination of a solve in plain words."""

from __future__ import annotations

import re

from bundle.base.words import plural
from bundle.interface.summary import Summary

# First words of Ceres' messages (trust_region_minimizer.cc, solver.cc), identical in versions 1.14
# to 2.2. "{limit}" is the tolerance at the end of the message.
_REASONS = {
    "Function tolerance reached. No non-constant": ": all parameters are constant",
    "Function tolerance reached": " (relative cost change below {limit})",
    "Gradient tolerance reached": " (largest entry of the gradient below {limit})",
    "Parameter tolerance reached": " (relative parameter change below {limit})",
    "Minimum trust region radius reached": (
        ": no step lowers the cost (minimum trust region radius reached)"
    ),
    "Maximum number of iterations reached": ": iteration limit reached. The best state is kept",
    "Maximum solver time reached": ": time limit reached. The best state is kept",
    "Number of consecutive invalid steps": (
        ": consecutive steps had no finite cost, or their linear system was not solved"
    ),
    "Linear solver failed": ": fatal error of the linear solver",
    "Initial residual and Jacobian evaluation failed": (
        ": cost or Jacobian not finite at the start"
    ),
    "Residual and Jacobian evaluation failed": ": cost or Jacobian no longer finite",
}
_VERDICTS = {
    "CONVERGENCE": "Converged in",
    "NO_CONVERGENCE": "Not converged after",
    "FAILURE": "Failed after",
}


def short_outcome(summary: Summary, done: str) -> str:
    """Return the outcome as "Not converged after 5 steps (time limit reached)".

    `done` is the work done, such as "5 steps". A tolerance that was reached is not named.
    """
    if summary.interrupted:
        return f"Interrupted after {done}"
    verdict = f"{_verdict(summary)} {done}"
    for beginning, reason in _REASONS.items():
        if summary.message.startswith(beginning):
            why = reason.partition(": ")[2].removesuffix(". The best state is kept")
            return f"{verdict} ({why})" if why else verdict
    return verdict


def sentence(summary: Summary, num_steps: int, num_rejected: int = 0) -> str:
    """Return a sentence on the termination of a solve.

    `num_rejected` of its `num_steps` steps were not accepted.
    """
    steps = plural(num_steps, "step")
    if num_rejected:
        steps += f", {num_rejected} rejected"
    if summary.interrupted:
        return f"Interrupted after {steps}. The best state is kept."
    verdict = f"{_verdict(summary)} {steps}"
    for beginning, reason in _REASONS.items():
        if summary.message.startswith(beginning):
            return f"{verdict}{reason.format(limit=_limit(summary.message))}."
    return f"{verdict}: {' '.join(summary.message.split()) or summary.termination_type}"


def _verdict(summary: Summary) -> str:
    """Return the first words; a solve whose result is no solution has not converged to one."""
    if summary.termination_type == "CONVERGENCE" and not summary.is_solution_usable:
        return "Ended after"
    return _VERDICTS.get(summary.termination_type, "Ended after")


def _limit(message: str) -> str:
    """Return the tolerance in a message such as "... 3.4e-07 <= 1.0e-06": "1e-6"."""
    found = re.search(r"<= ([-+.\de]+)", message)
    if found is None:
        return "its tolerance"
    text = f"{float(found[1].rstrip('.')):g}"
    return re.sub(r"e([-+])0?", lambda sign: "e-" if sign[1] == "-" else "e", text)
