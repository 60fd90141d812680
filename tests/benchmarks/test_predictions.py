"""Marks in the table of predictions against measurements."""

from __future__ import annotations

import pytest
from benchmarks.predictions import Row, line, off, verdict

from benchmarks import predictions


def row(method="fused dense-schur", *, nnz=(10, 10), memory=(1e6, 1e6), seconds=(1.0, 1.0)):
    return Row(problem="some", method=method, nnz_factor=nnz, memory=memory, seconds=seconds)


@pytest.mark.parametrize(
    ("changes", "misses"),
    [
        ({}, ()),
        ({"nnz": (10, 11)}, ("nonzeros",)),
        ({"nnz": (10, None)}, ()),
        ({"memory": (1.24, 1.0)}, ()),
        ({"memory": (1.26, 1.0)}, ("memory",)),
        ({"memory": (1.0, 1.26)}, ("memory",)),
        ({"seconds": (1.99, 1.0)}, ()),
        ({"seconds": (1.0, 2.01)}, ("time",)),
        ({"nnz": (1, 2), "memory": (3, 1), "seconds": (9, 1)}, ("nonzeros", "memory", "time")),
        ({"method": "ceres iterative-schur", "seconds": (9, 1)}, ()),
    ],
)
def test_misses(changes, misses):
    assert row(**changes).misses == misses


def test_a_failed_solve_is_a_row_that_is_not_judged():
    failed = predictions._row("some", "fused dense-schur", {"memory": 9e12}, {"failure": "too big"})
    assert failed.misses == ()
    assert "9000000.0 MB" in line(failed)
    assert line(failed).endswith("| too big |")
    assert verdict([failed, row()]).startswith("Direct solves: 1; predictions off: 0 in nonzeros")


def test_verdict():
    rows = [row(), row(seconds=(9, 1)), row("fused iterative-schur", seconds=(9, 1))]
    assert verdict(rows) == (
        "Direct solves: 2; predictions off: 0 in nonzeros, 0 in memory, 1 in time."
    )


def test_off():
    assert off((2.0, 1.0)) == off((1.0, 2.0)) == 2.0
    assert off((None, 1.0)) == off((1.0, None)) == 1.0


def test_medians_of_the_runs_that_succeeded():
    runs = [{"seconds": 3.0, "memory": None}, {"failure": "no"}, {"seconds": 1.0, "memory": None}]
    assert predictions._best(runs) == {"seconds": 2.0}
    assert predictions._best([{"failure": "no"}]) == {"failure": "no"}


def test_a_small_problem_from_start_to_end(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    from benchmarks.problems import BenchmarkProblem

    import bundle
    from bundle.planning.inspection.problem_time import make_scene

    path = tmp_path / "scene.txt"
    bundle.save(make_scene(8, 60, 4), path)
    rows = predictions.rows_of(BenchmarkProblem("scene", "bal", path), threads=1, repeat=1)
    assert [row.failure for row in rows] == [""] * len(predictions.SOLVES)
    for found in rows:
        predicted, measured = found.seconds
        assert predicted > 0
        assert measured > 0
        assert (found.nnz_factor[0] > 0) == found.is_direct
