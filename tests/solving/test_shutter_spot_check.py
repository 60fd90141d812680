"""The spot check at the end of a solve tests the derivatives by twists."""

import numpy as np
import pytest

from bundle import _core
from tests.printed import in_order
from tests.solving.test_rolling_shutter import small

TIED = {"twists": "tied", "twist_sigma": (0.002, 0.01), "refine": ("poses", "points")}


def spot_check(problem, lie=None, **options):
    """Report of the spot check, where `lie` changes the derivatives by the twist (2, 6)."""

    def claim(_, jacobian):
        if jacobian.shape[1] == columns:
            jacobian[:, -6:] = lie(jacobian[:, -6:])
        return jacobian

    columns = 6 + problem.camera_params.shape[1] + 3 + 6
    offsets = np.zeros((problem.num_images, 3))
    options = {**_core.default_options(), **options}
    return _core.spot_check(problem, options, offsets, claim if lie else None)


LIES = {
    "sign of w": (lambda d: d * np.repeat([-1, 1], 3), "twist rotation x y z -1"),
    "v twice": (lambda d: d * np.repeat([1, 2], 3), "twist translation x y z 2"),
    "degrees": (lambda d: d * np.repeat([np.pi / 180, 1], 3), "twist rotation 0.01745"),
    "w and v swapped": (lambda d: np.roll(d, 3, axis=1), "twist"),
    "y of v forgotten": (lambda d: d * np.r_[1, 1, 1, 1, 0, 1], "twist translation y 0"),
    "a hundredth": (lambda d: d * np.r_[1, 1.01, 1, 1, 1, 1], "twist rotation y 1.01"),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("direction", ["rows", "columns"])
def test_wrong_derivatives_by_twists_are_named(lie, direction):
    problem = small("OPENCV", direction=direction, num_points=60, rate=1.5)
    wrong, words = LIES[lie]
    sentence = spot_check(problem, wrong)
    assert in_order(sentence, *words.split(), "bundle check"), sentence


@pytest.mark.parametrize("mode", ["free", "tied", "hard"])
@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV_FISHEYE", "EUCM"])
@pytest.mark.parametrize("row_time", ["fixed-point", "observed"])
def test_right_derivatives_are_not_accused(model, mode, row_time):
    for seed in range(3):
        problem = small(
            model, ties=mode != "free", row_time=row_time, seed=seed, rate=(0, 0.3, 2)[seed]
        )
        options = {"free": {}, "tied": TIED, "hard": {"twists": "hard"}}[mode]
        assert spot_check(problem, **options) == ""


def test_a_lie_about_hard_twists_is_noticed():
    problem = small(ties=True, num_points=60)
    assert "twist" in spot_check(problem, lambda d: -d, twists="hard")


def test_mixed_shutters_are_checked_where_they_roll():
    problem = small(direction=("rows", "global", "columns", "rows", "global"), num_points=60)
    assert spot_check(problem) == ""
    assert in_order(spot_check(problem, lambda d: 2 * d), "twist", "2")
