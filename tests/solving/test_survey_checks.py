"""Offset of positions from control points, and suspects after a solve.

Oracles: solves with the offset held at trial values, and solves that leave one control point out.
"""

import dataclasses
import functools
import pickle

import numpy as np
import pytest

import bundle
from bundle import GroundControlPoint, PositionPrior
from bundle.georeference.control_point import Measurement
from bundle.georeference.point_check import OffsetCheck, PointCheck, scaled_tail

EXACT = {"function_tolerance": 1e-13, "max_num_iterations": 200, "num_threads": 1}
SIGMA_GPS, SIGMA_GCP, NOISE = 0.02, 0.02, 0.5


def block(**settings):
    """A nadir block with its priors: problem, positions, control points, truth."""
    problem, positions, gcps, truth = made_block(**settings)
    return problem, positions.copy(), gcps.copy(), truth


@functools.cache
def made_block(*, shift=(0, 0, 0), offset="none", exact=False, wrong=None):
    seed, images = 1000, 9
    made = bundle.synthesize(
        scene="drone-grid", num_images=images, num_points=90, seed=seed, pixel_noise=0.0
    )
    truth, rng = made.ground_truth, np.random.default_rng(seed)
    noise = NOISE * rng.normal(size=truth.observation_xy.shape)
    problem = truth.replace(
        observation_xy=truth.observation_xy + noise,
        observation_sigma=np.full(truth.num_observations, NOISE),
    )
    seen = np.bincount(truth.observation_point, minlength=truth.num_points)
    chosen = rng.choice(np.flatnonzero(seen >= 3), 8, replace=False)
    error = (0.0 if exact else SIGMA_GCP) * rng.normal(size=(8, 3))
    if wrong is not None:
        error[wrong[0]] += wrong[1]
    gcps = []
    for k, row in enumerate(chosen.tolist()):
        marks = np.flatnonzero(truth.observation_point == row)
        gcps.append(
            GroundControlPoint(
                name=f"t{k}",
                position=tuple((truth.points[row] + error[k]).tolist()),
                sigma=(SIGMA_GCP, SIGMA_GCP),
                measurements=[
                    Measurement(
                        truth.image_names[truth.observation_image[m]],
                        *(truth.observation_xy[m] + NOISE * rng.normal(size=2)).tolist(),
                        NOISE,
                    )
                    for m in marks
                ],
            )
        )
    places = truth.projection_centers + SIGMA_GPS * rng.normal(size=(images, 3)) + shift
    positions = [
        PositionPrior(int(one), place, SIGMA_GPS, offset=offset)
        for one, place in zip(truth.image_ids, places, strict=True)
    ]
    return problem, positions, gcps, truth


def solved(problem, positions, gcps, **options):
    return bundle.solve(problem, priors=[*positions, *gcps], align=False, **EXACT, **options)


@functools.cache
def solved_block(**settings):
    return solved(*block(**settings)[:3])


def moved(positions, by):
    """The same positions, lower by an offset that a solve then does not estimate."""
    return [
        dataclasses.replace(one, position=one.position - np.array(by), offset="none")
        for one in positions
    ]


def shifted_cost(problem, positions, gcps, by):
    return solved(problem, moved(positions, by), gcps).summary.final_cost


@pytest.mark.parametrize(
    ("axes", "shift", "backend"), [("up", (0, 0, 45), "fused"), ("all", (3, -2, 45), "ceres")]
)
def test_the_estimated_offset_is_the_minimum_of_all_trial_offsets(axes, shift, backend):
    problem, positions, gcps, truth = block(shift=shift, offset=axes)
    result = solved(problem, positions, gcps, backend=backend)
    offset = result.survey_checks.offset
    assert offset.is_estimated and offset.is_significant and offset.axes == axes
    assert result.problem.num_images == truth.num_images
    assert np.array_equal(result.problem.image_ids, truth.image_ids)
    value, sigma = np.array(offset.value), np.array(offset.sigma)
    least = shifted_cost(problem, positions, gcps, value)
    assert result.summary.final_cost == pytest.approx(least, rel=1e-9)
    for axis in np.flatnonzero(sigma):
        # One sigma away, along the profile, the cost of one axis is at least 1/2 higher.
        away = value + 0.7 * sigma * (np.arange(3) == axis)
        higher = shifted_cost(problem, positions, gcps, away) - least
        assert higher > 0.9 * 0.5 * 0.7**2
        if axes == "up":
            assert higher == pytest.approx(0.5 * 0.7**2, rel=0.05)
    assert np.abs(value - shift)[sigma > 0] == pytest.approx(0, abs=4 * sigma.max())
    assert (value[sigma == 0] == 0).all()


