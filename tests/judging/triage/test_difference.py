"""Limits of noise: facts of two solves just within and just beyond them."""

from dataclasses import replace

import pytest

from bundle.interface.judging_options import TriageOptions
from bundle.judging.triage.difference import Difference, SolveFacts, solve_facts

GRAPH = SolveFacts(
    solver="fused SPARSE_SCHUR",
    columns=600.0,
    measurements=900.0,
    information_nonzeros=1e4,
    factor_nonzeros=2e4,
    factor_flops=1e6,
    initial_cost=1e3,
    final_cost=10.0,
    steps=20.0,
    rejected=0.0,
    least_radius=1e4,
    seconds=1.0,
    num_threads=2,
    error=1.0,
)
FLIGHT = replace(GRAPH, initial_cost=None)
LATE = replace(FLIGHT, warnings={"out of time": 1})
LIMITS = TriageOptions(cost_noise=1e-3, step_noise=0.5, time_noise=2.0)


def between(old, inputs=({}, {}), environments=({}, {}), **new):
    """Return the difference of two solves, the second with some other facts."""
    return Difference(old, replace(old, **new), inputs, environments, LIMITS)


@pytest.mark.parametrize(
    ("quantity", "old", "fact", "noise", "change"),
    [
        ("factor_changed", GRAPH, "factor_flops", 1.05e6, 1.2e6),
        ("factor_changed", GRAPH, "factor_nonzeros", 2.06e4, 2.4e4),
        ("information_changed", GRAPH, "information_nonzeros", 1.005e4, 1.03e4),
        ("cost_changed", GRAPH, "final_cost", 10.005, 10.02),
        ("cost_changed", FLIGHT, "final_cost", 10.05, 10.2),
        ("cost_changed", LATE, "final_cost", 10.5, 12.0),
        ("cost_changed", replace(GRAPH, final_cost=1e-12), "final_cost", 5e-10, 1e-8),
        ("cost_changed", GRAPH, "error", 1.05, 1.5),
        ("steps_changed", GRAPH, "steps", 29.0, 31.0),
        ("steps_changed", replace(GRAPH, steps=31.0), "steps", 22.0, 20.0),
        ("steps_changed", replace(GRAPH, steps=2.0), "steps", 4.0, 5.0),
        ("has_other_gradient", replace(GRAPH, start_gradient=5.0), "start_gradient", 4.996, 4.99),
        ("radius_fell", GRAPH, "least_radius", 3e3, 1e3),
        ("radius_fell", GRAPH, "rejected", 2.0, 5.0),
    ],
)
def test_a_fact_changes_beyond_its_noise(quantity, old, fact, noise, change):
    assert not getattr(between(old, **{fact: noise}), quantity)
    assert getattr(between(old, **{fact: change}), quantity)


@pytest.mark.parametrize(("fact", "noise", "change"), [
    ("factor_flops", 1.5e6, 1.7e6), ("factor_nonzeros", 2.5e4, 2.7e4),
])  # fmt: skip
def test_a_factor_of_permuted_variables_varies_more(fact, noise, change):
    inputs = tuple({"digests": {"structure": one}} for one in "12")
    assert not between(GRAPH, inputs, **{fact: noise}).factor_changed
    assert between(GRAPH, inputs, **{fact: change}).factor_changed
    assert between(GRAPH, inputs[:1] * 2, **{fact: noise}).factor_changed
    assert between(GRAPH, inputs, **{fact: noise}, columns=603.0).factor_changed
    assert between(GRAPH, inputs, **{fact: noise}, information_nonzeros=1.1e4).factor_changed


@pytest.mark.parametrize(("old", "new", "pair"), [
    ({}, {"num_rounds": 2}, (None, 2)), ({"gps": "exif"}, {}, ("exif", None)),
    ({"loss": "CAUCHY"}, {"loss": "TRIVIAL"}, ("CAUCHY", "TRIVIAL")),
])  # fmt: skip
def test_an_option_of_one_report_only_differs(old, new, pair):
    two = between(replace(GRAPH, options=old | {"num_threads": 1}), options=new)
    assert list(two.options.values()) == [pair]


