"""The batch of the window benchmark has the same factors for both solvers."""

from __future__ import annotations

import pytest

from benchmarks import windows
from bundle import _core


@pytest.mark.usefixtures("bundle_data")
def test_both_have_the_same_factors() -> None:
    """GTSAM's cost of our minimum is ours; from the start it may end in one that is higher."""
    gtsam = pytest.importorskip("gtsam")
    assert gtsam
    window, arrays = windows.batch()
    solved = _core.solve_window(arrays, windows.OPTIONS, None)
    ours = sum(solved["costs_after"].values())
    end = {name: solved[name] for name in ("states", "points")}
    graph, values = windows.gtsam_problem(window, arrays | end)
    assert solved["num_iterations"] > 3
    # Its priors stand at the states that they are made of.
    without_prior = ours - solved["costs_after"]["prior"]
    assert graph.error(values) == pytest.approx(without_prior, rel=1e-3)
    start_graph, start = windows.gtsam_problem(window, arrays)
    assert start_graph.error(start) == pytest.approx(
        sum(_core.solve_window(arrays, windows.OPTIONS | {"max_num_iterations": 0}, None)[
            "costs_after"
        ].values()),
        rel=1e-3,
    )  # fmt: skip
    assert ours < windows.by_gtsam(start_graph, start)[1]
