"""The table and the targets of validations, from runs that are made up."""

import pytest
from benchmarks.results import Results

from benchmarks import judging, targets


def run(wall, **more):
    size = {"num_images": 128, "num_observations": 50_000, "num_candidates": 9}
    return {"failure": "", "wall": wall, "cpu": 1.9 * wall, **size, **more}


RUNS = {
    "128 photographs": [run(10.0), run(12.0), run(14.0)],
    "slow": [run(30.0)],
    "broken": [run(1.0), {"failure": "exit 2: error: no", "wall": 1.0, "cpu": 1.0}],
}


def test_medians_and_a_failure_are_lines():
    _, _, *lines = judging.as_table(RUNS).splitlines()
    made, _, broken = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    assert made[1:4] == ["128 images, 50,000 observations", "9", "12 s (10 s-14 s)"]
    assert broken[1] == "no result: exit 2: error: no"
    assert judging.as_table({}) == ""


def test_targets():
    results = Results({}, "", {"threads": 2}, {}, [], {}, judging=RUNS)
    made, slow, broken = targets.of(results)
    assert (made.value, made.limit, made.met) == (pytest.approx(12), 20, True)
    assert not slow.met
    assert (broken.value, broken.met) == (None, False)
