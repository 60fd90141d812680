"""Rules that the observations contradict.

A weak prior that is wrong ends many sigmas away. A strong one ends where its rule has it, and the
observations yield. So the model is solved again without the priors of rules. With the costs E of
observations and measurements, P = 1/2 sum pull^2 of the priors, and the noise s of the free model,

    T = 2 (E - E_free) / s^2 + 2 P

has a chi squared distribution with as many degrees of freedom as the priors have numbers, if the
rules are right. A free solve that ends early makes T too small. The rule is named from which the
free model is farthest, unless the free model has another fault, which a prior can only reveal.

Rules that hold parameters (fixed, bounds, ratios) have no sigma. They are tested as constants
(contradicted_constants.py), but with a second solve, and one more for each rule: the one is named
without which the cost falls most. Shared lenses have a test of their own (shared_lens).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from bundle.base.tails import chi2_limit
from bundle.base.words import number, rounded
from bundle.errors import brief, shown
from bundle.interface.finding import Finding
from bundle.judging.findings.contradicted_constants import is_notable, release
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.repaired import solved_free

if TYPE_CHECKING:
    from bundle.solving.constraints.ends import RuleEnd
    from bundle.solving.constraints.rules import Rule

FAR = 5.0  # pull above which a rule is named without another solve
NOTABLE = 0.01  # smallest notable rise of the cost by priors
MOST_RULES = 8  # rules that hold parameters, each with a solve of its own


def contradicted_priors(measured: Measured) -> tuple[Finding | None, Measured | None]:
    """Return the finding, or None, and the model without the priors of rules if it was solved."""
    if not measured.constraints or not measured.is_minimum:
        return None, None
    from bundle.solving.constraints.ends import rule_ends
    from bundle.solving.constraints.resolve import apply
    from bundle.solving.constraints.rule_list import rules_of

    measured = replace(measured, constraints=rules_of(measured.constraints))
    rules = [rule for rule in measured.constraints if rule.kind in {"prior", "on"}]
    if not rules:
        return None, None
    begin = measured.start or measured.whole
    applied = apply(measured.constraints, begin, measured.options)[1]
    assert applied is not None
    ends = rule_ends(applied, begin, measured.whole)
    # Planes need a gauge. Other rules are not to blame for a world that the gauge holds elsewhere.
    gauge = measured.options.gauge if any(rule.kind == "on" for rule in rules) else "auto"
    held = solved_free(measured, gauge)
    free = None if held is None else solved_free(_without(measured, rules))
    if held is None or free is None:
        return _farthest(measured, ends), None
    pulls = [prior for end in rule_ends(applied, begin, held.problem) for prior in end.priors]
    pull = sum(prior.pull**2 for prior in pulls)
    cost = free.summary.final_cost
    rise = held.summary.final_cost - pull / 2 - cost
    noise = 2 * cost / max(free.summary.num_residuals_reduced, 1)
    numbers = sum(len(prior.known) for prior in pulls)
    if not rise > NOTABLE * cost or not 2 * rise / noise + pull > chi2_limit(numbers):
        return _farthest(measured, ends), None
    ends = rule_ends(applied, begin, free.problem)
    share = f", and the cost falls by {rounded(100 * rise / (cost + rise))} %"
    found = _farthest(
        measured, ends, f"without {'it' if len(rules) == 1 else 'the rules'}, ", share
    )
    return found, replace(_without(measured, rules), whole=free.problem)


def contradicted_holds(measured: Measured) -> tuple[Finding | None, Measured | None]:
    """Return the finding about rules that hold parameters, or None, and the model without it."""
    if not measured.constraints or not measured.is_minimum:
        return None, None
    from bundle.solving.constraints.resolve import apply
    from bundle.solving.constraints.rule_list import rules_of

    given, options = rules_of(measured.constraints), measured.options
    applied = apply(given, measured.whole, options)[1]
    # The solve added the constant points of rules to those of the options.
    added = () if applied is None else applied.fixed_point_ids
    options = options.replace(fixed_point_ids={*options.fixed_point_ids}.difference(added))
    measured = replace(measured, constraints=given, options=options)
    rules = [rule for rule in given if rule.kind in {"fixed", "bounds", "ratio"}]
    held = solved_free(measured) if 0 < len(rules) <= MOST_RULES else None
    found = [(rule, solved_free(_without(measured, [rule]))) for rule in rules if held is not None]
    free = [(rule, result) for rule, result in found if result is not None]
    if held is None or not free:
        return None, None
    rule, best = min(free, key=lambda one: one[1].summary.final_cost)
    fall, squares, count, redundancy = release(held.summary, best.summary)
    if not is_notable(fall, squares, max(count, 1), redundancy):
        return None, None
    share = fall / (squares + fall)
    how = f"without it, the cost falls by {rounded(100 * share)} %"
    free_model = replace(_without(measured, [rule]), whole=best.problem)
    return _finding(measured, rule, how, share=share), free_model


def _without(measured: Measured, dropped: Sequence[Rule]) -> Measured:
    kept = [rule for rule in measured.constraints if rule not in dropped]
    return replace(measured, constraints=kept)


def _farthest(
    measured: Measured, ends: Sequence[RuleEnd], how: str = "", share: str = ""
) -> Finding | None:
    """Return the finding about the rule from which a model is farthest; None if it is near."""
    pulls = [(abs(prior.pull), end, prior) for end in ends for prior in end.priors]
    pull, end, prior = max(pulls, key=lambda one: one[0], default=(0.0, None, None))
    if end is None or prior is None or not (share or pull > FAR):
        return None
    where = f"{prior.subject} {prior.id} ({prior.parameter}) ends {number(pull)} sigmas from it"
    rule = next(one for one in measured.constraints if str(one) == end.rule)
    return _finding(measured, rule, f"{how}{where}{share}", pull=pull)


def _finding(measured: Measured, rule: Rule, how: str, **evidence: float) -> Finding:
    from bundle.solving.constraints.rule_list import parse_rule

    command = measured.command.without("--set", lambda text: parse_rule(text, "") == rule)
    is_flag = command != measured.command
    name = f"the rule {brief(str(rule))}{'' if is_flag else f' ({shown(rule.place)})'}"
    return Finding(
        kind="rules",
        sentence=f"The observations contradict {name}: {how}.",
        command=command.refine() if is_flag else "",
        evidence={"rule": str(rule), "place": rule.place, **evidence},
    )
