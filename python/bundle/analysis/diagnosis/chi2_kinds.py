"""chi2 of a solved graph against its expectation, by kind of edge or of factor.

At the minimum, the whitened errors are r = (I - H) e with e of unit covariance and H the projection
onto the columns of the Jacobian. The sum of squares of some rows has the mean sum (1 - h_kk). This
redundancy of the rows is their degrees of freedom: all redundancies add up to the number of
equations minus the number of unknowns. The variance is at most twice the mean, as that of a
chi-square distribution with these degrees. The interval is therefore wide enough.

Information that is s times too small makes chi2 s times too small, because chi2 is linear in it.
Wrong edges raise chi2, too, and smear over the edges near them. The median over the edges of the
test statistics, each with a chi-square distribution of its own, separates the two causes:
information that is too large scales median and mean alike, wrong edges raise the mean far more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.normal_equations import NormalEquations, PoseEquations
from bundle.base.arrays import check_type
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.tails import chi2_interval, chi2_median
from bundle.base.words import number
from bundle.errors import InputError, brief
from bundle.graphs.pose_graphs.edge_weights import WeightedGraph, is_graph, weighted_graph

if TYPE_CHECKING:
    from bundle.graphs.factors.factor_graph import FactorGraph

Floats = NDArray[np.float64]

LEAST_DEGREES = 10.0  # degrees of freedom below which a kind has no verdict
WORTH_MENTION = 1.2  # smallest factor of a verdict: smaller ones change sigmas by less than 10 %
SAME = 2.0  # ratio of two scales within which both kinds have one scale
COMMON = 0.7  # least ratio of the median's excess to that of the mean if all edges share it


@dataclass(frozen=True, kw_only=True, repr=False)
class Chi2Kind(Displayed):
    """chi2 of the edges or factors of one kind.

    Attributes:
        kind: "odometry", "closure", or the class of the factors; "all" for their sum.
        count: number of edges or factors.
        chi2: sum r^T Omega r.
        degrees: degrees of freedom: the sum of their redundancies.
        low, high: interval that contains 99.9 % of the values if the information is right.
        scale: factor by which to multiply the information; 1 if chi2 agrees with its expectation,
            NaN without a verdict.
        verdict: "as-expected", "too-cautious", "too-optimistic", "too-large" (wrong
            edges, or too optimistic) or "undecided".
    """

    kind: str
    count: int
    chi2: float
    degrees: float
    low: float
    high: float
    scale: float
    verdict: str

    def _display(self) -> Display:
        facts = (
            ("chi2", number(self.chi2)),
            ("expected", f"{number(self.low)} to {number(self.high)}"),
            ("degrees of freedom", number(self.degrees)),
            ("verdict", self.verdict.replace("-", " ")),
        )
        return Display(title=f"Chi2Kind: {self.kind}, {self.count}", facts=facts)


def chi2_kinds(source: Any, options: Any = None, **changes: Any) -> tuple[Chi2Kind, ...]:
    """Compare chi2 with its expectation, by kind of edge of a pose graph or of factor.

    The kinds of edges are odometry (from an id to the next) and closure; those of factors their
    classes. The last entry has all of them, if there are several kinds.

    Args:
        source: result of the solve of a pose graph, a pose graph at its minimum, or its path; a
            FactorGraph at its minimum (:meth:`bundle.FactorGraph.with_values`).
        options: of a pose graph; only error, information and loss have an effect.
        **changes: options by name, which replace those in ``options``.

    Returns:
        Kinds without a verdict ("undecided") if the state is not a minimum, if a loss acts on the
        edges, or with fewer than 10 degrees of freedom; () if a direction is undetermined.

    Raises:
        InputError: the source is not a graph, or an option is wrong.
        OSError: the path cannot be read.

    Example:
        >>> for kind in bundle.chi2_kinds(bundle.solve(graph)):
        ...     print(kind.kind, kind.chi2, kind.degrees, kind.scale)
    """
    if is_graph(source):
        return _kinds_of_edges(weighted_graph(source, options, changes, "chi2_kinds"))
    # Factor graphs and their checks double the imports of a refined pose graph.
    from bundle.graphs.factors.factor_graph import FactorGraph
    from bundle.graphs.factors.same_problem import pose_graph_of

    check_type("source", source, FactorGraph, "a graph or the result of its solve")
    if options is not None or changes:
        found = brief(changes or options)
        raise InputError(f"options: expected only with a pose graph, found {found}")
    source.check_free()
    poses = pose_graph_of(source)
    if poses is None:
        from bundle.analysis.factor_equations import FactorEquations

        equations = FactorEquations(source)
        if equations.open_blocks():
            return ()
        names = np.array([type(factor).__name__ for factor in source.factors])
        squares = equations.squares
        has_no_loss = np.abs(2 * equations.costs - squares) <= 1e-9 * squares + 1e-300
        return _summed(equations, names, has_no_loss)
    return _kinds_of_edges(weighted_graph(poses.graph, None, {}, "chi2_kinds"), source)


def _kinds_of_edges(
    weighted: WeightedGraph, factors: FactorGraph | None = None
) -> tuple[Chi2Kind, ...]:
    """Return the kinds of edges; if ``factors`` are given, the classes of factors."""
    given, edges = weighted.given, weighted.edges
    if factors is None:
        names = np.where(given.is_closure[edges], "closure", "odometry")
    else:
        names = np.array([type(factor).__name__ for factor in factors.factors])[edges]
    # left-out edges have no part in the solve: those that stay are a selection
    is_selected = len(edges) < given.num_edges
    return _summed(
        PoseEquations(weighted), names, (weighted.weights[edges] == 1) & (not is_selected)
    )


def _summed(
    equations: NormalEquations, names: NDArray[Any], is_plain: NDArray[np.bool_]
) -> tuple[Chi2Kind, ...]:
    """Return the sums of each kind in order of appearance, then those of all."""
    inverse = equations.selected_inverse(with_tests=True)
    if inverse.undetermined >= 0:
        return ()
    tests, at_minimum = inverse.tests, inverse.tests.is_at_minimum(equations.cost)
    kinds = list(dict.fromkeys(names.tolist()))
    masks = [(name, names == name) for name in kinds]
    if len(kinds) > 1:
        masks.append(("all", np.ones(len(names), bool)))
    found = []
    for name, rows in masks:
        total = float(equations.squares[rows].sum())
        degrees = float(np.nansum(tests.redundancy[rows]))
        is_decided = at_minimum and bool(is_plain[rows].all()) and degrees >= LEAST_DEGREES
        median = _median_scale(tests.test[rows], tests.rank[rows])
        verdict, scale = _judge(total, degrees, median) if is_decided else ("undecided", np.nan)
        low, high = chi2_interval(degrees)
        found.append(
            Chi2Kind(
                kind=name,
                count=int(rows.sum()),
                chi2=total,
                degrees=degrees,
                low=low,
                high=high,
                scale=scale,
                verdict=verdict,
            )
        )
    return tuple(found)


def _judge(chi2: float, degrees: float, median: float) -> tuple[str, float]:
    """Return the verdict and the scale of the information."""
    low, high = chi2_interval(degrees, is_certain=True)
    ratio = chi2 / degrees
    if low <= chi2 <= high or 1 / WORTH_MENTION <= ratio <= WORTH_MENTION:
        return "as-expected", 1.0
    if ratio < 1:
        return "too-cautious", 1 / ratio if ratio > 0 else float("inf")
    if median < COMMON * ratio:
        return "too-large", float("nan")
    return "too-optimistic", 1 / ratio


def _median_scale(test: Floats, rank: NDArray[np.int64]) -> float:
    """Return the median of the tests, relative to the medians of their distributions."""
    known = np.isfinite(test) & (rank > 0)
    if not known.any():
        return 1.0
    medians = np.array([chi2_median(k) for k in range(int(rank.max()) + 1)])
    return float(np.median(test[known] / medians[rank[known]]))


def information_sentence(kinds: Sequence[Chi2Kind], noun: str = "edge") -> str:
    """Return a sentence about information that contradicts chi2; "" if none does."""
    said = []
    for one in _merged(kinds):
        what = f"all {noun}s" if one.kind == "all" else f"{one.kind} {noun}s"
        facts = (
            f"chi2 is {number(one.chi2)} for {one.degrees:,.0f} degrees of freedom (expected "
            f"{number(one.low)} to {number(one.high)})"
        )
        if one.verdict == "too-large":
            said.append(
                f"Errors of {what} are larger than their information states: {facts}. Some are "
                "wrong, or the information is too optimistic."
            )
        elif one.verdict == "too-cautious":
            times = number(one.scale)
            said.append(
                f"The information of {what} is {times} times too cautious: {facts}. Multiply it by "
                f"{times}, or all sigmas are {number(one.scale**0.5)} times too large."
            )
        else:
            times = number(1 / one.scale)
            said.append(
                f"The information of {what} is {times} times too optimistic: {facts}. Divide it by "
                f"{times}, or all sigmas are {number(one.scale**-0.5)} times too small."
            )
    return " ".join(said)


def _merged(kinds: Sequence[Chi2Kind]) -> list[Chi2Kind]:
    """Return the kinds with a verdict; the sum, if all kinds have about the same scale."""
    parts = [one for one in kinds if one.kind != "all"] or list(kinds)
    wrong = [one for one in parts if one.verdict not in ("as-expected", "undecided")]
    total = kinds[-1] if kinds and kinds[-1].kind == "all" else None
    if total is None or len(wrong) < len(parts) or len({one.verdict for one in parts}) > 1:
        return wrong
    scales = [one.scale for one in wrong]
    is_common = wrong[0].verdict == "too-large" or max(scales) < SAME * min(scales)
    return [total] if is_common and total.verdict == wrong[0].verdict else wrong
