"""Models whose pixels have another origin, at the limits of the test."""

import numpy as np
import pytest

from bundle.judging.findings.find import find
from bundle.model.residuals import residuals
from tests.scenes import make_problem


def shifted(shift, noise=0.0, source="model", given=()):
    problem = make_problem(num_images=6, num_points=200)
    rng = np.random.default_rng(0)
    exact = problem.observation_xy + residuals(problem, "algebraic").xy
    xy = exact + shift + noise * rng.normal(size=problem.observation_xy.shape)
    found = find(problem.replace(observation_xy=xy), source=source, given=given)
    return {one.kind: one for one in found}


def test_a_shift_is_named_and_nothing_else_is_judged():
    found = shifted((400.0, 300.0), source="a/model.nvm")["shifted_pixels"]
    assert found.evidence["shift"] == pytest.approx([-400.0, -300.0], abs=1.0)
    assert found.evidence["rmse"] == pytest.approx(500.0, abs=1.0)
    assert found.command.endswith("--pixel-origin corner") and found.is_problem
    assert "not_refined" not in shifted((400.0, 300.0))
    assert shifted((400.0, 300.0))["shifted_pixels"].command == ""
    against = shifted((-400.0, 300.0), source="a/model.nvm")["shifted_pixels"]
    assert against.command == ""  # the corner is above and on the left


@pytest.mark.parametrize(("shift", "is_advised"), [(-640.0, True), (30.0, False)])
def test_pixels_from_the_corner_are_not_read_from_the_centre_again(shift, is_advised):
    given = ("--pixel-origin", "corner")
    found = shifted((shift, shift), source="m.nvm", given=given)["shifted_pixels"]
    assert bool(found.command) == is_advised
    assert not is_advised or found.command.endswith("--pixel-origin center")


@pytest.mark.parametrize(
    ("shift", "noise", "is_found"),
    [
        ((0.0, 10.1), 0.0, True),
        ((0.0, 9.9), 0.0, False),
        ((100.0, 0.0), 22.0, True),  # 10000 of 10968: 91.2 %
        ((100.0, 0.0), 25.0, False),  # 10000 of 11250: 88.9 %
    ],
)
def test_limits(shift, noise, is_found):
    assert ("shifted_pixels" in shifted(shift, noise)) == is_found


CORNER = ("--pixel-origin", "corner")


@pytest.mark.parametrize(
    ("given", "guess", "second", "size"),
    [
        ((), (0.0, 0.0), (400.0, 300.0), "800,600"),
        (("--image-size", "unknown"), (0.0, 0.0), (400.0, 300.0), "800,600"),
        (CORNER, (392.0, 308.0), (400.0, 300.0), "800,600"),
        (CORNER, (392.0, 292.0), (409.8, 300.0), "810,600"),
        (CORNER, (392.0, 292.0), (410.2, 300.0), None),  # 800 and 820 pixels
        ((), (0.0, 0.0), (300.0, 400.0), None),
    ],
)
def test_an_unknown_size_is_twice_the_middle_of_the_images(given, guess, second, size):
    """Pixels from the corner, whose reader took the principal point to be the guess.

    Images have the middle (400, 300) and the second one in turn.
    """
    problem = make_problem(num_images=6, num_points=200, model="SIMPLE_PINHOLE")
    middle = np.where(problem.observation_image[:, None] % 2, second, (400.0, 300.0))
    exact = problem.observation_xy + residuals(problem, "algebraic").xy
    params = problem.camera_params.copy()
    params[:, 1:3] = guess
    read = problem.replace(
        observation_xy=exact + middle - (400.0, 300.0),
        camera_params=params,
        camera_sizes=np.zeros_like(problem.camera_sizes),
    )
    words = ("--max-iterations", "7", *given)
    found = {one.kind: one for one in find(read, source="m.nvm", given=words)}["shifted_pixels"]
    if size is None:
        assert found.command == ""
        return
    asked = found.command.split("OUTPUT ")[1].split()
    assert asked[:2] == ["--max-iterations", "7"]
    assert sorted(asked[2:]) == sorted([*CORNER, "--image-size", size])
