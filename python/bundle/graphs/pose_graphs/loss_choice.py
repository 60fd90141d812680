"""Choice of a pose graph's loss: ``auto`` tries losses for wrong closures and compares them.

No loss finds every set of wrong closures: dynamic covariance scaling (DCS) ends in local minima
that graduated non-convexity (GNC) avoids, and vice versa. Both search for poses with which most
closures agree. The truncated cost measures this agreement independently of the loss:

    1/2 sum over trusted edges x + 1/2 sum over doubted edges min(x, c^2),    x = r^T Omega r,

with c^2 the 99.95 % quantile of chi2 multiplied by the square of the scale. A solve without a loss
comes first. It is kept if it gives no reason for doubt: every closure is below c^2, chi2 does not
exceed its degrees of freedom, and no closure has shifted its error to other edges
(``truncated_search``). Otherwise the solution with the smallest truncated cost is used. GNC also
tries the set of closures that DCS keeps, and the largest set of consistent closures
(``consistency``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.words import number
from bundle.interface.pose_graph_options import PoseGraphOptions

TRIED = ("dcs", "gnc_tls")
"""Losses for wrong closures that ``auto`` tries."""

Solve = Callable[[PoseGraphOptions], dict[str, Any]]


def truncated_cost(
    chi2: NDArray[np.float64], doubted: NDArray[np.bool_], c_squared: float
) -> float:
    """Return 1/2 sum of chi2, limited to c^2 for doubted edges."""
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
    """Solve without a loss, then with the losses to try if necessary.

    Args:
        solve: function from options to a solve from a common start; its output has "chi2_after" and
            "summary".
        doubted: (m,) edges to which the loss applies.
        options: options with loss "auto".
        c_squared: limit of the truncated cost.
        doubts: function from the output of the solve without a loss to the reason to doubt
            it, in words that continue the phrase "without a loss"; "" if there is no doubt.

    Returns:
        Options with the chosen loss, the output of its solve, and the reason in a sentence.
    """
    plain = options.replace(loss="trivial", loss_scale=1.0, loss_on="closures")
    output = solve(plain)
    if output["summary"]["interrupted"]:
        return plain, output, "No loss: stopped before another was tried."
    doubt = doubts(output)
    if not doubt:
        reason = f"No loss: without one, all closures have a chi2 of at most {number(c_squared)}."
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
        f"{_name(tried[best][0])}: without a loss, {doubt}; its truncated cost is the "
        f"least ({words})."
    )
    return (*tried[best], reason)


def _name(options: PoseGraphOptions) -> str:
    return "no loss" if options.loss == "trivial" else options.loss.replace("_", "-")