def test_an_offset_is_tested_without_being_asked_for():
    # sd of the height 0.418: reference of the independent solver for 9 images and 90 points.
    clean = solved_block()
    offset = clean.survey_checks.offset
    assert offset.sigma[2] == pytest.approx(0.418, rel=0.05)
    assert not offset.is_significant and not offset.is_estimated and offset.axes == "up"
    far = solved_block(shift=(0, 0, 4)).survey_checks.offset
    assert far.is_significant and far.axes == "up"
    assert far.value[:2] == (0, 0) and far.value[2] == pytest.approx(4, abs=3 * 0.418)
    problem, positions, gcps, _ = block(shift=(0, 0, 4))
    apart = solved_block(shift=(0, 0, 4)).summary.final_cost
    together = shifted_cost(problem, positions, gcps, far.value)
    assert far.statistic == pytest.approx(2 * (apart - together), rel=0.1)
    below = solved_block(shift=(0, 0, -4)).survey_checks.offset
    assert below.value[2] == pytest.approx(-4, abs=3 * 0.418)
    assert "below the control points" in below.sentence
    assert "above the control points" in far.sentence
    along = solved_block(shift=(0.3, 0, 0)).survey_checks.offset
    assert along.axes == "all" and along.value[0] == pytest.approx(0.3, abs=0.1)
    assert "east of" in along.sentence


def test_the_focal_length_that_absorbs_it():
    truth = block(shift=(0, 0, 45))[3]
    result = solved_block(shift=(0, 0, 45))
    without, with_it, sigma = result.survey_checks.offset.focal_lengths
    assert without == result.problem.camera_params[0, 0]
    assert with_it == pytest.approx(truth.camera_params[0, 0], abs=4 * sigma)
    assert without - with_it > 300 and result.survey_checks.offset.bends_focal_length
    assert not solved_block().survey_checks.offset.bends_focal_length


def test_exact_points_are_not_accused_beside_an_offset():
    for shift in (0, 3, 45):
        checks = solved_block(shift=(0, 0, shift), exact=True).survey_checks
        assert [name for name, one in checks.points.items() if one.is_suspect] == []
        assert checks.offset.is_significant == (shift > 0)


def test_a_wrong_point_is_accused_and_no_offset():
    for offset in ("none", "up"):
        checks = solved_block(wrong=(3, (0.2, 0.0, 0.0)), offset=offset).survey_checks
        assert [name for name, one in checks.points.items() if one.is_suspect] == ["t3"]
        assert checks.points["t3"].residual[0] == pytest.approx(-0.2, abs=0.08)
        assert not checks.offset.is_significant


def test_others_are_tested_again_without_an_accused_point():
    problem, positions, gcps, _ = block(wrong=(3, (0.2, 0.0, 0.0)))
    points = solved_block(wrong=(3, (0.2, 0.0, 0.0))).survey_checks.points
    gcps[3] = dataclasses.replace(gcps[3], sigma=(1e4, 1e4))
    others = solved(problem, positions, gcps).survey_checks.points
    for name in set(others) - {"t3"}:
        assert points[name].statistic == pytest.approx(others[name].statistic, rel=1e-3)


