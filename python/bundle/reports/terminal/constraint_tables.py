"""What `bundle refine` says of rules: pulls of priors, active bounds, ties."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import RenderableType

from bundle.base.tables import columns, facts, notes, plural
from bundle.errors import shown
from bundle.solving.constraints.constraint_record import BoundEnd, PriorEnd, RuleEnd, TieEnd

__all__ = ["constraint_report"]

MOST_ROWS = 8
"""Priors, bounds and ties that are listed."""


def constraint_report(rules: Sequence[RuleEnd]) -> list[RenderableType]:
    """Return what became of the rules, and an empty line; nothing where there are none."""
    if not rules:
        return []
    report: list[RenderableType] = []
    held = [rule for rule in rules if rule.kind == "fixed"]
    if held:
        report.append(facts([("held", "; ".join(shown(rule.rule) for rule in held[:3]))]))
        if len(held) > 3:
            report += notes([f"{plural(len(held) - 3, 'other rule')} as well"])
    report += _priors([prior for rule in rules for prior in rule.priors])
    report += _bounds([bound for rule in rules for bound in rule.active_bounds], rules)
    ties = dict.fromkeys(tie for rule in rules for tie in rule.ties)
    report += _ties(list(ties))
    return [*report, ""]


def _priors(priors: list[PriorEnd]) -> list[RenderableType]:
    if not priors:
        return []
    strongest = sorted(priors, key=lambda prior: -abs(prior.pull))[:MOST_ROWS]
    rows = [
        (
            f"{prior.subject} {prior.id}",
            prior.parameter,
            _known(prior),
            _sigma(prior),
            _moved(prior),
            f"{prior.pull:+.2f}" if len(prior.known) == 1 else f"{prior.pull:.2f}",
        )
        for prior in strongest
    ]
    head = ("prior", "parameter", "known", "sigma", "after", "pull [sigmas]")
    report: list[RenderableType] = [columns(head, rows, left=2)]
    if len(priors) > MOST_ROWS:
        others = plural(len(priors) - MOST_ROWS, "other prior")
        report += notes([f"{others} pull less; --json FILE lists all"])
    return report


def _known(prior: PriorEnd) -> str:
    if prior.parameter == "rotation":
        return "as at the start"
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


def _bounds(bounds: list[BoundEnd], rules: Sequence[RuleEnd]) -> list[RenderableType]:
    if not any(rule.kind == "bounds" for rule in rules):
        return []
    if not bounds:
        return [facts([("bounds", "no parameter ends on one")])]
    rows = [
        (f"camera {bound.camera_id}", bound.parameter, bound.side, f"{bound.value:.7g}")
        for bound in bounds[:MOST_ROWS]
    ]
    report: list[RenderableType] = [
        columns(("active bound", "parameter", "side", "at"), rows, left=3)
    ]
    if len(bounds) > MOST_ROWS:
        others = plural(len(bounds) - MOST_ROWS, "other parameter")
        report += notes([f"{others} on a bound as well; --json FILE lists all"])
    return report


def _ties(ties: list[TieEnd]) -> list[RenderableType]:
    if not ties:
        return []
    rows = [
        (_members(tie), f"{tie.before[0]:.7g}", f"{tie.after[0]:.7g}") for tie in ties[:MOST_ROWS]
    ]
    report: list[RenderableType] = [columns(("one number", "first before", "first after"), rows)]
    if len(ties) > MOST_ROWS:
        report += notes([f"{plural(len(ties) - MOST_ROWS, 'other tie')}; --json FILE lists all"])
    return report


def _members(tie: TieEnd) -> str:
    names = [
        f"{name} of camera {camera}"
        for camera, name in zip(tie.camera_ids, tie.parameters, strict=True)
    ]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
