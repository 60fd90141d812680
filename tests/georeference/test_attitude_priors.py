"""Priors of gravity, orientation and heading in a solve: placement, accuracy, both backends."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, HeadingPrior, InputError, OrientationPrior, PositionPrior
from bundle.georeference.attitude_priors import quaternion_of_angles
from bundle.georeference.attitudes import AttitudeErrors
from bundle.georeference.problem_attitudes import ProblemAttitudes
from bundle.georeference.similarity import Similarity, moved
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem

DOWN = np.array([0.0, 0, -1])


def rotations(problem):
    return Rotation.from_quat(problem.cam_from_world[:, :4])


def upright_and_turned(seed=0, num_images=12, **settings):
    """A problem whose world has z up, and the same turned, moved and scaled."""
    problem = make_problem(
        num_images=num_images, num_points=60, noise=0.5, seed=seed, perturbation=0, **settings
    )
    turn = Rotation.random(random_state=seed + 50).as_matrix()
    return problem, moved(problem, Similarity(2.5, turn, np.array([10.0, -4, 30])))


def gravity_of(problem, sigma, seed=1, upside_down=(), **settings):
    rng = np.random.default_rng(seed)
    priors = []
    for row, image in enumerate(problem.image_ids.tolist()):
        noise = Rotation.from_rotvec(np.radians(sigma) * rng.normal(size=3))
        down = (noise * rotations(problem)[row]).apply(DOWN)
        down = -down if row in upside_down else down
        priors.append(GravityPrior(image, 9.81 * down, sigma, **settings))
    return priors


def tilt(result, truth):
    """Angle in degrees between down of a result and true down, by the robust mean over images."""
    seen = rotations(result.problem).apply(DOWN)
    true = rotations(truth).apply(DOWN)
    in_world = rotations(result.problem).inv().apply(true)
    mean = in_world.mean(axis=0)
    assert np.ptp(np.linalg.norm(seen, axis=1)) < 1e-12
    return np.degrees(np.arccos(np.clip(mean @ DOWN / np.linalg.norm(mean), -1, 1)))


def test_models_become_upright_within_the_predicted_error(backend):
    errors = []
    for seed in range(6):
        truth, given = upright_and_turned(seed)
        priors = gravity_of(truth, 1.0, seed)
        result = bundle.solve(given, priors=priors, backend=backend)
        assert result.options.gauge == "none"
        (group,) = ProblemAttitudes.make(result.problem, priors).groups
        found = AttitudeErrors.of(group, result.problem)
        errors.append(tilt(result, truth))
        assert errors[-1] < found.within < 1.3
        assert 0.5 < found.rms_sigmas < 1.6
    assert np.mean(errors) < 1.5 / np.sqrt(12)


def test_the_start_is_turned_about_the_middle_of_the_cameras():
    truth, given = upright_and_turned()
    result = bundle.solve(given, priors=gravity_of(truth, 1e-6), max_num_iterations=0)
    turn = result.similarity
    assert turn.scale == 1
    middle = given.projection_centers.mean(axis=0)
    np.testing.assert_allclose(turn.apply(middle[None])[0], middle, atol=1e-10)
    assert tilt(result, truth) < 1e-5
    assert Rotation.from_matrix(turn.rotation).as_rotvec()[2] == pytest.approx(0, abs=1e-6)


def test_an_upright_model_stays_where_it_is():
    truth, _ = upright_and_turned()
    again = bundle.solve(truth, priors=gravity_of(truth, 1e-9), max_num_iterations=0)
    assert again.similarity is None


def test_backends_and_order_agree():
    truth, given = upright_and_turned()
    priors = gravity_of(truth, 1.0)
    tight = {"function_tolerance": 1e-14, "max_num_iterations": 100}
    costs = [
        bundle.solve(given, priors=made, backend=name, **tight).summary.final_cost
        for name, made in (("fused", priors), ("ceres", priors), ("fused", priors[::-1]))
    ]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-9)


def test_a_minority_upside_down_does_not_tilt_the_model():
    truth, given = upright_and_turned()
    for settings in ({}, {"loss": "tukey"}):
        priors = gravity_of(truth, 1.0, upside_down=(0, 4, 5, 7), **settings)
        result = bundle.solve(given, priors=priors)
        assert tilt(result, truth) < 1.0
        (group,) = ProblemAttitudes.make(result.problem, priors).groups
        wrong = AttitudeErrors.of(group, result.problem).suspects
        assert len(wrong) == 4


def test_orientations_place_and_hold_the_directions(backend):
    truth, given = upright_and_turned()
    rng = np.random.default_rng(8)
    priors = []
    for row, image in enumerate(truth.image_ids.tolist()):
        noise = Rotation.from_rotvec(np.radians([1, 1, 3]) * rng.normal(size=3))
        measured = (rotations(truth)[row] * noise).as_quat()
        priors.append(OrientationPrior(image, -2 * measured, (3, 1)))
    result = bundle.solve(given, priors=priors, backend=backend)
    turn = (rotations(result.problem).inv() * rotations(truth)).mean().as_rotvec(degrees=True)
    assert np.abs(turn[:2]).max() < 0.9
    assert abs(turn[2]) < 2.7
    (group,) = ProblemAttitudes.make(result.problem, priors).groups
    found = AttitudeErrors.of(group, result.problem)
    assert found.noun == "orientation" and 0.5 < found.rms_sigmas < 1.6
    assert np.linalg.norm(turn) < found.within


def test_headings_turn_an_upright_model():
    truth, given = upright_and_turned()
    axis = (1, 0.3, 0.2)
    east, north, _ = rotations(truth).inv().apply(axis).T
    headings = np.degrees(np.arctan2(east, north)) + 720
    priors = gravity_of(truth, 0.01) + [
        HeadingPrior(int(image), heading, 2, axis=axis)
        for image, heading in zip(truth.image_ids, headings, strict=True)
    ]
    result = bundle.solve(given, priors=priors)
    turn = (rotations(result.problem).inv() * rotations(truth)).mean().magnitude()
    assert np.degrees(turn) < 0.1


def test_a_vertical_axis_has_no_heading():
    truth, _ = upright_and_turned()
    up = rotations(truth)[0].apply([0, 0, 1.0])
    with pytest.raises(InputError, match="vertical"):
        bundle.solve(truth, priors=[HeadingPrior(1, 10, 2, axis=up)])


def test_gravity_with_positions_keeps_the_frame_of_the_positions():
    truth, given = upright_and_turned()
    places = [
        PositionPrior(int(image), center, 0.01)
        for image, center in zip(truth.image_ids, truth.projection_centers, strict=True)
    ]
    result = bundle.solve(given, priors=[*gravity_of(truth, 1.0), *places])
    assert result.similarity.scale == pytest.approx(1 / 2.5, rel=0.1)
    assert tilt(result, truth) < 0.5
    assert np.abs(result.problem.projection_centers - truth.projection_centers).max() < 0.1


def test_sensors_of_rigs_have_gravity_too(backend):
    problem = rig_problem(rigs=(STEREO,), num_frames=5, noise=0.3)
    turn = Rotation.random(random_state=9).as_matrix()
    given = moved(problem, Similarity(1.0, turn, np.zeros(3)))
    priors = [prior for prior in gravity_of(problem, 0.5) if prior.image % 2 == 0]
    result = bundle.solve(given, priors=priors, backend=backend)
    assert tilt(result, problem) < 1.0
    expected = bundle.solve(given, priors=priors, backend="ceres", function_tolerance=1e-12)
    assert result.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-4)


def test_one_image_and_two_images_are_enough():
    truth, given = upright_and_turned()
    for priors in (gravity_of(truth, 0.1)[:1], gravity_of(truth, 0.1)[3:5]):
        assert tilt(bundle.solve(given, priors=priors), truth) < 0.5


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (90, -90, 0), (37, -45, 5), (-170, -90, 180), (10, 20, -90)]
)
def test_angles_are_aerospace(angles):
    """North, east, down by SciPy's intrinsic ZYX; the camera looks along x of the body."""
    body = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ body
    world_from_camera = enu @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    found = Rotation.from_quat(quaternion_of_angles(np.array([angles], float))[0])
    np.testing.assert_allclose(found.as_matrix(), world_from_camera.T, atol=1e-12)


