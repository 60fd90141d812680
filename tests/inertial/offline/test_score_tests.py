"""Score tests: exact quadratic costs, both sides of each bound, planted errors on a flight."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.base.tails import chi2_bound
from bundle.inertial.offline import imu_adjustment
from bundle.inertial.offline.imu_agreement import Agreement
from bundle.inertial.offline.motion_solve import ImuBodies
from bundle.inertial.offline.score_tests import (
    HELD,
    Change,
    LeastCost,
    Score,
    few_steps,
    largest_score,
    unit,
    walk_slopes,
)
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.calibration import ImuNoise
from tests.campaigns.imu_refine import Scene, added, axes, posed, turned

POSITIONS = np.array([[0.0, 0, 1], [4, 0, 1], [0, 6, 1], [4, 6, 9]])


def agreement(images=1.0, motions=1.0):
    return Agreement(0.0, 1, np.ones(1), motions, images)


def quadratic(slopes, curvatures, offsets=(7.0, 3.0, 1.0), growth=-0.5):
    """Costs of images, motions and priors; positions that grow by `growth` times x."""

    def least(x):
        costs = (
            c + g * x + h * x**2 / 2 for c, g, h in zip(offsets, slopes, curvatures, strict=True)
        )
        return LeastCost(*costs, (1 + growth * x) * POSITIONS + [5.0 * x, 0, 0])

    return least


def score(least, among=None, kind="accel_scale"):
    size = HELD[kind][1]
    return Score(kind).of([least(side * size) for side in (-1, 0, 1)], among or agreement())


def test_the_minimum_of_a_quadratic_cost_and_the_variance_of_its_slope():
    rng = np.random.default_rng(2)
    sigmas = 0.6, 0.2, 1.0  # of images, and of motions, whose noise is overstated; of priors
    along = [size * rng.normal(size=40) for size in (1.0, 2.0, 1.5)]
    curvatures = [one @ one for one in along]
    slopes = np.array(
        [s * rng.normal(size=(4000, 40)) @ one for s, one in zip(sigmas, along, strict=True)]
    ).T
    among = agreement(sigmas[0] ** 2, sigmas[1] ** 2)
    found = [score(quadratic(one, curvatures), among) for one in slopes[:300]]
    errors = -slopes.sum(axis=1) / sum(curvatures)
    np.testing.assert_allclose([one.x for one in found], errors[:300], rtol=1e-6, atol=1e-9)
    assert found[0].sigma == pytest.approx(errors.std(), rel=0.03)
    assert np.mean([one.chi2 for one in found]) == pytest.approx(1.0, abs=0.2)
    np.testing.assert_allclose([one.chi2 for one in found], (errors[:300] / found[0].sigma) ** 2)


def test_the_movement_is_a_share_of_the_distances_from_the_mean():
    found = score(quadratic((1.0, -4.0, 1.0), (20.0, 25.0, 5.0)))
    assert found.x == pytest.approx(0.04)
    assert found.sigma == pytest.approx(50**-0.5)
    assert found.gain == pytest.approx(2.0**2 / 50)
    assert found.movement == pytest.approx(0.5 * 0.04)


def test_a_cost_without_a_minimum_tells_nothing():
    for least in (
        quadratic((1.0, 1.0, 0.0), (0.0, 0.0, 0.0)),
        quadratic((1.0, 1.0, 0.0), (1.0, -3.0, 1.0)),
        quadratic((math.nan, 1.0, 0.0), (1.0, 3.0, 1.0)),
    ):
        found = score(least)
        assert (found.x, found.sigma, found.is_clear, found.is_relevant) == (0, math.inf, 0, 0)


@pytest.mark.parametrize(
    ("kind", "numbers", "tests"),
    [("accel_scale", 1, 1), ("arm", 3, 1), ("camera_from_imu", 3, 1), ("accel_bias", 3, 80)],
)
def test_both_bounds_of_a_clear_error(kind, numbers, tests):
    bound = chi2_bound(numbers, 1e-4 / tests)
    for chi2 in (0.99 * bound, 1.01 * bound):
        one = Score(kind, np.ones(numbers), chi2=chi2, tests=tests)
        assert one.is_clear == (chi2 > bound)


def test_both_bounds_of_a_relevant_error():
    for kind, x, movement, is_relevant in (
        ("accel_scale", 0.1, 0.021, True), ("accel_scale", 0.1, 0.019, False),
        ("accel_bias", 0.1, 0.011, True), ("accel_bias", 0.1, 0.009, False),
        ("arm", -0.021, 0.0, True), ("arm", 0.019, 0.009, False), ("arm", 0.019, 0.011, True),
    ):  # fmt: skip
        assert Score(kind, x=x, movement=movement).is_relevant == is_relevant


def test_a_change_of_body_and_samples():
    rng = np.random.default_rng(3)
    turn = np.array([0.1, -0.2, 0.3])
    given = np.append(Rotation.from_rotvec([1, 2, 0.5]).as_quat(), [0.1, 0.2, 0.3])
    bodies = ImuBodies("image", np.arange(2), np.arange(2), given)
    by = np.concatenate([[0.25], [1.0, 2, 3], turn, [0.1, 0, 0], [0, 0.5, 0], [0.6]])
    found = Change(by, 4).of_bodies(bodies).body_from_imu
    right = Rotation.from_quat(given[:4]) * Rotation.from_rotvec(turn)
    assert (Rotation.from_quat(found[:4]).inv() * right).magnitude() < 1e-12
    np.testing.assert_allclose(found[4:], [1.1, 2.2, 3.3])
    gyro, accel = rng.normal(size=(2, 5, 3))
    one = ImuInterval(gyro, accel, np.full(4, 0.01))
    for k in (3, 4):
        changed = Change(by, 4).of_samples(k, one)
        np.testing.assert_allclose(changed.gyro, gyro / 1.6 - (k == 4) * by[7:10])
        np.testing.assert_allclose(changed.accel, accel / 1.25 - (k == 4) * by[10:13])
    for kind, (place, _) in HELD.items():
        along = unit(rng.normal(size=place.stop - place.start))
        changed = Score(kind, along, interval=7).change(0.5)
        assert changed.first == 7
        np.testing.assert_allclose(changed.by[place], 0.5 * along)
        assert np.linalg.norm(changed.by) == pytest.approx(0.5)


def test_slopes_of_steps_are_those_of_the_random_walks():
    noise = ImuNoise(1e-4, 1e-3, 2e-5, 3e-3)
    rng = np.random.default_rng(4)
    biases, durations = rng.normal(size=(6, 6)), rng.uniform(0.1, 0.3, 5)

    def cost(k, step):
        errors = np.diff(biases, axis=0)
        errors[k] -= step
        walks = np.repeat([2e-5, 3e-3], 3) ** 2
        return (errors**2 / (walks * durations[:, None])).sum() / 2

    by_gyro, by_accel = walk_slopes(biases, durations, noise)
    for k, axis in ((0, 0), (4, 5), (2, 3)):
        step = 1e-3 * np.eye(6)[axis]
        slope = (cost(k, step) - cost(k, -step)) / 2e-3
        assert np.hstack([by_gyro, by_accel])[k, axis] == pytest.approx(slope, rel=1e-6)


def chosen(errors, movement=1.0):
    """The largest score of a cost whose minimum is at errors by kind, of (slope, curvature)."""

    def least(change):
        cost, moved = 0.0, np.zeros(3)
        for kind, (x, curvature) in errors.items():
            there = change.by[HELD[kind][0]][0] - x
            cost += curvature * there**2 / 2
            moved = moved + movement * change.by[HELD[kind][0]][0]
        return LeastCost(cost, 0.0, 0.0, POSITIONS + moved * POSITIONS)

    likely = [Score("gyro_scale"), Score("camera_from_imu", np.array([1.0, 0, 0]))]
    walks = np.zeros((2, 9, 3))
    walks[:, 4, 0] = 1.0
    return largest_score(
        least, lambda change: least(change).images, likely, (walks[0], walks[1]), agreement()
    )


def test_the_clear_score_of_the_largest_gain_is_chosen():
    assert chosen({"accel_scale": (0.001, 1e3)}) is None
    found = chosen({"accel_scale": (0.05, 3e4), "arm": (0.05, 5e4)})
    assert (found.kind, found.x) == ("arm", pytest.approx(-0.05))  # along the score: downhill
    np.testing.assert_allclose(found.x * found.along, [0.05, 0, 0], atol=1e-12)
    found = chosen({"accel_bias": (0.3, 1e4), "gyro_scale": (0.02, 4e5)})
    assert (found.kind, found.interval, found.tests) == ("accel_bias", 5, 9)
    assert chosen({"gyro_scale": (0.02, 4e6)}).kind == "gyro_scale"
    assert chosen({"gyro_scale": (0.02, 4e6)}, movement=0.4) is None
    # The largest gain is the cause, though only another clear one is relevant by itself.
    errors = {"accel_scale": (0.03, 1e5), "gyro_scale": (0.009, 4e6)}
    assert chosen(errors).kind == "gyro_scale"


@pytest.mark.parametrize(("share", "kind"), [(0.24, "accel_scale"), (0.26, "gyro_scale")])
def test_a_gain_that_solves_do_not_reach_is_that_of_another_minimum(share, kind):
    def least(change):
        scale, x = change.by[[0, 13]]
        cost = ((x - 0.03) / 0.03) ** 2 if x in (-0.02, 0, 0.02) else 1 - share
        return LeastCost(1e3 * cost + 1e5 * (scale - 0.03) ** 2, 0, 0, (1 + x + scale) * POSITIONS)

    still = np.ones((9, 3))
    found = largest_score(least, lambda _: 0.0, [Score("gyro_scale")], (still, still), agreement())
    assert (found.kind, HELD["gyro_scale"][1]) == (kind, 0.02)


def test_steps_are_few():
    options = few_steps(bundle.SolveOptions(loss="cauchy", initial_trust_region_radius=1.0))
    assert (options.max_num_iterations, options.loss) == (10, "cauchy")
    assert (options.initial_trust_region_radius, options.function_tolerance) == (1e4, 1e-6)


@pytest.fixture(scope="module")
def scene():
    return Scene(302)  # its points of weak depth end undamped steps far from a minimum


def test_right_flights_have_no_clear_error_that_is_relevant(scene, monkeypatch):
    found = []
    whole = Score.of
    monkeypatch.setattr(Score, "of", lambda *given: found.append(whole(*given)) or found[-1])
    for one in (scene, Scene(303)):
        assert one.run(None).end == "silent"
    assert {"accel_scale", "arm", "gyro_bias", "accel_bias"} <= {one.kind for one in found}
    assert max(one.chi2 for one in found) < 15
    assert max(abs(one.x) / one.sigma for one in found if one.kind == "accel_scale") < 2
    assert 0.002 < min(one.sigma for one in found if one.kind == "accel_scale") < 0.008


@pytest.mark.parametrize(
    ("fault", "kind", "number", "right", "tolerance"),
    [
        (added(0, [0.3, 0, 0], 8.0), "accel_bias", "step", [0.3, 0, 0], 0.1),
        (added([0, 0.01, 0], 0, 6.0), "gyro_bias", "step", [0, 0.01, 0], 4e-3),
        (posed(lambda pose: pose + 0.1 * np.eye(7)[4]), "arm", "metres", 0.1, 0.015),
        (posed(lambda pose: pose + 0.05 * np.eye(7)[5]), "arm", "metres", 0.05, 0.015),
        (axes(1, 1.05), "accel_scale", "ratio", 1.05, 0.012),
        (axes(1.018, 1), "gyro_scale", "ratio", 1.018, 0.004),
        (turned(0, 0.9), "camera_from_imu", "degrees", 0.9, 0.25),
    ],
)  # fmt: skip
def test_a_planted_error_is_named_with_its_size(
    scene, monkeypatch, fault, kind, number, right, tolerance
):
    kept = []
    whole = imu_adjustment.imu_findings
    monkeypatch.setattr(
        imu_adjustment, "imu_findings", lambda known: kept.extend(whole(known)) or tuple(kept)
    )
    scene.run(fault)
    found = next(one for one in kept if one.kind != "imu_contradiction")
    assert found.kind == kind
    np.testing.assert_allclose(found.evidence[number], right, atol=tolerance)
