"""Exact numbers of attitude priors: sigmas by axis, kinds that turn the world, thresholds."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi

import bundle
from bundle import GravityPrior, HeadingPrior, InputError, OrientationPrior, PositionPrior
from bundle.georeference.attitudes import Attitudes
from bundle.georeference.problem_attitudes import ProblemAttitudes
from bundle.georeference.similarity import Similarity, moved
from tests.georeference.test_attitude_priors import gravity_of, rotations, upright_and_turned

AXIS = (1.0, 0.3, 0.2)
HEADING, TILT = 3.0, 0.5


def oriented(truth, turn, sigmas=(HEADING, TILT)):
    """Exact orientations of a world that is turned by a rotation vector in degrees."""
    world = Rotation.from_rotvec(np.radians(turn))
    quaternions = (rotations(truth) * world).as_quat()
    return [
        OrientationPrior(int(one), row, sigmas)
        for one, row in zip(truth.image_ids, quaternions, strict=True)
    ]


def headings_of(truth, by, sigma=1.0, axis=AXIS):
    """Headings of an axis of the cameras that are off by an angle in degrees."""
    east, north, _ = rotations(truth).inv().apply(axis).T
    found = np.degrees(np.arctan2(east, north)) + by
    return [
        HeadingPrior(int(one), heading, sigma, axis=axis)
        for one, heading in zip(truth.image_ids, found, strict=True)
    ]


@pytest.mark.parametrize("backend", ["fused", "ceres"])
@pytest.mark.parametrize(
    ("turn", "sigma"),
    [((0, 0, 0.6), HEADING), ((0.6, 0, 0), TILT), ((0, 0.6, 0), TILT)],
)
def test_each_axis_of_an_orientation_has_its_own_sigma(turn, sigma, backend):
    truth, _ = upright_and_turned()
    result = bundle.solve(
        truth, priors=oriented(truth, turn), align=False, max_num_iterations=0, backend=backend
    )
    expected = 0.5 * (0.6 / sigma) ** 2
    np.testing.assert_allclose(result.factor_costs_before, expected, rtol=1e-6)
    (group,) = ProblemAttitudes.make(truth, oriented(truth, turn)).groups
    np.testing.assert_allclose(group.whitened(truth), 0.6 / sigma, rtol=1e-6)


def test_unequal_sigmas_weigh_through_a_solve():
    """Two halves of the images disagree about both axes; each axis ends at its weighted mean."""
    truth, _ = upright_and_turned(num_images=8)
    first = oriented(truth, (0, 0, 0), (0.5, 2.0))[:4]
    exact = {"function_tolerance": 1e-14, "max_num_iterations": 100, "num_threads": 1}
    solved = []
    for by in (0.0, 0.1):
        second = oriented(truth, (by, 0, by), (1.0, 1.0))[4:]
        result = bundle.solve(truth, priors=[*first, *second], align=False, **exact)
        solved.append(rotations(result.problem))
    turn = (solved[0].inv() * solved[1]).mean().as_rotvec(degrees=True)
    heading = 0.1 * 1.0**-2 / (1.0**-2 + 0.5**-2)
    tilt = 0.1 * 1.0**-2 / (1.0**-2 + 2.0**-2)
    assert turn[2] == pytest.approx(heading, rel=0.05)
    assert turn[0] == pytest.approx(tilt, rel=0.05)


def test_headings_beside_orientations_do_not_turn_the_world():
    truth, _ = upright_and_turned()
    exact = oriented(truth, (0, 0, 0))
    both = ProblemAttitudes.make(truth, [*exact, *headings_of(truth, 20.0)])
    assert both.placement(truth) is None
    alone = ProblemAttitudes.make(truth, headings_of(truth, 20.0)).placement(truth)
    # Headings are clockwise: larger ones ask for a turn by -20 degrees about up.
    turn = Rotation.from_matrix(alone.rotation).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, [0, 0, -20], atol=1e-6)
    gravity = ProblemAttitudes.make(truth, [*gravity_of(truth, 1e-9), *headings_of(truth, 20.0)])
    turn = Rotation.from_matrix(gravity.placement(truth).rotation).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, [0, 0, -20], atol=1e-5)


@pytest.mark.parametrize("length", [1e-200, 1.0, 1e200])
def test_directions_and_quaternions_of_any_length(length):
    given = length * np.array([2.0, -4, 4])
    for found in (GravityPrior(1, given, 1).direction, HeadingPrior(1, 0, 1, axis=given).axis):
        np.testing.assert_allclose(found, [1 / 3, -2 / 3, 2 / 3], rtol=1e-15)
    found = OrientationPrior(1, [*given, 8 * length], 1).rotation
    np.testing.assert_allclose(found, [0.2, -0.4, 0.4, 0.8], rtol=1e-15)


def test_the_default_loss_scale_is_exceeded_by_five_percent():
    """Quantiles of the chi distribution with one, two and three degrees of freedom."""
    for prior, count in (
        (HeadingPrior(1, 0, 1), 1),
        (GravityPrior(1, (0, 0, -1), 1), 2),
        (OrientationPrior(1, (0, 0, 0, 1), 1), 3),
    ):
        assert prior.loss_scale == pytest.approx(chi.ppf(0.95, count), abs=0.01)
        assert prior.num_residuals == count
        assert dataclasses.replace(prior, loss_scale=1e-3).loss_scale == 1e-3
        with pytest.raises(InputError, match="loss_scale"):
            dataclasses.replace(prior, loss_scale=0)


def test_gravity_and_headings_together_undo_any_turn():
    truth, _ = upright_and_turned()
    turned = moved(truth, Similarity(1.0, Rotation.random(random_state=3).as_matrix(), np.ones(3)))
    priors = ProblemAttitudes.make(turned, [*gravity_of(truth, 1e-9), *headings_of(truth, 0.0)])
    back = moved(turned, priors.placement(turned))
    apart = (rotations(back).inv() * rotations(truth)).magnitude()
    np.testing.assert_allclose(apart, 0, atol=1e-7)


def test_headings_do_not_turn_a_world_that_positions_place():
    truth, given = upright_and_turned()
    places = [
        PositionPrior(int(one), center, 0.01)
        for one, center in zip(truth.image_ids, truth.projection_centers, strict=True)
    ]
    wrong = headings_of(truth, 90.0, sigma=60.0)
    priors = [*places, *gravity_of(truth, 1.0), *wrong]
    result = bundle.solve(given, priors=priors, max_num_iterations=0)
    np.testing.assert_allclose(
        result.problem.projection_centers, truth.projection_centers, atol=0.3
    )


def test_headings_have_no_vertical_for_two_positions():
    truth, given = upright_and_turned()
    two = [
        PositionPrior(int(truth.image_ids[k]), truth.projection_centers[k], 0.01) for k in (0, 5)
    ]
    level = [*gravity_of(truth, 0.1), *two]
    placed = bundle.solve(given, priors=level, max_num_iterations=0).problem
    np.testing.assert_allclose(placed.projection_centers, truth.projection_centers, atol=0.05)
    priors = [*headings_of(truth, 0.0), *two]
    assert bundle.solve(given, priors=priors, max_num_iterations=0).similarity is None
    with pytest.raises(InputError, match="at least 3 images"):
        bundle.solve(given, priors=priors, max_num_iterations=0, align=True)


@pytest.mark.parametrize(("above", "is_refused"), [(85.2, True), (84.8, False)])
def test_the_least_angle_of_an_axis_with_a_heading(above, is_refused):
    truth, _ = upright_and_turned()
    angle = math.radians(above)
    axis = rotations(truth)[0].apply([math.cos(angle), 0, math.sin(angle)])
    priors = [HeadingPrior(int(truth.image_ids[0]), 90.0, 2.0, axis=axis)]
    if is_refused:
        with pytest.raises(InputError, match="5 degrees"):
            bundle.solve(truth, priors=priors, align=False, max_num_iterations=0)
    else:
        bundle.solve(truth, priors=priors, align=False, max_num_iterations=0)


@pytest.mark.parametrize(
    ("sigma", "tilt", "is_refused"),
    [(2.0, 6.2, True), (2.0, 5.8, False), (0.1, 1.1, True), (0.1, 0.9, False)],
)
def test_a_world_that_must_stay_may_be_wrong_by_three_sigmas(sigma, tilt, is_refused):
    truth, _ = upright_and_turned()
    exact = tuple(GravityPrior(one.image, one.direction, sigma) for one in gravity_of(truth, 1e-9))
    turn = Rotation.from_rotvec(np.radians([tilt, 0, 0])).as_matrix()
    model = moved(truth, Similarity(1.0, turn, np.zeros(3)))
    if is_refused:
        with pytest.raises(InputError, match=rf"{tilt:.3g} degrees off"):
            Attitudes(exact).check_kept(model, "because")
    else:
        Attitudes(exact).check_kept(model, "because")


@pytest.mark.parametrize(("length", "agrees"), [(4.55, True), (4.75, False)])
def test_the_largest_of_good_residuals(length, agrees):
    """Chi with 2 degrees of freedom: sqrt(-2 log(0.001 / 30)) = 4.54; the cube root says 4.65."""
    truth, _ = upright_and_turned(num_images=30)
    priors = list(gravity_of(truth, 1e-9))
    priors = [GravityPrior(one.image, one.direction, 1.0) for one in priors]
    down = np.array(priors[7].direction)
    across = np.cross(down, [1.0, 0.2, 0.1])
    turned = Rotation.from_rotvec(np.radians(length) * across / np.linalg.norm(across)).apply(down)
    priors[7] = GravityPrior(priors[7].image, turned, 1.0)
    (found,) = Attitudes(tuple(priors)).errors(truth)
    # The robust mean moves by less than a thirtieth of the length.
    assert (len(found.suspects) == 0) == agrees
    assert found.images[7].apart == pytest.approx(length, rel=0.05)


@pytest.mark.parametrize(
    ("sigmas", "apart", "expected"),
    [
        ((1.0,), 0.0, 2.448),  # chi2 with 2 degrees of freedom exceeds 2.448^2 in 5 of 100
        ((1.0, 1.0), 0.0, 2.448 / math.sqrt(2)),
        ((0.5, 1.0), 0.0, 2.448 / math.sqrt(5)),
        # Two that are 10 sigmas apart have lengths of 5, a scale of 5 / 1.17741 and Tukey's weights
        # w; their squares are 12.5 times the expected ones.
        ((1.0, 1.0), 10.0, 2.448 * math.sqrt(12.5 / 2) / (1 - (1.17741 / 4.685) ** 2)),
    ],
)
def test_the_bound_of_one_or_two_directions(sigmas, apart, expected):
    truth, _ = upright_and_turned(num_images=3)
    priors = []
    for prior, sigma, by in zip(gravity_of(truth, 1e-9), sigmas, (-0.5, 0.5), strict=False):
        world = Rotation.from_rotvec(np.radians([by * apart, 0, 0])).apply([0, 0, -1.0])
        row = truth.image_ids.tolist().index(prior.image)
        priors.append(GravityPrior(prior.image, rotations(truth)[row].apply(world), sigma))
    (found,) = Attitudes(tuple(priors)).errors(truth)
    assert found.within == pytest.approx(expected, rel=1e-3)
    assert found.sigma == pytest.approx(np.median(sigmas), rel=1e-12)


def test_losses_have_the_names_of_the_solver():
    prior = GravityPrior(1, (0, 1, 0), 1.0, loss="Soft-L1")
    assert prior.loss == "soft_l1" and prior.factor(1).loss == "soft_l1"


def test_sigmas_are_from_a_millionth_of_a_millionth_to_its_inverse():
    for sigma in (1e-12, 1e12):
        assert GravityPrior(1, (0, 1, 0), sigma).sigma_degrees == sigma
        assert HeadingPrior(1, 0.0, sigma).sigma_degrees == sigma
    for sigma in (0.9e-12, 1.1e12):
        with pytest.raises(InputError, match="sigma_degrees"):
            OrientationPrior(1, (0, 0, 0, 1), (1.0, sigma))


def test_headings_have_no_whole_turns_and_directions_length_one():
    assert HeadingPrior(1, 725.0, 1.0).heading_degrees == 5.0
    assert HeadingPrior(1, -725.0, 1.0).heading_degrees == -5.0
    for size in (1e-200, 1e200):
        np.testing.assert_allclose(
            GravityPrior(1, (0, 3 * size, 4 * size), 1.0).direction, (0, 0.6, 0.8), rtol=1e-15
        )


def test_the_rms_of_residuals_is_that_of_a_coordinate():
    """Lengths of 1, 1 and 0.2 sigmas of two, one and three coordinates."""
    truth, _ = upright_and_turned()
    turn = Rotation.from_rotvec(np.radians([1.0, 0, 0])).as_matrix()
    level = tuple(GravityPrior(one.image, one.direction, 1.0) for one in gravity_of(truth, 1e-9))
    (gravity,) = Attitudes(level).errors(moved(truth, Similarity(1.0, turn, np.zeros(3))))
    (heading,) = Attitudes(tuple(headings_of(truth, 1.0))).errors(truth)
    (whole,) = Attitudes(tuple(oriented(truth, (0, 0, 0.6)))).errors(truth)
    assert gravity.rms_sigmas == pytest.approx(1 / math.sqrt(2), rel=1e-6)
    assert heading.rms_sigmas == pytest.approx(1.0, rel=1e-6)
    assert whole.rms_sigmas == pytest.approx(0.2 / math.sqrt(3), rel=1e-6)
    assert gravity.off == pytest.approx(1.0, rel=1e-6)
    assert heading.off == pytest.approx(1.0, rel=1e-6)


def test_images_contradict_each_other_and_not_the_model():
    truth, _ = upright_and_turned()
    level = tuple(GravityPrior(one.image, one.direction, 1.0) for one in gravity_of(truth, 1e-9))
    turn = Rotation.from_rotvec(np.radians([0, 20.0, 0])).as_matrix()
    (found,) = Attitudes(level).errors(moved(truth, Similarity(1.0, turn, np.zeros(3))))
    assert found.suspects == () and found.off == pytest.approx(20, rel=1e-6)
    assert max(image.apart for image in found.images) < 1e-6
    assert min(image.degrees for image in found.images) == pytest.approx(20, rel=1e-6)


@pytest.mark.parametrize("by", [-170.0, -10.0, 10.0, 170.0])
def test_headings_turn_by_the_shorter_way(by):
    truth, _ = upright_and_turned()
    priors = headings_of(truth, by)
    around = [HeadingPrior(one.image, one.heading_degrees + 360, 1.0, axis=AXIS) for one in priors]
    for given in (priors, around):
        (group,) = ProblemAttitudes.make(truth, given).groups
        expected = np.tile([0, 0, np.radians(-by)], (len(given), 1))
        np.testing.assert_allclose(group.turns(truth), expected, atol=1e-9)
