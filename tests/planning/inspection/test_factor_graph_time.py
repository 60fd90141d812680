"""Predicted steps of factor graphs: work of the factors, terms of a step, failures, the cache."""

from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.planning.inspection import factor_graph_time
from bundle.planning.inspection.factor_graph_time import FEATURES, factor_work, step_terms
from bundle.planning.inspection.machine_rates import Rates
from tests.made_up_machine import FACTOR_GRAPH_RATES


def landmarks(values):
    pose, point = values
    c, s = np.cos(pose[2]), np.sin(pose[2])
    back = np.array([[c, s], [-s, c]])
    seen = back @ (point - pose[:2])
    return seen, [np.c_[-np.eye(2), [seen[1], -seen[0]]], back]


def mixed_graph(function=landmarks):
    """Poses on a path, of which the first is constant, and landmarks that a function relates."""
    graph = bundle.FactorGraph()
    rng = np.random.default_rng(4)
    for k in range(6):
        graph.add_variable(f"x{k}", [k, 0.1, 0.2], "se2", fixed=k == 0)
    for k in range(4):
        graph.add_variable(f"l{k}", [k, 2.0], fixed=[0] if k == 3 else False)
    for k in range(5):
        graph.add_factor(bundle.BetweenFactor(f"x{k}", f"x{k + 1}", [1, 0.1, 0], information=9))
    for k in range(6):
        for j in rng.choice(4, 2, replace=False):
            graph.add_factor(bundle.FunctionFactor([f"x{k}", f"l{j}"], function))
    graph.add_factor(bundle.PriorFactor("x0", [0, 0, 0], 1))  # of a constant variable
    return graph


def test_the_work_of_factors_is_that_of_their_jacobians(monkeypatch):
    monkeypatch.setattr(factor_graph_time, "MOST_SECONDS", np.inf)  # also on a busy machine
    graph = mixed_graph()
    work = factor_work(graph)
    free = {key: len(v.coordinates) - sum(v.held) for key, v in graph.variables.items()}
    rows = entries = products = flops = 0
    for factor in graph.factors:
        sizes = [free[key] for key in factor.keys if free[key]]
        size = 3 if isinstance(factor, bundle.BetweenFactor) else 2
        if sizes:
            rows += size
            entries += size * sum(sizes)
            products += len(sizes) * (len(sizes) + 1) / 2
            flops += size * sum(sizes) ** 2
    assert (work.rows, work.entries, work.block_products, work.product_flops) == (
        (rows, entries, products, flops)
    )  # fmt: skip
    assert 0 < work.in_python < work.evaluation


def test_the_time_of_a_sample_counts_for_all_factors_of_its_kind(monkeypatch):
    samples = []

    def step(_graph, factors, **_):
        samples.append(len(factors))
        is_slow = factors[0].kind == "function"
        each = 5e-3 if is_slow else 1e-6
        return factor_graph_time._Step(each * len(factors), 0.0, 2 * len(factors))

    monkeypatch.setattr(factor_graph_time, "_step", step)
    graph = bundle.FactorGraph()
    for k in range(3000):
        graph.add_variable(k, [0.0])
        graph.add_factor(bundle.PriorFactor(k, [1.0], 1))
    for k in range(40):
        graph.add_factor(bundle.FunctionFactor([k], lambda v: (v[0], [np.eye(1)])))
    work = factor_work(graph)
    np.testing.assert_allclose(work.in_python, 40 * 5e-3)
    np.testing.assert_allclose(work.evaluation, 40 * 5e-3 + 3000 * 1e-6)
    # quick factors are timed in large samples, slow ones in small samples
    assert max(samples) == 3000 and set(samples) == {16, 3000}


def test_a_sample_counts_by_its_shortest_time(monkeypatch):
    clock = iter(range(1, 100))
    monkeypatch.setattr(
        factor_graph_time,
        "_step",
        lambda _graph, factors, **_: factor_graph_time._Step(next(clock) * len(factors), 0.0, 1),
    )
    graph = bundle.FactorGraph()
    graph.add_variable(0, [0.0])
    graph.add_factor(bundle.PriorFactor(0, [1.0], 1))
    assert factor_work(graph).evaluation == 1


def solved(monkeypatch, **changes):
    """A step of three iterations after the start, with the times of a solve as given."""
    summary = {
        "interrupted": False,
        "jacobian_evaluation_time_in_seconds": 8.0,
        "num_jacobian_evaluations": 4,
        "residual_evaluation_time_in_seconds": 3.0,
        "num_residual_evaluations": 6,
        "num_residuals": 7,
    }
    output = {
        "summary": summary | changes,
        "iterations": {"iteration_time_in_seconds": [100.0, 5.0, 6.0, 7.0]},
    }
    core = SimpleNamespace(solve_graph=lambda *_: output)
    monkeypatch.setattr(factor_graph_time, "_core", core)
    graph = mixed_graph()
    return factor_graph_time._step(graph, graph.factors, steps=3)


