"""Rules that the observations contradict.

A weak prior that is wrong ends many sigmas away. A strong one ends where its rule has it, and the
observations yield. So the model is solved again without the priors of rules. With the costs E of
observations and measurements, P = 1/2 sum pull^2 of the priors, and the noise s of the free model,

    T = 2 (E - E_free) / s^2 + 2 P

has a chi squared distribution with as many degrees of freedom as the priors have numbers, if the
rules are right. A free solve that ends early makes T too small. The rule is named from which the
free model is farthest, unless the free model has another fault, which a prior can only reveal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from bundle.base.tails import chi2_limit
from bundle.base.words import number, rounded
from bundle.errors import InputError, brief, shown
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.repaired import FREE_TOLERANCE, MOST_FREE_STEPS, is_affordable, solved

if TYPE_CHECKING:
    from bundle.solving.constraints.ends import RuleEnd

FAR = 5.0  # pull above which a rule is named without another solve
NOTABLE = 0.01  # smallest notable rise of the cost


def contradicted_rules(measured: Measured) -> tuple[Finding | None, Measured | None]:
    """Return the finding, or None, and the model without the priors of rules if it was solved."""
    if not measured.constraints or not measured.is_minimum:
        return None, None
    from bundle.solving.constraints.ends import rule_ends
    from bundle.solving.constraints.resolve import apply
    from bundle.solving.constraints.rule_list import rules_of

    given = rules_of(measured.constraints)
    rules = [rule for rule in given if rule.kind in {"prior", "on"}]
    if not rules:
        return None, None
    begin = measured.start or measured.whole
    applied = apply(given, begin, measured.options)[1]
    assert applied is not None
    ends = rule_ends(applied, begin, measured.whole)
    if not is_affordable(measured):
        return _farthest(measured, ends), None
    others = [rule for rule in given if rule not in rules]
    options = measured.options.replace(
        max_num_iterations=MOST_FREE_STEPS, function_tolerance=FREE_TOLERANCE
    )
    # Planes need a gauge. Other rules are not to blame for a world that the gauge holds elsewhere.
    gauge = measured.options.gauge if any(rule.kind == "on" for rule in rules) else "auto"
    whole, priors = measured.whole, measured.priors
    try:
        held = solved(measured, whole, options, priors, gauge)
        free = solved(replace(measured, constraints=others), whole, options, priors)
    except InputError:  # without the rules, something is undetermined
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
    return found, replace(measured, whole=free.problem, constraints=others)


def _farthest(
    measured: Measured, ends: Sequence[RuleEnd], how: str = "", share: str = ""
) -> Finding | None:
    """Return the finding about the rule from which a model is farthest; None if it is near."""
    pulls = [(abs(prior.pull), end, prior) for end in ends for prior in end.priors]
    pull, end, prior = max(pulls, key=lambda one: one[0], default=(0.0, None, None))
    if end is None or prior is None or not (share or pull > FAR):
        return None
    from bundle.solving.constraints.rule_list import parse_rule, rules_of

    where = f"{prior.subject} {prior.id} ({prior.parameter}) ends {number(pull)} sigmas from it"
    rules = [rule for rule in rules_of(measured.constraints) if str(rule) == end.rule]
    command = measured.command.without("--set", lambda text: parse_rule(text, "") in rules)
    is_flag = command != measured.command
    name = f"the rule {brief(end.rule)}{'' if is_flag else f' ({shown(end.place)})'}"
    return Finding(
        kind="rules",
        sentence=f"The observations contradict {name}: {how}{where}{share}.",
        command=command.refine() if is_flag else "",
        evidence={"rule": end.rule, "place": end.place, "pull": pull},
    )
