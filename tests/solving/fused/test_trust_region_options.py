"""Ceres' further options of the trust region: both backends, refusals, orders of bounds."""

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.campaigns import orderings
from tests.campaigns.triage_inputs import chain_of_poses

BOTH = [
    ("max_trust_region_radius", 20.0, {"initial_trust_region_radius": 10.0}),
    ("min_trust_region_radius", 5e3, {}),
    ("min_relative_decrease", 0.9, {}),
    ("max_num_consecutive_invalid_steps", 1, {}),
]
CERES_ONLY = [
    ("min_lm_diagonal", 1e3),
    ("max_lm_diagonal", 1e-3),
    ("use_nonmonotonic_steps", True),
]


def bent():
    """A start from which some steps are rejected."""
    return scenes.make_problem(perturbation=0.3)


def trace(backend, **options):
    return bundle.solve(
        bent(), backend=backend, gauge="two_cameras", max_num_iterations=12, **options
    ).iterations


@pytest.mark.parametrize(("name", "value", "others"), BOTH)
def test_both_backends_take_the_same_steps(name, value, others):
    options = {name: value, **others}
    ours, ceres = trace("fused", **options), trace("ceres", **options)
    np.testing.assert_allclose(ours["cost"], ceres["cost"], rtol=1e-5)
    np.testing.assert_allclose(ours["trust_region_radius"], ceres["trust_region_radius"], rtol=1e-3)
    np.testing.assert_array_equal(ours["step_is_successful"], ceres["step_is_successful"])


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_each_has_its_effect(backend):
    usual = trace(backend)
    assert trace(backend, max_trust_region_radius=2e4)["trust_region_radius"].max() == 2e4
    assert usual["trust_region_radius"].max() > 2e4
    ended = bundle.solve(
        bent(), backend=backend, min_trust_region_radius=9e3, min_relative_decrease=0.9999
    )
    assert len(ended.iterations["cost"]) < 8
    assert "9.0" in ended.summary.message
    strict = trace(backend, min_relative_decrease=0.9)
    quality = strict["relative_decrease"][1:]
    accepted = np.asarray(strict["step_is_successful"], bool)[1:]
    np.testing.assert_array_equal(accepted, quality > 0.9)
    assert not accepted.all()


@pytest.mark.parametrize(("name", "value"), CERES_ONLY)
def test_what_only_ceres_has_is_refused_by_name_or_given_to_ceres(name, value):
    problem = scenes.make_problem(perturbation=0.03)
    with pytest.raises(bundle.InputError, match=f"^{name}: expected .* with the fused backend"):
        bundle.solve(problem, backend="fused", **{name: value})
    found = bundle.solve(problem, **{name: value}).summary
    assert found.backend_used == "CERES" and name in found.backend_choice
    usual = bundle.solve(problem, backend="ceres")
    changed = bundle.solve(problem, backend="ceres", **{name: value})
    assert changed.summary.final_cost == pytest.approx(usual.summary.final_cost, rel=1e-4)
    if name != "use_nonmonotonic_steps":  # the columns are scaled: their squares are about 1
        assert changed.iterations["cost"][1] != usual.iterations["cost"][1]


@pytest.mark.parametrize(("options", "words"), [
    ({"initial_trust_region_radius": 1e5, "max_trust_region_radius": 1e4}, "initial_trust"),
    ({"min_trust_region_radius": 1e5}, "min_trust_region_radius: expected at most initial"),
    ({"min_lm_diagonal": 2.0, "max_lm_diagonal": 1.0}, "min_lm_diagonal: expected at most max"),
    ({"max_consecutive_nonmonotonic_steps": 3}, "use_nonmonotonic_steps"),
    ({"max_trust_region_radius": 1e5, "trust_region_strategy_type": "dogleg"}, "valid only with"),
    ({"min_relative_decrease": 1.0}, "less than 1"),
])  # fmt: skip
def test_bounds_that_exclude_each_other(options, words):
    with pytest.raises(bundle.InputError, match=words):
        bundle.SolveOptions(**options)


def test_a_solver_changes_them_between_solves():
    solver = bundle.Solver(scenes.make_problem(perturbation=0.03), backend="fused")
    small = solver.solve(initial_trust_region_radius=1.0, max_trust_region_radius=2.0)
    assert small.iterations["trust_region_radius"].max() <= 2.0
    assert solver.solve().iterations["trust_region_radius"].max() > 2.0
    with pytest.raises(bundle.InputError, match=r"^min_lm_diagonal: expected one of initial"):
        solver.solve(min_lm_diagonal=1e3)


def test_factor_graphs_take_them():
    graph = orderings.factors(chain_of_poses(0, 30, 6))
    found = graph.solve(initial_trust_region_radius=1.0, max_trust_region_radius=2.0)
    assert found.iterations["trust_region_radius"].max() <= 2.0
    by_root = graph.solve(
        square_root=True, initial_trust_region_radius=1.0, max_trust_region_radius=2.0
    )
    assert by_root.iterations["trust_region_radius"].max() <= 2.0
    with pytest.raises(bundle.InputError, match=r"^min_lm_diagonal: .*square_root"):
        graph.solve(square_root=True, min_lm_diagonal=1e3)
