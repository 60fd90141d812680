"""The table and the targets of covariances and diagnoses, from runs that are made up."""

import pytest
from benchmarks.results import Results
from benchmarks.uncertainty import DIAGNOSIS, INNER, LARGE_NAME, THEIRS, TWO_CAMERAS

from benchmarks import targets, uncertainty


def run(cpu, memory=1e8, wall=None):
    return {"failure": "", "cpu": cpu, "wall": cpu / 2 if wall is None else wall, "memory": memory}


RUNS = {
    "street of 1000 images": {
        INNER: [run(1.0), run(2.0), run(3.0)],
        TWO_CAMERAS: [run(1.0), {"failure": "InputError: camera 1"}, run(1.0)],
        THEIRS: [run(32.0, 2e8, 22.0), run(44.0, 3e8, 30.0), run(60.0, 4e8, 40.0)],
    },
    LARGE_NAME: {INNER: [run(30.0, 2.5e9)], DIAGNOSIS: [run(130.0, 2e9)]},
}


def test_ratios_are_of_medians_and_a_failure_is_a_line():
    _, _, *lines = uncertainty.as_table(RUNS).splitlines()
    inner, held, large, diagnosis = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in lines
    )
    assert inner[:2] == ["street of 1000 images", INNER]
    assert inner[2] == "2 s (1 s-3 s)"
    assert inner[4] == "100 MB"
    assert inner[5].startswith("30.00")
    assert inner[6].startswith("22.00")
    assert inner[7].startswith("3.00")
    assert held[2] == "no result: InputError: camera 1"
    assert (large[4], large[5:], diagnosis[2]) == ("2500 MB", ["", "", ""], "130 s")
    assert uncertainty.as_table({}) == ""


def test_targets():
    results = Results({}, "", {"threads": 2}, {}, [], {}, {}, RUNS)
    inner, held, time, memory, diagnosis = targets.of(results)
    assert (inner.value, inner.limit, inner.met) == (pytest.approx(30), 20, True)
    assert (held.value, held.met) == (None, False)
    assert (time.value, time.limit, time.met) == (pytest.approx(15), 20, True)
    assert (memory.value, memory.limit, memory.met) == (pytest.approx(2.5), 3, True)
    assert (diagnosis.value, diagnosis.limit, diagnosis.met) == (pytest.approx(65), 60, False)
