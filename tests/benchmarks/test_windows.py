"""The batch of the window benchmark has one minimum for both solvers."""

from __future__ import annotations

import pytest

from benchmarks import windows


@pytest.mark.usefixtures("bundle_data")
def test_both_have_the_same_factors() -> None:
    gtsam = pytest.importorskip("gtsam")
    assert gtsam
    window, arrays = windows.batch()
    graph, values = windows.gtsam_problem(window, arrays)
    _, ours, steps = windows.by_bundle(arrays)
    _, theirs, _ = windows.by_gtsam(graph, values)
    assert steps > 3
    # GTSAM stops a little above the minimum, which is ours.
    assert ours == pytest.approx(theirs, rel=0.01)
    assert ours < theirs
