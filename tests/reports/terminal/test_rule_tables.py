"""Tables of rules: the strongest pulls first, the others counted."""

from __future__ import annotations

from types import SimpleNamespace

from bundle.base.tables import render
from bundle.reports.terminal.screen import laid_out
from bundle.reports.terminal.solve_data import MOST_ROWS, constraint_sections


def prior(pull):
    return SimpleNamespace(
        subject="camera", id=round(abs(pull)), parameter="f", known=(500.0,), sigma=(1.0,),
        relative=False, after=(500.0 + pull,), pull=pull,
    )  # fmt: skip


def test_the_strongest_pulls_come_first_and_the_others_are_counted():
    pulls = [1.0, -7.0, 3.0, *(0.1 * k for k in range(MOST_ROWS))]
    rule = SimpleNamespace(
        kind="prior", rule="", priors=[*map(prior, pulls)], active_bounds=[], ties=[]
    )
    lines = render(*laid_out(constraint_sections([rule])), width=100).splitlines()
    assert [line.split()[-1] for line in lines[1:4]] == ["-7.00", "+3.00", "+1.00"]
    assert lines[-1].startswith("- 3 other priors pull less")
    assert len(lines) == 1 + MOST_ROWS + 1


def test_rules_of_bounds_say_that_none_is_active():
    rule = SimpleNamespace(kind="bounds", rule="", priors=[], active_bounds=[], ties=[])
    (section,) = constraint_sections([rule])
    assert section.facts == [("bounds", "no parameter ends on one")]
    assert constraint_sections([]) == []
