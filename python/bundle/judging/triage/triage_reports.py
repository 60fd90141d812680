"""``triage``: the cause of the difference between two reports of one input.

A comparison holds solves by many methods. A cause of one method is a cause of the whole, except the
machine: its load changes all times, so that the median ratio over the methods decides.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from typing import Any

from bundle.base.words import number
from bundle.errors import InputError, shown
from bundle.interface.judging_options import TriageOptions
from bundle.interface.option_class import takes_options
from bundle.judging.triage.causes import CAUSES, causes_of
from bundle.judging.triage.difference import THREADS, Difference
from bundle.judging.triage.solve_report import SolveReport, read_report, same_input
from bundle.judging.triage.triage_result import Quantity, Triage, TriageCause

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
        InputError: a file is no such report, is of another version, or both are of different
            inputs.
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
    for two in differences:
        for cause in causes_of(two):
            if cause.cause == "machine" and not _is_machine(differences):
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
    """Return the difference of each method that both reports contain."""
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


def _is_machine(differences: Sequence[Difference]) -> bool:
    """Return True if the median method of a comparison took another time, too."""
    excess = [two.time_excess or 1.0 for two in differences]
    return statistics.median(excess) != 1.0 or len(excess) == 1


def _notes(two: Difference, found: dict[str, TriageCause]) -> tuple[str, ...]:
    """Return the differences without an effect beyond noise."""
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
