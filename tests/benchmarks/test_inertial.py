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


def test_a_run_has_times_of_every_implementation(monkeypatch):
    monkeypatch.setattr(inertial, "SAMPLES", 40)
    found = inertial.measured(2)
    assert next(iter(found)) == "bundle"
    for by_interval in found.values():
        assert [int(interval) for interval in by_interval] == list(inertial.INTERVALS)
        assert all(len(times) == 2 and min(times) > 0 for times in by_interval.values())
