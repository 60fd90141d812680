"""The gain of rolling shutters: both errors, and the size of the twists, by hand."""

import numpy as np
import pytest

import bundle
from bundle.solving.parameter_changes import known_readouts, shutter_gain
from tests.rolling import filmed
from tests.scenes import make_problem


@pytest.fixture(scope="module")
def solved():
    """A start with twists of its own; the last camera has a global shutter."""
    problem = make_problem(num_images=6, num_points=60)
    directions = ("rows", "columns", "rows", "rows", "columns", "global")
    return bundle.solve(filmed(problem, direction=directions, rate=1.0, seed=3), num_threads=1)


def rms(problem):
    errors, _ = bundle.reprojection_errors(problem)
    return np.sqrt((errors**2).mean())


def test_the_errors_are_those_of_global_shutters_before_and_rolling_ones_after(solved):
    gain, given = shutter_gain(solved), solved.initial_problem
    still = given.replace(rolling_shutter=None)
    assert gain.rmse_global == pytest.approx(rms(still), rel=1e-12)
    assert gain.rmse == pytest.approx(rms(solved.problem), rel=1e-12)
    # Neither is the error of the input with its twists, nor that of the output without them.
    others = rms(given), rms(solved.problem.replace(rolling_shutter=None))
    for one in others:
        assert abs(one - gain.rmse_global) > 0.1 and abs(one - gain.rmse) > 1e-3


def test_twists_are_averaged_over_images_that_roll(solved):
    gain, twist = shutter_gain(solved), solved.problem.rolling_shutter.twist
    assert not twist[5].any()
    turns = [np.linalg.norm(row[:3]) ** 2 for row in twist[:5]]
    shifts = [np.linalg.norm(row[3:]) ** 2 for row in twist[:5]]
    assert gain.turn == pytest.approx(np.degrees(np.sqrt(sum(turns) / 5)), rel=1e-12)
    assert gain.shift == pytest.approx(np.sqrt(sum(shifts) / 5), rel=1e-12)


def test_global_shutters_gain_nothing():
    problem = make_problem(num_images=4, num_points=30)
    assert shutter_gain(bundle.solve(problem, max_num_iterations=1)) is None
    still = bundle.RollingShutter(direction=("global",) * 4, twist=np.zeros((4, 6)))
    result = bundle.solve(problem.replace(rolling_shutter=still), max_num_iterations=1)
    assert shutter_gain(result) is None


@pytest.mark.parametrize(
    ("readout", "wrong"), [(1.0, False), (1.0000001, True), (1e-9, False), (0.0, True), (-1, True)]
)
def test_readouts_outside_of_a_frame_become_unknown(readout, wrong):
    problem = make_problem(num_images=3, num_points=30)
    output = {"readout": np.array([np.nan, 0.5, readout]), "points": problem.points}
    found, warning = known_readouts(problem, output)
    np.testing.assert_array_equal(found["readout"], [np.nan, 0.5, np.nan if wrong else readout])
    assert found["points"] is problem.points
    assert bool(warning) is wrong
    assert not wrong or f"camera {problem.camera_ids[2]} ended" in warning
    assert known_readouts(problem, {"points": problem.points}) == ({"points": problem.points}, "")
