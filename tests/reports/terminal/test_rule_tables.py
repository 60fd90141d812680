"""Tables of rules: the strongest pulls first, the others counted."""

from __future__ import annotations

from types import SimpleNamespace

import bundle
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


def test_a_wrong_rule_is_named_in_the_first_lines(tmp_path, capsys):
    from bundle.cli.main import main

    made = bundle.synthesize(num_images=8, num_points=80, scene="orbit", seed=2)
    bundle.save(made.problem, tmp_path / "model")
    focal = float(made.ground_truth.camera_params[0, 0])
    words = ["refine", str(tmp_path / "model"), "-o", str(tmp_path / "out"), "--overwrite"]
    for value in (focal, 0.4 * focal):
        rule = f"cameras *: f prior {value} sigma 2"
        assert main([*words, "--quiet", "--set", rule]) == 0
        assert ("contradict" in capsys.readouterr().out) == (value != focal)
