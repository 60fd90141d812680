"""Causes of a difference of two solves, each with the numbers that show it.

The order is that of the proof. Warnings name a wrong Jacobian. At equal nnz(Lambda), more flops are
the ordering; at an equal number of variables, a larger nnz(Lambda) without more measurements is a
prior that couples all its variables. Options and data that differ explain every other change. With
the same options and data, another gradient of the same residuals at the same start, or more steps
at a smaller radius, are those of a wrong Jacobian, and a change without them is convergence. The
machine explains a time that no other cause explains.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bundle.base.words import duration, number, plural
from bundle.judging.triage.cause_words import TriageCause, arrow, asked, effect, pairs, times, word
from bundle.judging.triage.difference import THREADS, Difference, is_busy
from bundle.judging.triage.structure_causes import (
    ORDERING_OPTIONS,
    find_fill,
    find_ordering,
    find_prior,
)

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
        yield _threads(two) if _explains_threads(two) else _machine(two, two.time_excess)


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
        evidence={
            **counts,
            **pairs(two, "initial_cost", "final_cost"),
            "differs": known,
        },
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


def _explains_threads(two: Difference) -> bool:
    threads, time = two.ratio("num_threads"), two.ratio("seconds")
    return threads is not None and threads != 1 and time is not None and (threads < 1) == (time > 1)


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
