"""The verdict on predicted steps of pose graphs, and one small graph."""

import math

from benchmarks.graph_predictions import Row, verdict

from benchmarks import graph_predictions
from bundle.planning.inspection.graph_rates import made_graph


def row(predicted, measured):
    return Row("some", "amd", predicted, measured)


def test_the_share_within_the_factor_decides():
    near = [row(1.0, 1.2)] * 9
    assert "9 of 10" in verdict([*near, row(1.0, 2.0)]) and "met" in verdict([*near, row(1.0, 2)])
    assert "missed" in verdict([*near[:8], row(1.0, 2.0)])
    assert "1 steps not solved" in verdict([*near, row(99.0, math.nan)])
    assert verdict([row(99.0, math.nan)]) == "No step was measured."


def test_a_graph_has_a_row_per_order():
    rows = graph_predictions.rows_of("loops", made_graph("loops", 150, 3, seed=4), 1)
    assert [one.ordering for one in rows] == ["natural", "amd", "metis"]
    assert all(one.predicted > 0 and one.measured > 0 for one in rows)
    assert len([*graph_predictions.graphs(few=True)]) == 3 + 30
