"""Causes in the structure of the matrix: its ordering, a denser prior, fill-in."""

from __future__ import annotations

from bundle.base.words import amount, number
from bundle.judging.triage.cause_words import TriageCause, asked, pairs, times
from bundle.judging.triage.difference import Difference

ORDERING_OPTIONS = ("ordering", "linear_solver_ordering")
DENSER, DENSE_STEP, HALF_CLIQUE = 1.5, 4.0, 0.5
MORE_FILL, FAR_FROM_BEST, NEAR_BEST = 1.1, 2.0, 1.3
MORE_OF_PRIOR = 1.5


def find_ordering(two: Difference) -> TriageCause | None:
    """Compare flops at equal nnz(Lambda), or with the best order that was tried.

    Ceres does not count some factors, for which the alarm of the solve has a bound.
    """
    is_asked = any(name in two.options for name in ORDERING_OPTIONS)
    evidence = pairs(
        two, "columns", "information_nonzeros", "factor_nonzeros", "factor_flops", "ordering"
    )
    warns = [bool(solve.warnings.get("ordering")) for solve in (two.old, two.new)]
    if is_asked and None in two.pair("factor_flops") and warns[0] != warns[1]:
        solve = "new" if warns[1] else "old"
        return TriageCause(
            cause="ordering",
            sentence=f"Ordering: the {solve} solve warns of it{asked(two, ORDERING_OPTIONS)}.",
            evidence=evidence,
        )
    if not two.factor_changed or not (is_asked or two.old.solver == two.new.solver):
        return None
    flops, nonzeros = two.ratio("factor_flops"), two.ratio("factor_nonzeros")
    orders = f"{two.old.ordering or '-'} -> {two.new.ordering or '-'}"
    grew = (
        f"nnz(L) {times(nonzeros)} and flops {times(flops)} ({orders}"
        f"{asked(two, ORDERING_OPTIONS)})"
    )
    if two.is_same("information_nonzeros") and two.is_same("columns"):
        known = amount(two.new.information_nonzeros or 0)
        return TriageCause(
            cause="ordering",
            sentence=f"Ordering, not size: nnz(Lambda) is unchanged ({known}), {grew}.",
            evidence=evidence,
        )
    excess = [
        solve.factor_flops / solve.least_flops
        for solve in (two.old, two.new)
        if solve.factor_flops and solve.least_flops
    ]
    if len(excess) == 2 and excess[0] < NEAR_BEST and excess[1] > FAR_FROM_BEST:
        return TriageCause(
            cause="ordering",
            sentence=f"Ordering: {grew}, {number(excess[1])} times the flops of the best order "
            "that was tried.",
            evidence={**evidence, "times_the_best": excess},
        )
    return None


def find_prior(two: Difference) -> TriageCause | None:
    """Look for a denser Lambda on as many variables without as many more measurements."""
    if two.old.initial_cost is None:  # a window: the prior is known
        ratio = two.ratio("prior_columns")
        is_same_window = two.old.options.get("window") == two.new.options.get("window")
        if ratio is None or not is_same_window or ratio < MORE_OF_PRIOR:
            return None
        evidence = pairs(two, "prior_columns", "information_nonzeros")
        old, new = two.pair("prior_columns")
        return TriageCause(
            cause="prior-densifies",
            sentence=f"The prior couples more: {old:.0f} -> {new:.0f} coordinates (median) in "
            "windows of as many frames.",
            evidence=evidence,
        )
    ratio = two.ratio("information_nonzeros")
    if ratio is None or not two.information_changed or ratio < 1 or not two.is_same("columns"):
        return None
    before, after = two.pair("measurements")
    if after > before:
        old, new = two.pair("densest")
        if old is None or new is None or new < max(DENSER * old, old + DENSE_STEP):
            return None
        edges = two.counts.get("num_edges")
        clique = new * (new - 1) / 2
        if edges is None or clique < HALF_CLIQUE * (edges[1] - edges[0]):
            return None
    evidence = pairs(
        two, "columns", "measurements", "information_nonzeros", "densest", "factor_flops"
    )
    dense = ""
    if two.new.densest and two.new.densest != two.old.densest:
        dense = f"; {two.new.densest:.0f} variables are coupled with as many others"
    return TriageCause(
        cause="prior-densifies",
        sentence=f"A prior densifies: nnz(Lambda) {times(ratio)} with as many variables "
        f"({two.new.columns:.0f} columns){dense}. nnz(L) {times(two.ratio('factor_nonzeros'))}.",
        evidence=evidence,
    )


def find_fill(two: Difference) -> TriageCause | None:
    """Compare the growth of nnz(L) with that of nnz(Lambda)."""
    factor, information = two.ratio("factor_nonzeros"), two.ratio("information_nonzeros")
    if factor is None or information is None or two.old.solver != two.new.solver:
        return None
    if not two.factor_changed or factor < MORE_FILL * max(information, 1.0):
        return None
    return TriageCause(
        cause="fill",
        sentence=f"Fill-in: nnz(L) {times(factor)} while nnz(Lambda) {times(information)}: new "
        f"measurements couple distant variables, and flops {times(two.ratio('factor_flops'))}.",
        evidence=pairs(
            two, "columns", "information_nonzeros", "factor_nonzeros", "factor_flops", "ordering"
        ),
    )
