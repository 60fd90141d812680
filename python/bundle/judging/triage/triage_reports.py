"""``triage``: the cause of the difference between two reports of one input, tests of each cause.

A report of compare contains solves by many methods. A cause of one method is a cause of all, except
the machine: its load changes all times, so that the median ratio over the methods decides.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bundle.base.words import amount, duration, number, plural
from bundle.errors import InputError, shown
from bundle.interface.judging_options import TriageOptions
from bundle.interface.option_class import takes_options
from bundle.judging.triage.difference import THREADS, Difference, is_busy
from bundle.judging.triage.solve_report import SolveReport, read_report, same_input
from bundle.judging.triage.triage_result import (
    Quantity,
    Triage,
    TriageCause,
    arrow,
    asked,
    effect,
    pairs,
    times,
    word,
)

QUANTITIES = (
    "columns",
    "measurements",
    "information_nonzeros",
    "factor_nonzeros",
    "factor_flops",
    "ordering",
    "initial_cost",
    "final_cost",
    "steps",
    "rejected",
    "least_radius",
    "seconds",
    "num_threads",
    "error",
)


@takes_options(TriageOptions)
def triage(
    old: str | os.PathLike[str],
    new: str | os.PathLike[str],
    options: TriageOptions | None = None,
    **changes: Any,
) -> Triage:
    """Name the cause of the difference between two reports of one input.

    Both reports are of the same command: refine, vio or compare with ``--json FILE``.

    Args:
        old: path of the earlier report.
        new: path of the later report.
        options: largest differences that are noise.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: a file is not such a report or is of another version, or the inputs differ.
        OSError: a file cannot be read.

    Example:
        >>> found = bundle.triage("monday.json", "tuesday.json")
        >>> for cause in found.causes:
        ...     print(cause.cause, cause.sentence)
    """
    options = TriageOptions.of(options, changes, "triage")
    reports = read_report(old), read_report(new)
    same_input(*reports)
    differences = _differences(*reports, options)
    found: dict[str, TriageCause] = {}
    methods: dict[str, tuple[str, ...]] = {}
    excess = [two.time_excess or 1.0 for two in differences]  # of all methods of a comparison
    is_machine = statistics.median(excess) != 1.0 or len(excess) == 1
    for two in differences:
        for cause in causes_of(two):
            if cause.cause == "machine" and not is_machine:
                continue
            found.setdefault(cause.cause, cause)
            if two.new.method:
                methods[cause.cause] = (*methods.get(cause.cause, ()), two.new.method)
    first = differences[0]
    return Triage(
        causes=tuple(found[name] for name in CAUSES if name in found),
        quantities=tuple(
            Quantity(name=name, old=pair[0], new=pair[1])
            for name in QUANTITIES
            if (pair := first.pair(name)) not in ((None, None), ("", ""))
        ),
        methods=methods,
        notes=_notes(first, found),
    )


def _differences(
    old: SolveReport, new: SolveReport, options: TriageOptions
) -> Sequence[Difference]:
    both = [key for key in old.solves if key in new.solves]
    if not both:
        raise InputError(
            f"{shown(new.path)}: expected a solve by a method of {shown(old.path)}, found "
            f"{len(new.solves)} by other methods"
        )
    return [
        Difference(
            old.solves[key],
            new.solves[key],
            (old.inputs[key[0]], new.inputs[key[0]]),
            (old.environment, new.environment),
            options,
        )
        for key in both
    ]


def _notes(two: Difference, found: dict[str, TriageCause]) -> tuple[str, ...]:
    said = []
    if two.options and "options" not in found and "ordering" not in found:
        said.append(f"Options differ without effect: {', '.join(two.options)}.")
    threads = two.pair(THREADS)
    if threads[0] != threads[1] and THREADS not in getattr(found.get("options"), "evidence", {}):
        said.append(f"Threads differ without effect: {threads[0]} -> {threads[1]}.")
    if two.has_other_host and "machine" not in found:
        ratio = two.ratio("seconds")
        times = (
            "" if ratio is None else f", and its time is {number(ratio)} times that of the old one"
        )
        said.append(f"The new solve ran on another processor{times}.")
    differs = [part for part in ("structure", "measurements", "start") if two.differs(part)]
    if differs and "data" not in found:
        said.append(f"The input differs without effect: {', '.join(differs)}.")
    return tuple(said)


# Causes of a difference of two solves, each with the numbers that show it.
#
# Causes are tested in this order. Warnings name a wrong Jacobian. At equal nnz(Lambda), more flops
# are the ordering; at an equal number of variables, a larger nnz(Lambda) without more measurements
# is a prior that couples all its variables. Options and data that differ explain every other
# change. With the same options and data, another gradient of the same residuals at the same start,
# or more steps at a smaller radius, prove a wrong Jacobian; a change without them is convergence.
# The machine explains a time that no other cause explains.

CAUSES = (
    "jacobian",
    "ordering",
    "prior-densifies",
    "options",
    "data",
    "fill",
    "convergence",
    "machine",
)
"""Causes in the order of a report."""

WRONG_JACOBIAN = (
    *("suspicious_steps", "suspicious_jacobian", "wrong_factor"),
    *("nullity", "sigma of yaw falls"),
)
"""Warnings of solves and alarms of windows that only a wrong Jacobian raises."""

JACOBIAN_OPTIONS = ("jacobians",)
WORK_OPTIONS = ("backend", "linear_solver_type", "preconditioner_type", "deterministic")
"""Options that change times and the factor, but not the minimum."""


def causes_of(two: Difference) -> list[TriageCause]:
    """Return the causes of a difference; empty if nothing changed beyond noise."""
    return sorted(_causes(two), key=lambda cause: CAUSES.index(cause.cause))


def _causes(two: Difference) -> Iterator[TriageCause]:
    proven = two.new_warnings(WRONG_JACOBIAN)
    if proven:
        yield _jacobian(two, proven)
    ordering, prior = find_ordering(two), find_prior(two)
    yield from (cause for cause in (ordering, prior) if cause is not None)
    behaves_otherwise = two.cost_changed or two.steps_changed or two.converges_otherwise
    named = ORDERING_OPTIONS if ordering else JACOBIAN_OPTIONS if proven else ()
    options = {name: values for name, values in two.options.items() if name not in named}
    decisive = {name for name in options if name not in WORK_OPTIONS}
    is_other_factor = two.factor_changed and ordering is None
    has_root = bool(proven)
    if options and (
        (behaves_otherwise and (decisive or not two.has_other_data))
        or is_other_factor
        or two.time_excess is not None
    ):
        yield _options(options, two)
        has_root = True
    # a prior in the place of its factors is other data by construction
    is_data = two.has_other_data and prior is None and (behaves_otherwise or two.factor_changed)
    if is_data:
        yield _data(two)
        has_root = True
    fill = None if ordering or prior else find_fill(two)
    if fill is not None:
        yield fill
    if behaves_otherwise and not has_root and prior is None:
        is_slower = two.steps_changed and (two.new.steps or 0) > (two.old.steps or 0)
        is_worse = is_slower or two.cost_changed or two.converges_otherwise
        # odometry ends within a time budget: a slow machine leaves it fewer steps
        is_late = two.new_warnings(("out of time",))
        if is_late:
            yield _machine(two, two.ratio("seconds") or 1.0)
            return
        is_same_start = not two.differs("start") and two.is_same_start_cost
        is_other_jacobian = two.has_other_gradient or (is_worse and two.radius_fell)
        if is_same_start and is_other_jacobian:
            yield _jacobian(two, [])
        else:
            yield _convergence(two)
    elif two.old.is_converged and not two.new.is_converged:
        yield _convergence(two)
    if two.time_excess is not None and not options and not is_data:
        threads, time = two.ratio("num_threads") or 1, two.ratio("seconds")
        explains = threads != 1 and time is not None and (threads < 1) == (time > 1)
        yield _threads(two) if explains else _machine(two, two.time_excess)


def _jacobian(two: Difference, proven: list[str]) -> TriageCause:
    evidence = {
        **pairs(two, "steps", "rejected", "least_radius", "initial_cost", "final_cost"),
        **pairs(two, "start_gradient"),
        "warnings": proven,
    }
    if not proven:
        return TriageCause(
            cause="jacobian",
            sentence=f"The Jacobian: steps {arrow(two, 'steps')}, rejected "
            f"{arrow(two, 'rejected')}, smallest radius {arrow(two, 'least_radius')}, gradient at "
            f"the start {arrow(two, 'start_gradient')}, from the same start with the same data and "
            "options. `bundle check` shows a wrong derivative.",
            evidence=evidence,
        )
    if "nullity" in proven or "sigma of yaw falls" in proven:
        what = "directions that no sensor measures gain information"
    else:
        what = "the solve reports signs of a wrong derivative"
    return TriageCause(
        cause="jacobian",
        sentence=f"The Jacobian: {what} ({', '.join(kind.replace('_', ' ') for kind in proven)})"
        f"{asked(two, JACOBIAN_OPTIONS)}.",
        evidence=evidence,
    )


def _options(options: Mapping[str, tuple[Any, Any]], two: Difference) -> TriageCause:
    changes = ", ".join(f"{name} {word(a)} -> {word(b)}" for name, (a, b) in options.items())
    return TriageCause(
        cause="options",
        sentence=f"Options: {changes}. {effect(two)}",
        evidence={name: {"old": a, "new": b} for name, (a, b) in options.items()},
    )


def _data(two: Difference) -> TriageCause:
    counts = {name: {"old": a, "new": b} for name, (a, b) in two.counts.items()}
    known = {part: two.differs(part) for part in ("structure", "measurements", "start")}
    words = ", ".join(
        f"{name.removeprefix('num_').replace('_', ' ')} {word(a)} -> {word(b)}"
        for name, (a, b) in two.counts.items()
    )
    if not words:
        words = "other measurements" if known["measurements"] else "another cost at the start"
    return TriageCause(
        cause="data",
        sentence=f"Data: {words}. {effect(two)}",
        evidence={**counts, **pairs(two, "initial_cost", "final_cost"), "differs": known},
    )


def _convergence(two: Difference) -> TriageCause:
    if two.converges_otherwise:
        what = "the new solve did not converge"
        what = what if two.old.is_converged else "the old solve did not converge"
    elif two.differs("start"):
        what = "another start"
    elif two.cost_changed:
        what = "another minimum"
    else:
        what = "another number of steps"
    return TriageCause(
        cause="convergence",
        sentence=f"Convergence: {what}. {effect(two)}",
        evidence=pairs(
            two, "initial_cost", "final_cost", "steps", "rejected", "least_radius", "is_converged"
        ),
    )


def _threads(two: Difference) -> TriageCause:
    old, new = two.pair("num_threads")
    return TriageCause(
        cause="options",
        sentence=f"Options: {THREADS} {old} -> {new}. Time {arrow(two, 'seconds', duration)}.",
        evidence={THREADS: {"old": old, "new": new}, **pairs(two, "seconds")},
    )


def _machine(two: Difference, excess: float) -> TriageCause:
    old, new = two.environments
    why = ""
    if two.has_other_host:
        why = f": {old['cpu_model']} -> {new['cpu_model']}"
    elif is_busy(new, two.new.num_threads) and not is_busy(old, two.old.num_threads):
        load = number(new["load_before"])
        why = f": other processes used it (load {load} on {plural(new['num_cores'], 'core')})"
    elif is_busy(old, two.old.num_threads) and not is_busy(new, two.new.num_threads):
        why = ": other processes used it during the old solve"
    else:
        versions = [given.get("versions") or {} for given in (old, new)]
        others = [k for k in versions[0] if k in versions[1] and versions[0][k] != versions[1][k]]
        if others:
            why = f": other versions ({', '.join(others)})"
    late = two.new_warnings(("out of time",))
    budget = "; solves ended at their time budget" if late else ""
    return TriageCause(
        cause="machine",
        sentence=f"The machine{why}. Time {arrow(two, 'seconds', duration)}, {times(excess)} "
        f"for the same steps and flops{budget}.",
        evidence={
            **pairs(two, "seconds", "steps", "factor_flops", "num_threads"),
            "excess": excess,
            "environment": {"old": dict(old), "new": dict(new)},
        },
    )


ORDERING_OPTIONS = ("ordering", "linear_solver_ordering")
DENSER, DENSE_STEP, HALF_CLIQUE = 1.5, 4.0, 0.5
MORE_FILL, FAR_FROM_BEST, NEAR_BEST = 1.1, 2.0, 1.3
MORE_OF_PRIOR = 1.5


def find_ordering(two: Difference) -> TriageCause | None:
    """Compare flops at equal nnz(Lambda), or with the best order that was tried.

    For some factors, Ceres has no count; the warning of the solve then states a bound.
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
    """Detect a Lambda that is denser than variables and measurements explain."""
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
        sentence=f"A prior makes Lambda denser: nnz(Lambda) {times(ratio)} with as many variables "
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
