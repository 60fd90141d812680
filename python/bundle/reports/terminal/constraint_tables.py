"""Rules in the report of `bundle refine`: pulls of priors, active bounds, ties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from bundle.base.words import plural
from bundle.errors import shown
from bundle.reports.sections import Column, Section, Table
from bundle.solving.constraints.ends import PriorEnd, RuleEnd, TieEnd

MOST_ROWS = 8
"""Number of listed priors, bounds and ties."""


BOUNDS = (
    Column("active bound", lambda bound: f"camera {bound.camera_id}"),
    Column("parameter", "parameter"),
    Column("side", "side"),
    Column("at", "value", "{:.7g}".format),
)


def constraint_sections(rules: Sequence[RuleEnd]) -> list[Section]:
    """Return the state of the rules after the solve; empty without rules."""
    held = [shown(rule.rule) for rule in rules if rule.kind == "fixed"]
    more = [f"{plural(len(held) - 3, 'other rule')} as well"] if len(held) > 3 else []
    priors = [prior for rule in rules for prior in rule.priors]
    bounds = [bound for rule in rules for bound in rule.active_bounds]
    ties = dict.fromkeys(tie for rule in rules for tie in rule.ties)
    is_free = any(rule.kind == "bounds" for rule in rules) and not bounds
    strongest = sorted(priors, key=lambda prior: -abs(prior.pull))
    parts = [
        *([Section(facts=[("held", "; ".join(held[:3]))], notes=more)] if held else []),
        *_listed(PRIORS, strongest, 2, "other prior", " pull less"),
        *_listed(BOUNDS, bounds, 3, "other parameter", " on a bound as well"),
        *([Section(facts=[("bounds", "no parameter ends on one")])] if is_free else []),
        *_listed(TIES, list(ties), 1, "other tie", ""),
    ]
    return [replace(part, is_joined=index > 0) for index, part in enumerate(parts)]


def _listed(
    columns: Sequence[Column], rows: Sequence[Any], left: int, noun: str, words: str
) -> list[Section]:
    def others(count: int) -> str:
        return f"{plural(count, noun)}{words}; --json FILE lists all"

    table = Table(columns, rows, left=left, most=MOST_ROWS, others=others)
    return [Section(tables=[table])] if rows else []


def _known(prior: PriorEnd) -> str:
    if prior.parameter == "rotation":
        return "start value"
    return ", ".join(f"{value:.7g}" for value in prior.known)


def _sigma(prior: PriorEnd) -> str:
    if prior.relative:
        return f"{100 * prior.sigma[0]:.3g} %"
    unit = " deg" if prior.parameter == "rotation" else ""
    same = len(set(prior.sigma)) == 1
    return ", ".join(f"{sigma:.3g}" for sigma in (prior.sigma[:1] if same else prior.sigma)) + unit


def _moved(prior: PriorEnd) -> str:
    if prior.parameter == "rotation":
        return f"turned {prior.pull * prior.sigma[0]:.3g} deg"
    if len(prior.known) == 1:
        return f"{prior.after[0]:.7g}"
    return f"off by {math.dist(prior.known, prior.after):.3g}"


def _members(tie: TieEnd) -> str:
    names = [
        f"{name} of camera {camera}"
        for camera, name in zip(tie.camera_ids, tie.parameters, strict=True)
    ]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


PRIORS = (
    Column("prior", lambda prior: f"{prior.subject} {prior.id}"),
    Column("parameter", "parameter"),
    Column("known", _known),
    Column("sigma", _sigma),
    Column("after", _moved),
    Column(
        "pull [sigmas]",
        lambda prior: f"{prior.pull:+.2f}" if len(prior.known) == 1 else f"{prior.pull:.2f}",
    ),
)
TIES = (
    Column("one number", _members),
    Column("first before", lambda tie: f"{tie.before[0]:.7g}"),
    Column("first after", lambda tie: f"{tie.after[0]:.7g}"),
)
