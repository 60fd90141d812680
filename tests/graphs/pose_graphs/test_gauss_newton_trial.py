"""Trials of plain Gauss-Newton steps after a rejected step."""

import numpy as np
import pytest

import bundle
from bundle.errors import InputError
from tests.graphs.pose_graphs import graphs


def hard(dimension, seed):
    """A graph far from its minimum, with long paths between few closures."""
    return graphs.loop(
        dimension, num_poses=60, num_closures=3, noise=0.08, start_noise=1.5, seed=seed
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_successful_steps_never_raise_the_cost(dimension):
    trials = kept = 0
    for seed in range(40):
        result = bundle.solve(hard(dimension, seed), init="file", max_num_iterations=200)
        table, summary = result.iterations, result.summary
        taken = table["cost"][table["step_is_successful"].astype(bool)]
        assert (np.diff(taken) <= 1e-12 * taken[0]).all()
        assert summary.final_cost == pytest.approx(taken[-1], rel=1e-12)
        chi2 = bundle.pose_graph_chi2(result.problem).sum()
        assert summary.final_cost == pytest.approx(0.5 * chi2, rel=1e-9)
        count = len(table["cost"])
        assert summary.num_successful_steps + summary.num_unsuccessful_steps == count
        assert table["iteration"].tolist() == list(range(count))
        rejected = np.flatnonzero(~table["step_is_successful"].astype(bool))
        if len(rejected) and table["trust_region_radius"][rejected[0]] > 1e12:
            trials += 1
            kept += table["trust_region_radius"][rejected[0] + 1 :].min() > 1e7
    assert trials >= 5
    assert kept >= 1 or dimension == 3  # a trial that ended lower


def test_a_trial_needs_few_systems_where_small_steps_need_many(bundle_data):
    graph = bundle.load(bundle_data / "g2o/MIT.g2o.bz2")
    summary = bundle.solve(graph, function_tolerance=1e-6).summary
    assert summary.chi2_final == pytest.approx(41.2069, abs=1e-3)
    assert summary.num_linear_solves <= 8 and summary.warnings == ()


def test_the_callback_can_stop_a_trial():
    for seed in range(40):
        graph = hard(2, seed)
        whole = bundle.solve(graph, init="file")
        count = len(whole.iterations["cost"])
        for stop in range(1, min(count, 9)):

            def raises(record, stop=stop):
                if record["iteration"] == stop:
                    raise InputError("stop")

            with pytest.raises(InputError, match="stop"):
                bundle.solve(graph, init="file", progress=raises)
        limited = bundle.solve(graph, init="file", max_num_iterations=3)
        assert len(limited.iterations["cost"]) <= 4
        first = limited.iterations["cost"][0]
        assert limited.summary.final_cost <= first
