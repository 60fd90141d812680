"""Models whose pixels have another origin, at the limits of the test."""

import numpy as np
import pytest

from bundle.judging.findings.find import find
from bundle.model.residuals import residuals
from tests.scenes import make_problem


def shifted(shift, noise=0.0, source="model", given=()):
    problem = make_problem(num_images=6, num_points=200)
    rng = np.random.default_rng(0)
    exact = problem.observation_xy + residuals(problem, "algebraic").xy
    xy = exact + shift + noise * rng.normal(size=problem.observation_xy.shape)
    found = find(problem.replace(observation_xy=xy), source=source, given=given)
    return {one.kind: one for one in found}


def test_a_shift_is_named_and_nothing_else_is_judged():
    found = shifted((-640.0, -480.0), source="a/model.nvm")["shifted_pixels"]
    assert found.evidence["shift"] == pytest.approx([640.0, 480.0], abs=1.0)
    assert found.evidence["rmse"] == pytest.approx(800.0, abs=1.0)
    assert found.command.endswith("--pixel-origin corner") and found.is_problem
    assert "not_refined" not in shifted((-640.0, -480.0))
    assert shifted((-640.0, -480.0))["shifted_pixels"].command == ""


@pytest.mark.parametrize(("shift", "is_advised"), [(-640.0, True), (30.0, False)])
def test_pixels_from_the_corner_are_not_read_from_the_centre_again(shift, is_advised):
    given = ("--pixel-origin", "corner")
    found = shifted((shift, shift), source="m.nvm", given=given)["shifted_pixels"]
    assert bool(found.command) == is_advised
    assert not is_advised or found.command.endswith("--pixel-origin center")


@pytest.mark.parametrize(
    ("shift", "noise", "is_found"),
    [
        ((0.0, 10.1), 0.0, True),
        ((0.0, 9.9), 0.0, False),
        ((100.0, 0.0), 22.0, True),  # 10000 of 10968: 91.2 %
        ((100.0, 0.0), 25.0, False),  # 10000 of 11250: 88.9 %
    ],
)
def test_limits(shift, noise, is_found):
    assert ("shifted_pixels" in shifted(shift, noise)) == is_found