def test_a_step_is_its_evaluations_and_the_rest(monkeypatch):
    # The first of 4 Jacobians belongs to the start, whose 100 s do not count either.
    step = solved(monkeypatch)
    assert step == (8 / 4 + 3 / 6, (5 + 6 + 7 - 3 - 3 * 2) / 3, 7)
    unmeasured = {"residual_evaluation_time_in_seconds": -1.0, "num_residual_evaluations": 0}
    assert solved(monkeypatch, **unmeasured) == (2 * 8 / 4, (5 + 6 + 7 - 3 * 2) / 3, 7)
    with pytest.raises(KeyboardInterrupt):
        solved(monkeypatch, interrupted=True)


def test_kinds_beyond_the_time_limit_take_the_mean(monkeypatch):
    monkeypatch.setattr(factor_graph_time, "MOST_SECONDS", 0.0)
    monkeypatch.setattr(
        factor_graph_time,
        "_step",
        lambda _graph, factors, **_: factor_graph_time._Step(1e-3 * len(factors), 0.0, 7),
    )
    work = factor_work(mixed_graph())
    np.testing.assert_allclose(work.evaluation, 17e-3)


def test_terms_add_up_and_functions_in_python_take_one_thread():
    graph = mixed_graph()
    work = factor_work(graph)
    counts = {"entries": 100, "cholmod_flops": 1000}
    one, two = (step_terms(FACTOR_GRAPH_RATES, work, counts, n) for n in (1, 2))
    assert one == two and one["factors"] == work.evaluation
    plain = step_terms(FACTOR_GRAPH_RATES, work._replace(in_python=0.0), counts, 2)
    assert plain["factors"] == work.evaluation / 2
    seconds = FACTOR_GRAPH_RATES.seconds
    assert one["factorisation"] == pytest.approx(100 * seconds["value"] + 1000 * seconds["flop"])
    panels = step_terms(FACTOR_GRAPH_RATES, work, {"entries": 100, "cholmod_flops": 4000}, 1)
    assert panels["factorisation"] == pytest.approx(
        100 * seconds["panel_value"] + 4000 * seconds["panel_flop"]
    )
    dense = step_terms(FACTOR_GRAPH_RATES, work, {"columns": 30}, 1)
    assert dense["factorisation"] == pytest.approx(seconds["dense_flop"] * (work.rows * 900 + 9000))
    assert dense["normal equations"] == pytest.approx(
        seconds["dense_entry"] * (work.rows + 30) * 30
    )


def test_every_order_of_a_factor_graph_has_a_time():
    found = bundle.inspect(mixed_graph(), num_threads=1)
    assert found.num_threads == 1
    for cost in found.costs:
        assert sum(cost.time_terms.values()) == cost.time_per_step_in_seconds > 0
    assert "per step" in str(found)


def test_a_function_that_fails_leaves_the_structure_without_times():
    def broken(_):
        raise RuntimeError("no connection")

    found = bundle.inspect(mixed_graph(broken))
    whole = bundle.inspect(mixed_graph())
    assert all(np.isnan(cost.time_per_step_in_seconds) for cost in found.costs)
    assert [cost.flops for cost in found.costs] == [cost.flops for cost in whole.costs]


def test_a_calibration_has_all_rates(monkeypatch):
    cases = [("chain", 12, 3), ("grid", 40, 3), ("grid", 100, 6)]
    monkeypatch.setattr(factor_graph_time, "CASES", cases)
    seconds = factor_graph_time.calibrate(1).seconds
    assert set(seconds) == set(FEATURES)
    assert all(np.isfinite(value) and value >= 0 for value in seconds.values())
    assert max(seconds.values()) > 0


def test_a_calibration_fits_the_counts_of_each_system(monkeypatch):
    """Sparse and, if small, dense."""
    fitted = []
    monkeypatch.setattr(factor_graph_time, "CASES", [("chain", 5, 3), ("chain", 9, 6)])
    monkeypatch.setattr(factor_graph_time, "MOST_DENSE_COLUMNS", 12)
    monkeypatch.setattr(
        factor_graph_time,
        "_step",
        lambda graph, factors, dense=False, **_: factor_graph_time._Step(
            1.0, 7.0 if dense else len(graph.variables) - 5.0, 3 * len(factors)
        ),
    )
    monkeypatch.setattr(
        factor_graph_time,
        "fitted",
        lambda _features, count, solves: (
            fitted.append(solves) or Rates(num_threads=count, seconds={})
        ),
    )
    factor_graph_time.calibrate(1)
    (((_, small_time), (of_dense, dense_time), (of_sparse, sparse_time)),) = fitted
    assert (small_time, dense_time, sparse_time) == (0.0, 7.0, 4.0)  # 5, 5 and 9 poses
    assert (of_dense["other"], of_sparse["other"]) == ({"dense_step": 1}, {"step": 1})
    n, m = 3 * 4, 3 * 4  # free coordinates, residuals
    assert of_dense["factorisation"]["dense_flop"] == m * n**2 + n**3 / 3


def test_a_comparison_states_the_predicted_steps():
    found = bundle.compare(mixed_graph(), repeat=1, threads=(1,))
    predicted = {run.method.name: run.predicted_time_per_step_in_seconds for run in found.runs}
    assert predicted["sparse-normal-cholesky levenberg-marquardt"] > 0
    assert predicted["dense-normal-cholesky levenberg-marquardt"] > 0
    assert np.isnan(predicted["sparse-normal-cholesky dogleg"])
    assert np.isnan(predicted["square-root levenberg-marquardt"])
