import numpy as np
import pytest

from benchmarks import inertial


@pytest.mark.parametrize("interval", [3, 1000])
def test_implementations_do_the_same_work(interval):
    gyro, accel, dt = (array[:7] for array in inertial.samples())
    ours = inertial.by_bundle(gyro, accel, dt, interval)
    for variant, tolerance in (("Manifold", 1e-14), ("", 1e-7)):
        theirs = inertial.by_gtsam(variant)(gyro, accel, dt, interval)
        assert np.abs(ours - theirs).max() < tolerance


def test_table_has_a_row_per_implementation():
    times = {(name, n): 0.1 for name in ("bundle", "gtsam") for n in inertial.INTERVALS}
    _, _, first, second = inertial.as_table(times).splitlines()
    assert first == "| bundle | 0.100 | 0.100 | 0.100 |"
    assert second.startswith("| gtsam |")
