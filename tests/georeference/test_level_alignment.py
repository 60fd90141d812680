"""Placement of models by gravity and positions that leave the turn about their line free."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GroundControlPoint, InputError, PositionPrior
from bundle.georeference.control_point import Measurement
from bundle.georeference.prior_alignment import level_similarity
from bundle.georeference.similarity_fit import WIDEST_ANGLE, Correspondences
from bundle.solving.request import place_at_priors
from tests.georeference.test_attitude_priors import gravity_of, tilt, upright_and_turned


def positions_of(problem, chosen, sigma=0.01, *, heights=True):
    found = []
    for row in chosen:
        east, north, up = problem.projection_centers[row]
        place = (east, north, up if heights else np.nan)
        found.append(PositionPrior(int(problem.image_ids[row]), place, sigma))
    return found


def on_a_line(problem):
    """The same world with all cameras on one line, each of which sees the points as before."""
    poses = problem.cam_from_world.copy()
    turns = Rotation.from_quat(poses[:, :4])
    steps = np.linspace(-1, 1, problem.num_images)[:, None]
    poses[:, 4:] = -turns.apply(np.array([0.3, -4, 0.2]) + steps * [1, 0.4, 0.1])
    return problem.replace(cam_from_world=poses)


@pytest.mark.parametrize("seed", range(4))
def test_two_positions_and_gravity_place_a_model(seed, backend):
    truth, given = upright_and_turned(seed)
    priors = [*gravity_of(truth, 0.2, seed), *positions_of(truth, (1, 9), 0.001)]
    with pytest.raises(InputError, match="at least 3"):
        bundle.solve(given, priors=priors[-2:], align=True)
    result = bundle.solve(given, priors=priors, align=True, backend=backend)
    assert tilt(result, truth) < 0.5
    assert np.abs(result.problem.projection_centers - truth.projection_centers).max() < 0.1


def test_the_start_is_the_similarity_of_a_line():
    truth, given = upright_and_turned()
    truth = on_a_line(truth)
    turn = Rotation.random(random_state=4).as_matrix()
    given = bundle.georeference.similarity.moved(
        truth, bundle.georeference.similarity.Similarity(0.2, turn, np.array([7.0, 8, 9]))
    )
    exact = gravity_of(truth, 1e-9)
    for priors in (
        positions_of(truth, range(12)),
        [*positions_of(truth, (3,)), *positions_of(truth, (0, 8), heights=False)],
    ):
        placed = place_at_priors(given, (), (*exact, *priors), None)
        np.testing.assert_allclose(
            placed.problem.projection_centers, truth.projection_centers, atol=1e-6
        )
        assert placed.similarity.scale == pytest.approx(5, rel=1e-6)


def test_what_gravity_cannot_complete_is_still_refused():
    truth, given = upright_and_turned()
    gravity = gravity_of(truth, 1.0)
    for positions, word in (
        (positions_of(truth, (2,)), "scale and heading, found 1"),
        (positions_of(truth, (2, 7), sigma=100.0), "scale and heading, found 2"),
        (positions_of(truth, (2, 7), heights=False), "with a height, found 0"),
    ):
        with pytest.raises(InputError, match=word):
            bundle.solve(given, priors=[*gravity, *positions], align=True)


def test_the_closed_form_is_the_minimum():
    rng = np.random.default_rng(6)
    source, target = rng.normal(size=(2, 5, 3))
    target = target * 0.2 + source @ Rotation.from_euler("z", 70, degrees=True).as_matrix().T
    covariance = np.tile(1e-6 * np.eye(3), (5, 1, 1))
    upright = Rotation.from_euler("y", 3, degrees=True).as_matrix()
    found = level_similarity(Correspondences(source, target, covariance), upright)
    level, goal = ((v - v.mean(axis=0)) for v in (source @ upright.T, target))

    def cost(scale, angle):
        turned = scale * Rotation.from_euler("z", angle).apply(level)
        return ((turned - goal) ** 2).sum()

    angle = Rotation.from_matrix(found.rotation @ upright.T).as_rotvec()
    np.testing.assert_allclose(angle[:2], 0, atol=1e-12)
    best = cost(found.scale, angle[2])
    residual = found.apply(source) - target
    assert (residual**2).sum() == pytest.approx(best)
    for change in ((1e-4, 0), (-1e-4, 0), (0, 1e-4), (0, -1e-4)):
        assert cost(found.scale + change[0], angle[2] + change[1]) > best


def level(source, target, sigma=1e-3):
    source, target = np.array(source, float), np.array(target, float)
    covariance = np.tile(np.diag([sigma**2, sigma**2, 1.0]), (len(source), 1, 1))
    return level_similarity(Correspondences(source, target, covariance), np.eye(3))


def test_the_heading_is_known_to_ten_degrees():
    """Two positions, 1 to both sides: the sigma of the heading is s / sqrt(2)."""
    ends = [[-1, 0, 0], [1, 0, 0]]
    limit = np.sqrt(2) * WIDEST_ANGLE
    assert level(ends, ends, 0.99 * limit).scale == pytest.approx(1)
    with pytest.raises(InputError):
        level(ends, ends, 1.01 * limit)


def test_what_determines_no_heading_or_no_scale_is_refused():
    shaft, street = [[0, 0, -1], [0, 0, 1]], [[-5, 0, -1], [5, 0, 1]]
    with pytest.raises(InputError):
        level(shaft, street)
    upside_down = [[-5, 0, 100], [5, 0, -100]]
    with pytest.raises(InputError):
        level([[-5, 0, -100], [5, 0, 100]], upside_down)


def test_control_points_on_a_line_count_too():
    truth, given = upright_and_turned()
    points = []
    for index in (0, 5):
        rows = np.flatnonzero(truth.observation_point == index)
        seen = tuple(
            Measurement(truth.image_names[truth.observation_image[k]], *truth.observation_xy[k])
            for k in rows
        )
        points.append(
            GroundControlPoint(
                name=f"p{index}", position=tuple(truth.points[index]), measurements=seen
            )
        )
    result = bundle.solve(given, priors=[*gravity_of(truth, 0.1), *points], align=True)
    assert tilt(result, truth) < 0.5
    assert np.abs(result.problem.projection_centers - truth.projection_centers).max() < 0.3
