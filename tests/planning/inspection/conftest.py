"""Rates of a made-up machine, so that no test waits for a calibration or depends on this one."""

from __future__ import annotations

import pytest

from bundle.planning.inspection import elimination_costs, graph_rates, problem_inspection
from bundle.planning.inspection.factor_graph_time import FEATURES
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


@pytest.fixture
def factor_graph_seconds(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Let predictions of factor graphs be those for a made-up machine."""
    seconds = {name: 1e-9 * (k + 1) for k, name in enumerate(FEATURES)}
    monkeypatch.setattr(elimination_costs, "factor_graph_rates", lambda **_: seconds)
    return seconds


@pytest.fixture
def pose_graph_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let predictions of pose graphs be those for a made-up machine."""
    seconds = dict.fromkeys(graph_rates.FEATURES, 1e-9)

    def made_up(num_threads: int, **_: object) -> graph_rates.GraphRates:
        return graph_rates.GraphRates(num_threads=num_threads, seconds=seconds)

    monkeypatch.setattr(elimination_costs, "graph_rates", made_up)


@pytest.fixture
def rates(monkeypatch: pytest.MonkeyPatch) -> Rates:
    """Let predictions be those for a made-up machine."""
    monkeypatch.setattr(problem_inspection, "machine_rates", lambda *_, **__: RATES)
    return RATES
