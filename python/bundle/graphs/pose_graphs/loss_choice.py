"""Which loss a pose graph needs: ``auto`` tries what finds wrong closures and compares.

No loss finds every set of wrong closures: dynamic covariance scaling stays in local minima where
graduated non-convexity does not, and the other way round. Both aim at the same, poses that most
closures agree with, which the truncated cost measures whatever the loss was:

    1/2 sum over trusted edges x + 1/2 sum over doubted edges min(x, c^2),    x = r^T Omega r,

with c^2 the 99.95 % quantile of chi2 times the square of the scale. A solve without a loss comes
first, and stands where it leaves nothing to be doubted: every closure below c^2, no more chi2 than
its degrees of freedom allow, and no closure whose error other edges have taken over
(``truncated_search``). Else the solution of the least truncated cost is taken. Graduated
non-convexity also looks at the closures that dynamic covariance scaling leaves in, and at the
largest set of closures that agree with each other (``consistency``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.base.words import number
from bundle.interface.pose_graph_options import PoseGraphOptions

__all__ = ["TRIED", "choose_loss", "loss_cost", "truncated_cost"]

TRIED = ("dcs", "gnc_tls")
"""Losses for wrong closures that ``auto`` tries."""

Solve = Callable[[PoseGraphOptions], dict[str, Any]]


def truncated_cost(
    chi2: NDArray[np.float64], doubted: NDArray[np.bool_], c_squared: float
) -> float:
    """Return 1/2 sum of chi2, of doubted edges at most c^2."""
    return 0.5 * float(np.where(doubted, np.minimum(chi2, c_squared), chi2).sum())


def loss_cost(
    chi2: NDArray[np.float64],
    doubted: NDArray[np.bool_],
    options: PoseGraphOptions,
    c_squared: float,
) -> float:
    """Return 1/2 sum of rho of chi2 (m,), with the loss of the options on doubted edges."""
    if options.loss == "trivial":
        return 0.5 * float(chi2.sum())
    if options.loss == "gnc_tls":
        return truncated_cost(chi2, doubted, c_squared)
    rho = np.array(chi2)
    for edge in np.flatnonzero(doubted).tolist():
        rho[edge] = _core.edge_loss(options.loss, options.loss_scale, float(chi2[edge]))[0]
    return 0.5 * float(rho.sum())


def choose_loss(
    solve: Solve,
    doubted: NDArray[np.bool_],
    options: PoseGraphOptions,
    c_squared: float,
    doubts: Callable[[dict[str, Any]], str],
) -> tuple[PoseGraphOptions, dict[str, Any], str]:
    """Solve without a loss, then with those that are tried, as far as that is needed.

    Args:
        solve: with some options, from one start; what it returns has "chi2_after" and "summary".
        doubted: (m,) edges that the loss may take weight from.
        options: with loss "auto".
        c_squared: of the truncated cost.
        doubts: what is to be doubted of what the solve without a loss returned, as words that
            follow "without a loss"; "" for nothing.

    Returns:
        Options with the loss that was taken, what its solve returned, and why, in a sentence.
    """
    plain = options.replace(loss="trivial", loss_scale=1.0, loss_on="closures")
    output = solve(plain)
    if output["summary"]["interrupted"]:
        return plain, output, "No loss: stopped before one was tried."
    doubt = doubts(output)
    if not doubt:
        reason = f"No loss: without one all closures have a chi2 of at most {number(c_squared)}."
        return plain, output, reason
    tried = [(plain, output)]
    for loss in TRIED:
        chosen = options.replace(loss=loss)
        tried.append((chosen, solve(chosen)))
        if tried[-1][1]["summary"]["interrupted"]:
            break
    costs = [truncated_cost(found["chi2_after"], doubted, c_squared) for _, found in tried]
    best = int(np.argmin(costs))
    words = ", ".join(
        f"{number(cost)} by {_name(options)}"
        for cost, (options, _) in zip(costs, tried, strict=True)
    )
    reason = (
        f"{_name(tried[best][0])}: without a loss {doubt}, and its truncated cost is "
        f"the least ({words})."
    )
    return (*tried[best], reason)


def _name(options: PoseGraphOptions) -> str:
    return "no loss" if options.loss == "trivial" else options.loss.replace("_", "-")
