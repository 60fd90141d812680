"""Causes of differences of which all facts are given."""

from dataclasses import replace

import pytest

from bundle.judging.triage.triage_reports import causes_of
from tests.judging.triage.test_difference import FLIGHT, GRAPH, between

DENSER = {"information_nonzeros": 3e4, "factor_nonzeros": 6e4, "factor_flops": 9e6}


def named(two):
    """Return the causes of a difference."""
    return [cause.cause for cause in causes_of(two)]


@pytest.mark.parametrize(
    ("densest", "edges", "is_prior"),
    [
        (10, 110, True),
        (10, 140, True),
        (10, 200, False),  # 45 pairs of variables do not hold 100 edges
        (7, 110, False),  # at least 4 more than before
        (20, 110, True),
    ],
)
def test_a_prior_beside_more_measurements(densest, edges, is_prior):
    two = between(
        replace(GRAPH, densest=4.0),
        ({"num_edges": 100}, {"num_edges": edges}),
        measurements=950.0,
        densest=float(densest),
        **DENSER,
    )
    assert ("prior-densifies" in named(two)) == is_prior


def test_a_prior_in_the_place_of_its_factors_is_no_other_data():
    inputs = {"num_edges": 100}, {"num_edges": 60}
    assert named(between(GRAPH, inputs, measurements=600.0, **DENSER)) == ["prior-densifies"]


def test_a_sparser_matrix_is_no_prior():
    sparser = {"information_nonzeros": 5e3, "factor_nonzeros": 1e4, "factor_flops": 2e5}
    assert "prior-densifies" not in named(between(GRAPH, **sparser))


def test_a_prior_of_a_longer_window_is_no_cause():
    window = replace(FLIGHT, options={"window": 10}, prior_columns=10.0)
    assert named(between(window, prior_columns=20.0)) == ["prior-densifies"]
    assert named(between(window, prior_columns=20.0, options={"window": 20})) == []


@pytest.mark.parametrize(
    ("old", "new", "is_ordering"), [(1.2, 3.0, True), (2.0, 3.0, False), (1.2, 1.5, False)]
)
def test_flops_far_above_the_best_order_are_the_ordering(old, new, is_ordering):
    two = between(
        replace(GRAPH, factor_flops=old * 1e6, least_flops=1e6),
        information_nonzeros=1.05e4,
        factor_flops=new * 1.05e6,
        least_flops=1.05e6,
    )
    assert ("ordering" in named(two)) == is_ordering


def test_fill_compares_factors_of_one_solver():
    fill = {"information_nonzeros": 1.05e4, "measurements": 950.0, "factor_nonzeros": 4e4}
    assert "fill" in named(between(GRAPH, **fill))
    assert "fill" not in named(between(GRAPH, **fill, solver="ceres SPARSE_SCHUR"))


def test_fewer_steps_of_a_late_window_are_the_machine():
    fewer = {"steps": 5.0, "seconds": 0.9}
    assert named(between(FLIGHT, **fewer, warnings={"out of time": 3})) == ["machine"]
    assert named(between(FLIGHT, **fewer)) == ["convergence"]


def test_more_rejected_steps_from_another_start_are_no_jacobian():
    rejected = {"steps": 40.0, "rejected": 20.0}
    parts = {"structure": "1", "measurements": "2", "start": "3"}
    for start, cause in (("3", "jacobian"), ("4", "convergence")):
        inputs = {"digests": parts}, {"digests": parts | {"start": start}}
        assert named(between(GRAPH, inputs, **rejected)) == [cause]


@pytest.mark.parametrize("warnings", [{}, {"nullity": 3}])
def test_a_jacobian_is_told_by_its_steps_or_by_its_warnings(warnings):
    inputs = ({"digests": {"structure": "1", "measurements": "2", "start": "3"}},) * 2
    old = replace(GRAPH, start_gradient=5.0)
    two = between(old, inputs, steps=40.0, start_gradient=6.0, warnings=warnings)
    (cause,) = (one for one in causes_of(two) if one.cause == "jacobian")
    assert cause.evidence["warnings"] == list(warnings)
    assert ("gradient at the start" in cause.sentence) == (not warnings)
    assert ("gain information" in cause.sentence) == bool(warnings)


def test_another_gradient_of_the_same_residuals_is_the_jacobian():
    inputs = tuple({"digests": {"structure": "1", "measurements": "2", "start": one}}
                   for one in "34")  # fmt: skip
    same, old = inputs[:1] * 2, replace(GRAPH, start_gradient=5.0)
    slower = {"steps": 40.0, "start_gradient": 6.0}
    assert named(between(old, same, **slower)) == ["jacobian"]
    assert named(between(old, same, **slower | {"steps": 10.0})) == ["jacobian"]
    assert named(between(old, same, **slower | {"start_gradient": 5.0})) == ["convergence"]
    assert named(between(old, inputs, **slower)) == ["convergence"]
    assert named(between(old, same, **slower, initial_cost=1.1e3)) == ["data"]
    assert named(between(old, same, steps=10.0, least_radius=1e2)) == ["convergence"], "faster"


@pytest.mark.parametrize("is_slower", [True, False])
def test_a_warning_names_an_order_whose_flops_are_unknown(is_slower):
    options = (
        {"linear_solver_ordering": "POINTS_FIRST"},
        {"linear_solver_ordering": "CAMERAS_FIRST"},
    )
    old = replace(GRAPH, options=options[0])
    new = replace(GRAPH, options=options[1], factor_flops=None, warnings={"ordering": 1})
    pair = (old, new) if is_slower else (new, old)
    assert named(between(pair[0], **vars(pair[1]))) == ["ordering"]
    silent = replace(new, warnings={})
    assert named(between(old, **vars(silent))) == []
    assert named(between(replace(old, warnings={"ordering": 1}), **vars(new))) == []
    counted = causes_of(between(old, **vars(replace(new, factor_flops=3e6))))
    assert [cause.cause for cause in counted] == ["ordering"] and "3 times" in counted[0].sentence
    assert named(between(old, **vars(replace(new, options=options[0])))) == []


def test_an_option_that_ends_a_solve_early_is_named_with_it():
    old = replace(GRAPH, options={"max_num_iterations": 50})
    two = between(old, options={"max_num_iterations": 3}, steps=3.0, is_converged=False)
    assert named(two) == ["options", "convergence"]
    evidence = next(iter(causes_of(two))).evidence
    assert evidence == {"max_num_iterations": {"old": 50, "new": 3}}