def test_angles_mean_what_they_say():
    def camera(*angles):
        prior = OrientationPrior.from_angles("a", *angles, 1.0)
        return Rotation.from_quat(np.array(prior.rotation)).inv()

    east, up = [1, 0, 0], [0, 0, 1]
    np.testing.assert_allclose(camera(90, 0, 0).apply([0, 0, 1]), east, atol=1e-12)
    np.testing.assert_allclose(camera(90, 0, 0).apply([0, -1, 0]), up, atol=1e-12)
    down = camera(90, -90, 0)  # looks down, the upper edge to the east
    np.testing.assert_allclose(down.apply([0, 0, 1]), DOWN, atol=1e-12)
    np.testing.assert_allclose(down.apply([0, -1, 0]), east, atol=1e-12)
    rolled = camera(0, 0, 10)  # clockwise: the right edge goes down
    assert rolled.apply([1, 0, 0])[2] < 0


def test_whole_turns_change_nothing():
    """Headings and angles of any size mean the same in the factor and in the report."""
    truth, _ = upright_and_turned()
    costs = []
    wanted = OrientationPrior.from_angles(1, 20, 20, -20, 1).rotation
    for wound in (20, 1100, 20 - 360 * 2.0**40):
        prior = HeadingPrior(1, wound, 1, axis=(1, 0.3, 0.2))
        priors = [*gravity_of(truth, 1.0), prior]
        result = bundle.solve(truth, priors=priors)
        heading = ProblemAttitudes.make(result.problem, priors).groups[-1]
        assert AttitudeErrors.of(heading, result.problem).off < 1
        costs.append(result.summary.final_cost)
        angles = OrientationPrior.from_angles(1, wound, wound, -wound, 1).rotation
        np.testing.assert_allclose(np.abs(np.dot(angles, wanted)), 1)
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)