def test_an_offset_that_is_not_significant_has_its_value():
    found = solved_block(shift=(0, 0, -0.6)).survey_checks.offset
    estimated = solved_block(shift=(0, 0, -0.6), offset="up").survey_checks.offset
    assert not found.is_significant and not estimated.is_significant
    assert found.value[2] == pytest.approx(estimated.value[2], rel=0.05)


def test_two_wrong_points_are_accused_one_after_the_other():
    problem, positions, gcps, _ = block(wrong=(3, (0.3, 0.0, 0.0)))
    x, y, z = gcps[6].position
    gcps[6] = dataclasses.replace(gcps[6], position=(x, y - 0.3, z))
    checks = solved(problem, positions, gcps).survey_checks
    assert {name for name, one in checks.points.items() if one.is_suspect} == {"t3", "t6"}


def test_the_statistic_is_that_of_a_solve_without_the_point():
    problem, positions, gcps, _ = block()
    whole = solved_block()
    checks = whole.survey_checks
    for k in (0, 5):
        free = dataclasses.replace(gcps[k], sigma=(1e6, 1e6))
        others = [*gcps[:k], free, *gcps[k + 1 :]]
        without = solved(problem, positions, others)
        adjusted = without.survey_checks.points[f"t{k}"]
        # Without its survey, the residual of the point is the prediction by all else.
        assert checks.points[f"t{k}"].residual == pytest.approx(adjusted.residual, abs=2e-4)
        apart = whole.summary.final_cost - without.summary.final_cost
        assert checks.points[f"t{k}"].statistic == pytest.approx(2 * apart, rel=0.02)


def test_a_check_point_is_tested_and_pulls_nothing():
    problem, positions, gcps, _ = block(wrong=(3, (0.0, 0.0, 0.9)))
    gcps[3] = dataclasses.replace(gcps[3], role="check")
    result = solved(problem, positions, gcps)
    checks = result.survey_checks
    assert checks.points["t3"].is_suspect and checks.points["t3"].redundancy == 1
    assert [n for n, one in checks.points.items() if one.is_suspect] == ["t3"]
    assert checks.points["t3"].residual[2] == pytest.approx(-0.9, abs=0.2)


def test_sigmas_of_pixels_that_are_too_small_accuse_nothing():
    problem, positions, gcps, _ = block(exact=True)
    problem = problem.replace(observation_sigma=problem.observation_sigma / 20)
    gcps = [
        dataclasses.replace(
            one, measurements=[m._replace(sigma=NOISE / 20) for m in one.measurements]
        )
        for one in gcps
    ]
    checks = solved(problem, positions, gcps).survey_checks
    assert not any(one.is_suspect for one in checks.points.values())
    assert not checks.offset.is_significant


def test_a_result_pickles_with_the_outcome():
    result = solved_block(shift=(0, 0, 4))
    again = pickle.loads(pickle.dumps(result))
    assert again.survey_checks == result.survey_checks
    assert solved(*block()[:2], []).survey_checks is None


def test_rounds_and_held_out_carry_the_offset():
    problem, positions, gcps, truth = block(shift=(0, 0, 45), offset="up")
    found = bundle.solve_rounds(
        problem, priors=[*positions, *gcps], num_rounds=2, max_error=4, min_angle=0, hold_out=10,
        num_threads=1,
    )  # fmt: skip
    assert found.problem.num_images == truth.num_images
    assert found.survey_checks.offset.value[2] == pytest.approx(45, abs=1.5)
    assert found.held_out.rmse < 1.5


def test_covariance_has_the_images_of_the_model():
    _, positions, gcps, truth = block(shift=(0, 0, 45), offset="up")
    result = solved_block(shift=(0, 0, 45), offset="up")
    sigmas = []
    for priors in ([*positions, *gcps], [*moved(positions, (0, 0, 45)), *gcps]):
        found = bundle.covariance(result.problem, priors=priors, gauge="none", num_threads=1)
        assert found.pose_covariance.shape == (truth.num_images, 6, 6)
        sigmas.append(np.sqrt(found.camera_covariance[0, 0, 0]))
    assert sigmas[0] > 5 * sigmas[1]  # an unknown offset leaves f to the relief