def test_an_unknown_gradient_is_no_other_one():
    assert not between(GRAPH, start_gradient=5.0).has_other_gradient
    assert facts([True, True], [1e4, 1e4]).start_gradient is None
    iterations = [{"step_is_successful": True, "gradient_max_norm": size} for size in (5.0, 1e-3)]
    assert solve_facts({}, SUMMARY, iterations, {}).start_gradient == 5.0


def test_costs_at_one_start_agree_to_rounding():
    for sign in (1, -1):
        assert between(GRAPH, initial_cost=1e3 + sign * 0.99e-3).is_same_start_cost
        assert not between(GRAPH, initial_cost=1e3 + sign * 1.01e-3).is_same_start_cost
    for old, new in ((None, 1.0), (1.0, None)):  # unknown
        assert between(replace(GRAPH, initial_cost=old), initial_cost=new).is_same_start_cost


OTHER_HOST = ({"cpu_model": "a"}, {"cpu_model": "b"})


@pytest.mark.parametrize(
    ("old", "environments", "noise", "change"),
    [
        (1.0, ({}, {}), {"seconds": 1.9}, {"seconds": 2.1}),
        (0.01, ({}, {}), {"seconds": 0.035}, {"seconds": 0.05}),  # 20 ms of the scheduler
        (1.0, OTHER_HOST, {"seconds": 2.5}, {"seconds": 4.0}),
        (1.0, ({}, {}), {"seconds": 0.3, "steps": 10.0}, {"seconds": 0.2, "steps": 10.0}),
        (1.0, ({}, {}), {"seconds": 5.0, "steps": 60.0}, {"seconds": 7.0, "steps": 60.0}),
    ],
)
def test_a_time_beyond_steps_and_noise(old, environments, noise, change):
    base = replace(GRAPH, seconds=old)
    assert between(base, environments=environments, **noise).time_excess is None
    assert between(base, environments=environments, **change).time_excess is not None


def test_a_warning_of_both_solves_is_not_new():
    kinds = ("nullity", "out of time")
    assert between(GRAPH, warnings={"nullity": 2}).new_warnings(kinds) == ["nullity"]
    assert between(LATE).new_warnings(kinds) == []


SUMMARY = {
    "backend_used": "fused",
    "linear_solver_type_used": "SPARSE_SCHUR",
    "num_successful_steps": 2,
    "num_unsuccessful_steps": 1,
    "termination_type": "CONVERGENCE",
    "is_solution_usable": True,
    "num_threads_used": 2,
    "warning_kinds": [],
}


def facts(accepted, radii, environment=None, **summary):
    """Return the facts of a solve with these iterations."""
    iterations = [
        {"step_is_successful": good, "trust_region_radius": radius}
        for good, radius in zip(accepted, radii, strict=True)
    ]
    return solve_facts({}, {**SUMMARY, **summary}, iterations, {}, environment=environment)


def test_steps_of_a_solve_with_and_without_its_iterations():
    found = facts([True, True, False], [1e4, 3e4, 1e-3])
    assert (found.steps, found.rejected) == (2.0, 1.0)
    assert found.least_radius == 1e4  # the last radius belongs to no step
    counts = {"num_successful_steps": 1, "num_unsuccessful_steps": 0}
    found = facts([True, False, False], [1e4, 1e3, 1e2], **counts)
    assert (found.steps, found.rejected) == (2.0, 2.0)
    found = facts([], [], num_successful_steps=5, num_unsuccessful_steps=3)
    assert (found.steps, found.rejected, found.least_radius) == (7.0, 3.0, None)


def test_preemptions_are_time_slices():
    assert facts([True], [1e4], {"preemptions": 100}).waiting == 0.5
    assert facts([True], [1e4], {"preemptions": 100, "waiting": 2.0}).waiting == 2.0