BAD = [
    (lambda: GravityPrior("a", (0, 0, 0), 1), "zero"),
    (lambda: GravityPrior("a", (0, 1), 1), "3 numbers"),
    (lambda: GravityPrior("a", (0, np.inf, 0), 1), "finite"),
    (lambda: GravityPrior("a", (0, 1, 0), 0), "sigma_degrees"),
    (lambda: GravityPrior("a", (0, 1, 0), -2), "sigma_degrees"),
    (lambda: GravityPrior(1.5, (0, 1, 0), 1), "id or a name"),
    (lambda: GravityPrior(True, (0, 1, 0), 1), "id or a name"),
    (lambda: GravityPrior("a", (0, 1, 0), 1, loss="hubber"), "huber"),
    (lambda: OrientationPrior("a", (0, 0, 0, 0), 1), "quaternion"),
    (lambda: OrientationPrior("a", (0, 0, 0, 1), (1, 0)), "at least"),
    (lambda: OrientationPrior("a", (0, 0, 0, 1), (np.nan, 1)), "finite"),
    (lambda: OrientationPrior("a", (0, 0, 0, 1), 1e160), "at most"),
    (lambda: GravityPrior("a", (0, 1, 0), 1e-160), "at least"),
    (lambda: HeadingPrior("a", 1, 1e300), "at most"),
    (lambda: OrientationPrior("a", (0, 0, 0, 1), (1, 2, 3)), "heading, tilt"),
    (lambda: HeadingPrior("a", np.nan, 1), "heading_degrees"),
    (lambda: HeadingPrior("a", 1, 1, axis=(0, 0, 0)), "zero"),
]


@pytest.mark.parametrize(("make", "word"), BAD)
def test_bad_values_are_refused_in_one_line(make, word):
    with pytest.raises(InputError, match=word) as error:
        make()
    assert "\n" not in str(error.value)


def test_bad_images_are_refused():
    truth, _ = upright_and_turned()
    twice = [GravityPrior(1, (0, 1, 0), 1)] * 2
    for priors, word in (
        ([GravityPrior(99, (0, 1, 0), 1)], "99"),
        ([GravityPrior("image_1x", (0, 1, 0), 1)], "image_1x"),
        (twice, "one prior per image"),
        ([(0, 1, 0)], "priors of attitudes"),
    ):
        with pytest.raises(InputError, match=word):
            bundle.solve(truth, priors=priors)
    both = [GravityPrior(1, (0, 1, 0), 1), HeadingPrior(1, 5, 1, axis=(1, 0.2, 0.3))]
    bundle.solve(truth, priors=both, max_num_iterations=0)
