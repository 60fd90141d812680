"""Rates of a made-up machine, so that no test waits for a calibration or depends on this one."""

from __future__ import annotations

import pytest

from bundle.planning.inspection import (
    elimination_costs,
    factor_graph_time,
    graph_rates,
    problem_inspection,
)
from bundle.planning.inspection.rates import FactorRate, Rates

CORE = FactorRate(flops_per_second=1e10, seconds_per_entry=1e-9)

RATES = Rates(
    num_threads=1,
    dense=CORE,
    dense_threaded=FactorRate(flops_per_second=2e10, seconds_per_entry=1e-9),
    sparse=FactorRate(flops_per_second=1e10, seconds_per_entry=1e-8),
    reduced_bytes_per_second=1e10,
    fused_step=1e-5,
    fused_observation=1e-7,
    fused_pair=1e-8,
    fused_scattered_pair=3e-7,
    ceres_step=1e-4,
    ceres_evaluation=5e-7,
    ceres_elimination=5e-7,
    ceres_pair=2e-8,
    ceres_dynamic_pair=5e-8,
    ceres_reduced_value=1e-7,
    ceres_product=3e-8,
    ceres_normal_entry=1e-8,
)
FACTOR_GRAPH_SECONDS = {name: 1e-9 * (k + 1) for k, name in enumerate(factor_graph_time.FEATURES)}


def predict_for_it(patch: pytest.MonkeyPatch) -> None:
    """Let predictions of problems, pose graphs and factor graphs be those for this machine."""
    seconds = dict.fromkeys(graph_rates.FEATURES, 1e-9)

    def of_pose_graphs(num_threads: int, **_: object) -> graph_rates.GraphRates:
        return graph_rates.GraphRates(num_threads=num_threads, seconds=seconds)

    patch.setattr(problem_inspection, "machine_rates", lambda *_, **__: RATES)
    patch.setattr(elimination_costs, "graph_rates", of_pose_graphs)
    patch.setattr(elimination_costs, "factor_graph_rates", lambda **_: FACTOR_GRAPH_SECONDS)
