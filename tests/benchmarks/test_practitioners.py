"""The table and the targets of practitioners' inputs, from runs that are made up."""

import pytest
from benchmarks.results import Results

from benchmarks import practitioners, targets


def run(step, **more):
    return {"failure": "", "step": step, "num_steps": 7, "total": 10 * step, "cost": 5.0, **more}


RUNS = {
    "a, position priors": {
        "bundle": [run(1e-3), run(2e-3), run(3e-3)],
        "pycolmap": [run(16e-3), run(20e-3), run(24e-3, cost=5.0 * (1 + 2e-7))],
    },
    "b, filter over a step": {"bundle": [run(1e-3, filter=1.5e-3)]},
    "c, rig, sensors held": {
        "bundle": [{"failure": "InputError: rig 1 has 2 sensors"}],
        "pycolmap": [run(1e-3)],
    },
}


def test_ratios_are_of_medians_and_a_failure_is_a_line():
    _, _, *lines = practitioners.as_table(RUNS).splitlines()
    priors, filtering, rig = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    assert priors[1:4] == ["0.002 s (0.001 s-0.003 s)", "7", "10.00x (8.00x-12.00x)"]
    assert priors[5] == "+2e-07"
    assert filtering[3] == "1.50x"
    assert rig[1] == "no result: InputError: rig 1 has 2 sensors"
    assert practitioners.as_table({}) == ""


def test_targets():
    results = Results({}, "", {"threads": 2}, {}, [], {}, RUNS)
    priors, filtering, rig = targets.of(results)
    assert (priors.value, priors.limit, priors.met) == (pytest.approx(10), 8, True)
    assert (filtering.value, filtering.limit, filtering.met) == (pytest.approx(1.5), 2, True)
    assert (rig.value, rig.met) == (None, False)
