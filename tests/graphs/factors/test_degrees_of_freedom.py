"""chi2 of a solved graph per degree of freedom: where it has an expectation, and its numbers."""

from __future__ import annotations

import numpy as np
import pytest

import bundle

NUM_POSES = 30
LOOPS = [(i, i + 4) for i in range(0, 25, 2)]


def chain(manifold="se2", *, prior=True, first=False, noise=1.0, scale=1.0, **last):
    """Return poses on a line with loops; errors of ``noise`` times a sigma of 0.1, or scaled."""
    rng = np.random.default_rng(7)
    size = {"se2": 3, "se3": 6}[manifold]
    tail = [0.0, 0.0]
    head = [] if manifold == "se2" else [0.0, 0.0, 0.0, 1.0]
    graph = bundle.FactorGraph()
    for i in range(NUM_POSES):
        fixed = first and i == 0
        graph.add_variable(i, [*head, float(i), *tail], manifold=manifold, fixed=fixed)
    if prior:
        graph.add_factor(bundle.PriorFactor(0, [*head, 0.0, *tail], information=1e4))
    edges = [(i, i + 1) for i in range(NUM_POSES - 1)] + LOOPS
    for a, b in edges:
        error = 0.1 * noise * rng.standard_normal(size)
        value = np.array([*head, float(b - a), *tail])
        if manifold == "se2":
            value += error
        else:
            half = error[:3] / 2
            value[:4] = np.array([*half, 1.0]) / np.sqrt(1 + half @ half)
            value[4:] += error[3:]
        more = last if (a, b) == edges[-1] else {}
        graph.add_factor(bundle.BetweenFactor(a, b, value, information=100 * scale, **more))
    return graph


@pytest.mark.parametrize(("manifold", "size"), [("se2", 3), ("se3", 6)])
@pytest.mark.parametrize("square_root", [False, True])
def test_chi2_is_stated_per_degree_of_freedom(manifold, size, square_root):
    graph = chain(manifold)
    solved = graph.solve(square_root=square_root, function_tolerance=1e-12)
    assert solved.degrees_of_freedom == size * len(LOOPS)
    last = bundle.chi2_kinds(graph.with_values(solved.values))[-1]
    assert last.degrees == pytest.approx(solved.degrees_of_freedom)
    ends = [one / solved.degrees_of_freedom for one in (last.low, last.high)]
    ratio = 2 * solved.summary.final_cost / solved.degrees_of_freedom
    assert ends[0] < ratio < ends[1]
    said = f"{ratio:.4g} per degree of freedom (expected {ends[0]:.4g} to {ends[1]:.4g})"
    assert said in repr(solved)


def test_wrong_information_is_outside_of_the_expectation():
    solved = chain(scale=25.0).solve()
    degrees = solved.degrees_of_freedom
    assert 2 * solved.summary.final_cost / degrees > 10
    assert "per degree of freedom (expected " in repr(solved)


def test_constant_coordinates_are_no_unknowns():
    assert chain(prior=False, first=True).solve().degrees_of_freedom == 3 * len(LOOPS)


@pytest.mark.parametrize("case", ["loss", "bounds", "function", "free", "free and unchecked"])
def test_without_an_expectation_nothing_is_said(case):
    graph = chain(prior="free" not in case, **({"loss": "huber"} if case == "loss" else {}))
    if case == "bounds":
        graph.add_variable("x", [0.5], lower=[0.0], upper=[1.0])
        graph.add_factor(bundle.PriorFactor("x", [0.4], information=1.0))
    if case == "function":
        graph.add_factor(bundle.FunctionFactor([0], lambda x: (x[0][:1], [np.eye(3)[:1]])))
    solved = graph.solve(check_solution="unchecked" not in case)
    assert solved.degrees_of_freedom is None
    assert "degree of freedom" not in repr(solved)


def test_a_graph_without_redundancy_has_no_ratio():
    graph = bundle.FactorGraph()
    graph.add_variable(0, [0.0])
    graph.add_factor(bundle.PriorFactor(0, [1.0], information=1.0))
    solved = graph.solve()
    assert solved.degrees_of_freedom == 0
    assert "chi2" not in repr(solved)
