"""Rates of a made-up machine, so that no test waits for a calibration or depends on this one."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import bundle._core as _core
from bundle.base.paths import write_cached
from bundle.planning.inspection import (
    elimination_costs,
    factor_graph_time,
    pose_graph_time,
    problem_inspection,
)
from bundle.planning.inspection.machine_rates import Rates, cache_path

SECONDS = {
    "flop": 1e-10,
    "threaded_flop": 5e-11,
    "dense_entry": 1e-9,
    "threaded_entry": 1e-9,
    "sparse_entry": 1e-8,
    "reduced_byte": 1e-10,
    "fused_step": 1e-5,
    "fused_observation": 1e-7,
    "fused_pair": 1e-8,
    "fused_scattered_pair": 3e-7,
    "ceres_step": 1e-4,
    "ceres_evaluation": 5e-7,
    "ceres_elimination": 5e-7,
    "ceres_pair": 2e-8,
    "ceres_dynamic_pair": 5e-8,
    "ceres_reduced_value": 1e-7,
    "ceres_product": 3e-8,
    "ceres_normal_entry": 1e-8,
}
RATES = Rates(num_threads=1, seconds=SECONDS)
POSE_GRAPH_SECONDS = dict.fromkeys(pose_graph_time.FEATURES, 1e-9)
FACTOR_GRAPH_RATES = Rates(
    num_threads=1,
    seconds={name: 1e-9 * (k + 1) for k, name in enumerate(factor_graph_time.FEATURES)},
)


def predict_for_it(patch: pytest.MonkeyPatch) -> None:
    """Let predictions of problems, pose graphs and factor graphs be those for this machine."""

    def of_pose_graphs(num_threads: int, **_: object) -> Rates:
        return Rates(num_threads=num_threads, seconds=POSE_GRAPH_SECONDS)

    patch.setattr(problem_inspection, "problem_rates", lambda *_, **__: RATES)
    patch.setattr(elimination_costs, "pose_graph_rates", of_pose_graphs)
    patch.setattr(elimination_costs, "factor_graph_rates", lambda **_: FACTOR_GRAPH_RATES)


@functools.cache
def cache() -> TemporaryDirectory[str]:
    """Return a folder, XDG_CACHE_HOME of processes of their own, that has these rates."""
    folder = TemporaryDirectory(prefix="bundle-cache-")
    every = {"problem": SECONDS, "pose-graph": POSE_GRAPH_SECONDS}
    tables = {(t, n): every[t] for t in every for n in {1, _core.hardware_threads()}}
    tables |= {("factor-graph", 1): FACTOR_GRAPH_RATES.seconds}
    for (table, num_threads), seconds in tables.items():
        rates = Rates(num_threads=num_threads, seconds=seconds)
        path = Path(folder.name) / "bundle" / cache_path(table, num_threads).name
        write_cached(path, json.dumps(dataclasses.asdict(rates)))
    return folder
