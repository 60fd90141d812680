"""The verdict on predicted steps of pose graphs, and one small graph."""

import math

from benchmarks.graph_predictions import Row, verdict

from benchmarks import graph_predictions
from bundle.planning.inspection.pose_graph_time import made_graph
from tests.made_up_machine import predict_for_it


def row(predicted, measured):
    return Row("some", "amd", predicted, measured)


def test_the_share_within_the_factor_decides():
    near = [row(1.0, 1.2)] * 9
    assert "9 of 10" in verdict([*near, row(1.0, 2.0)]) and "met" in verdict([*near, row(1.0, 2)])
    assert "missed" in verdict([*near[:8], row(1.0, 2.0)])
    assert "1 long steps not solved" in verdict([*near, row(99.0, math.nan)])
    assert verdict([row(99.0, math.nan)]) == "No step was measured."


def test_a_graph_has_a_row_per_order(monkeypatch):
    predict_for_it(monkeypatch)
    rows = graph_predictions.rows_of("loops", made_graph("loops", 150, 3, seed=4), 1)
    assert [one.ordering for one in rows] == ["natural", "amd", "metis"]
    assert all(one.predicted > 0 and one.measured > 0 for one in rows)
    names = [name for name, _ in graph_predictions.graphs(few=True)]
    assert len(names) == 3 + 30
    left = [name for name, _ in graph_predictions.graphs(few=True, known=names[1:])]
    assert left == names[:1]


def test_slices_continue_after_the_rows_of_a_file(tmp_path, monkeypatch, capsys):
    measured = []
    monkeypatch.setattr(
        graph_predictions, "pose_graph_rates", lambda *_, **how: measured.append(how)
    )
    monkeypatch.setattr(
        graph_predictions,
        "graphs",
        lambda known, **_: ((n, lambda: None) for n in "abc" if n not in known),
    )
    monkeypatch.setattr(graph_predictions, "rows_of", lambda name, *_: [Row(name, "amd", 1.0, 1.1)])
    path = tmp_path / "rows.json"
    words = ["--json", str(path), "--resume"]
    clock = iter(range(100))
    monkeypatch.setattr(graph_predictions.time, "perf_counter", lambda: next(clock))
    graph_predictions.main([*words, "--seconds", "1"])
    assert "2 of 3 graphs are left" in capsys.readouterr().out
    graph_predictions.main(words)
    assert "3 of 3 predictions" in capsys.readouterr().out
    assert measured == [{"recalibrate": True}, {"recalibrate": False}]