def test_what_does_not_determine_an_offset_is_refused():
    problem, positions, gcps, _ = block(offset="up")
    with pytest.raises(bundle.InputError, match=r"gps_offset.*control points"):
        solved(problem, positions, [])
    flat = [dataclasses.replace(one, position=(*one.position[:2], np.nan)) for one in gcps]
    with pytest.raises(bundle.InputError, match=r"gps_offset.*height"):
        solved(problem, positions, flat)
    with pytest.raises(bundle.InputError, match="offset"):
        PositionPrior(1, (0, 0, 0), 1, offset="down")


def test_weighted_points():
    # One axis: v = 2, P = 0.5, w = 0.8: left = 0.6, d = 2 / 0.6, c = 1 + 0.5 / 0.6.
    sigma = np.array([0.1, np.inf, np.inf])
    point = PointCheck.of(np.array([0.2, 5, 5]), sigma, 0.005 * np.eye(3), 0.8)
    assert point.freedom == 1 and point.redundancy == pytest.approx(0.6)
    assert point.residual[0] == pytest.approx(0.2 / 0.6)
    assert point.statistic == pytest.approx((2 / 0.6) ** 2 / (1 + 0.5 / 0.6))
    held = PointCheck.of(np.array([0.0, 5, 5]), sigma, 0.0091 * np.eye(3), 1.0)
    assert held.redundancy == pytest.approx(0.09) and not held.is_checked
    assert PointCheck.of(np.array([0.0, 5, 5]), sigma, 0.0089 * np.eye(3), 1.0).is_checked


def test_levels():
    assert scaled_tail(16.26, 3, 0.5, 50) > 1e-3 > scaled_tail(16.27, 3, 0.5, 50)
    # T (nu - m) / (m (nu - T)) with T = 8, m = 3, nu = 19: 8 * 16 / 33 = 3.8788, F(3, 16).
    for scale2 in (4.0, 1.0001):
        assert scaled_tail(8.0 * scale2, 3, scale2, 19) == pytest.approx(0.0293081, rel=1e-5)
    assert scaled_tail(16.26, 3, 1.0, 19) > 1e-3 > scaled_tail(16.27, 3, 1.0, 19)
    make = {"axes": "up", "value": (0, 0, 1.0), "sigma": (0, 0, 0.1), "statistic": 5.0,
                "is_estimated": False, "focal_lengths": (1.0, 1.0, 0.1)}  # fmt: skip
    assert OffsetCheck(p=0.99e-3, **make).is_significant
    assert not OffsetCheck(p=1.01e-3, **make).is_significant
    for axes, limit in (("up", 10.8276), ("all", 16.2662)):
        below, above = (
            OffsetCheck(p=0.5, **{**make, "axes": axes, "statistic": limit + by})
            for by in (-0.01, 0.01)
        )
        assert above.may_explain(limit) and not above.may_explain(limit + 0.02)
        assert not below.may_explain(0)


def test_an_offset_that_a_loss_hides_is_found():
    problem, positions, gcps, _ = block(shift=(0, 0, 45))
    robust = [dataclasses.replace(one, loss="cauchy") for one in [*positions, *gcps]]
    offset = solved(problem, robust, []).survey_checks.offset
    assert offset.is_significant and offset.value[2] == pytest.approx(45, abs=1.5)


def test_pixel_noise_that_is_larger_than_stated_makes_no_offset():
    problem, positions, gcps, _truth = block()
    rng = np.random.default_rng(6)
    noisy = problem.observation_xy + 8 * NOISE * rng.normal(size=problem.observation_xy.shape)
    worse = problem.replace(observation_xy=noisy)
    checks = solved(worse, positions, gcps).survey_checks
    assert not checks.offset.is_significant and not checks.offset.is_estimated
    assert checks.offset.focal_lengths[0] == checks.offset.focal_lengths[1]
