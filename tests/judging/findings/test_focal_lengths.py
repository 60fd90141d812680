"""Findings about focal lengths, at the limits of their tests and with exact numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.judging.findings import focal_lengths as module
from bundle.judging.findings.find import find
from bundle.judging.findings.focal_lengths import (
    FocalLengths,
    focal_drift,
    focal_lengths,
    is_near,
    local_lens,
    undetermined_intrinsics,
)
from bundle.judging.findings.next_command import NextCommand
from bundle.model.residuals import errors_or_nan
from tests.campaigns.findings import make

FOCAL = 1000.0


def group(focal, sigma=1.0, distortion=0.0, factor=1.0):
    focal = np.asarray(focal, float)
    return FocalLengths(
        cameras=np.arange(len(focal)),
        focal=focal,
        sigma=np.full(len(focal), sigma),
        distortion=distortion,
        relative_sigma=factor * np.full(len(focal), sigma) / focal,
        order=np.linspace(-1.0, 1.0, len(focal)),
        is_covered=True,
    )


MEASURED = SimpleNamespace(
    command=NextCommand(),
    whole=SimpleNamespace(
        camera_ids=np.arange(1, 101),
        image_camera=np.arange(100),
        num_frames=0,
        camera_models=("PINHOLE",) * 100,
        camera_params=np.full((100, 4), FOCAL),
    ),
    start=None,
)


def drifting(change, num=10, sigma=1.0):
    """Focal lengths that change by a share of their mean from the first to the last."""
    return group(FOCAL * (1 + change / 2 * np.linspace(-1, 1, num)), sigma)


ZIGZAG = np.tile([1.0, -1.0], 5)


@pytest.mark.parametrize("change", [0.05, -0.05])
def test_a_drift_has_its_size_and_its_sign(change):
    found = focal_drift(MEASURED, [drifting(change)])
    assert found.evidence["change"] == pytest.approx(change, rel=1e-12)
    spread = (np.linspace(-1, 1, 10) ** 2).sum()
    assert found.evidence["chi2"] == pytest.approx((FOCAL * change / 2) ** 2 * spread, rel=1e-9)
    assert f"{100 * change:+.1f} %" in found.sentence
    assert found.command == ""  # a prior at the present values would undo the drift
    known = np.linspace(1.0, 3.0, 10)
    given = drifting(change, sigma=known)
    found = focal_drift(MEASURED, [given])
    mean = np.average(given.focal, weights=known**-2.0)
    assert found.evidence["change"] == pytest.approx(FOCAL * change / mean, rel=1e-12)


@pytest.mark.parametrize(
    ("given", "is_found"),
    [
        (drifting(0.0201), True),
        (drifting(0.0199), False),
        (drifting(0.05, num=6), True),
        (drifting(0.05, num=5), False),
        (drifting(0.05, sigma=9.10), True),  # gain 30.7
        (drifting(0.05, sigma=9.30), False),  # gain 29.4
        (group(drifting(0.05).focal, factor=48.0), True),
        (group(drifting(0.05).focal, factor=49.0), False),  # 5.03 % of 975 px: not determined
        (group(drifting(0.05).focal + 7.5 * ZIGZAG), True),  # gain 31 times what is left
        (group(drifting(0.05).focal + 8.0 * ZIGZAG), False),  # 27 times
    ],
)
def test_limits_of_a_drift(given, is_found):
    assert (focal_drift(MEASURED, [given]) is not None) == is_found


def test_a_weak_joint_makes_the_limit_of_a_drift_three_times_as_high():
    for sigma, is_found in ((5.20, True), (5.40, False)):  # gains 94.1 and 87.3
        found = focal_drift(MEASURED, [drifting(0.05, sigma=sigma)], is_jointed=True)
        assert (found is not None) == is_found


def test_the_largest_undetermined_group_is_named_with_its_command():
    for sigma, is_found in ((50.1, True), (49.9, False)):
        found = undetermined_intrinsics(MEASURED, [group([FOCAL], sigma)])
        assert (found is not None) == is_found
    found = undetermined_intrinsics(MEASURED, [group([FOCAL], 100.0)])
    assert found.command.endswith("--set 'camera 1: f prior 2 %'")
    assert found.evidence["relative_sigma"] == [pytest.approx(0.1)]
    assert undetermined_intrinsics(MEASURED, [group([FOCAL], 100.0, factor=0.4)]) is None


def test_the_group_with_most_open_cameras_is_named_and_only_these(monkeypatch):
    monkeypatch.setattr(module, "joint_statistic", lambda *_: (100.0, 1))  # lenses differ
    largest = replace(group([FOCAL] * 5), relative_sigma=np.array([0.9, 0, 0, 0, 0]))
    most = replace(group([FOCAL] * 3), relative_sigma=np.array([0.06, 0.03, 0.06]))
    for groups in ([largest, most], [most, largest]):
        found = undetermined_intrinsics(MEASURED, groups)
        assert found.evidence["camera_ids"] == [1, 3]
        assert found.evidence["relative_sigma"] == [0.06, 0.06]
        assert found.command.endswith("'cameras 1,3: f prior 2 %'")
    found = undetermined_intrinsics(MEASURED, [largest, most], 0.02)
    assert found.evidence["camera_ids"] == [1, 2, 3]
    assert undetermined_intrinsics(MEASURED, [], 0.02) is None


@pytest.mark.parametrize(("start", "is_advised"), [(0.97, True), (0.95, False)])
def test_no_prior_holds_a_start_that_the_other_lenses_have_left(monkeypatch, start, is_advised):
    monkeypatch.setattr(module, "joint_statistic", lambda *_: (100.0, 1))  # lenses differ
    lenses = replace(group([FOCAL] * 3), relative_sigma=np.array([0.002, 0.3, 0.002]))
    before = SimpleNamespace(**vars(MEASURED.whole) | {"camera_params": np.full((100, 4), FOCAL)})
    before.camera_params[2] *= start  # 3.1 and 5.3 %, of 4.02 % for f that is determined to 0.2 %
    measured = SimpleNamespace(**vars(MEASURED) | {"start": before})
    found = undetermined_intrinsics(measured, [lenses])
    assert found.evidence["camera_ids"] == [2]
    assert bool(found.command) == is_advised
    monkeypatch.setattr(module, "joint_statistic", lambda *_: (1.0, 1))  # one lens needs no start
    assert "--share-cameras" in undetermined_intrinsics(measured, [lenses]).command


@pytest.mark.parametrize(("sigma", "reach"), [(1.0, 0.0400499), (50.0, 0.1077033)])
def test_a_start_is_near_within_two_standard_deviations_of_both(sigma, reach):
    def near(moved, start):
        models = [
            None if one is None else SimpleNamespace(camera_models=both, camera_params=one)
            for one in (moved, start)
        ]
        return is_near(SimpleNamespace(whole=models[0], start=models[1]), found)

    found, both = group([FOCAL] * 3, sigma), ("PINHOLE",) * 3
    given = np.full((3, 4), FOCAL)
    for share, expected in ((0.999, True), (1.001, False)):
        for column, sign in ((0, 1), (1, -1)):  # a single focal length decides
            moved = given.copy()
            moved[2, column] *= 1 + sign * share * reach
            assert near(moved, given) == expected
            assert near(moved, None)  # the model is the start
    assert near(given * [1.0, 1.0, 2.0, 2.0], given)  # the principal point does not matter


def test_rules_of_the_solve_determine_a_focal_length():
    """Advice that was followed is not given again."""
    problem = make(20_000, ("undetermined_intrinsics",)).start
    rule = "camera 1: f prior 2 %"
    result = bundle.solve(problem, constraints=[rule], max_num_iterations=200)
    kinds = [
        [one.kind for one in find(result.problem, constraints=rules)] for rules in ((), [rule])
    ]
    assert "undetermined_intrinsics" in kinds[0] and "undetermined_intrinsics" not in kinds[1]


def groups_of(seen, scale=0.5):
    """Return the groups of five cameras, of which some are seen by an image or two."""
    known = np.arange(20.0).reshape(5, 4) + 1
    params = 100 * np.arange(1.0, 21).reshape(5, 4)
    params[1, 1] = 500.0  # sigmas of 1 % in fx, 1.2 % in fy
    image_camera = np.array([2, 0, 3, 1, 2, 4])
    whole = SimpleNamespace(
        num_cameras=5, num_images=6, image_ids=np.array([30, 20, 10, 5, 7, 3]),
        image_camera=image_camera, camera_params=params,
        observation_image=np.flatnonzero(np.isin(image_camera, seen)),
        camera_models=("SIMPLE_RADIAL", "PINHOLE", *("SIMPLE_RADIAL",) * 3),
        camera_sizes=np.array([[8, 6], [8, 6], [8, 6], [8, 6], [6, 8]]),
    )  # fmt: skip
    measured = SimpleNamespace(known_lens_sigmas=(known, 1.0), whole=whole, scale=scale)
    return known, params, list(focal_lengths(measured))


def test_cameras_of_one_model_and_size_are_in_the_order_of_their_images():
    known, params, (first, pinhole, turned) = groups_of([0, 1, 2, 3, 4])
    assert first.cameras.tolist() == [2, 3, 0] and first.order.tolist() == [-1, 0, 1]
    assert (pinhole.cameras.tolist(), turned.cameras.tolist()) == ([1], [4])
    np.testing.assert_array_equal(first.focal, params[[2, 3, 0], 0])
    np.testing.assert_array_equal(first.sigma, known[[2, 3, 0], 0])
    assert (pinhole.focal, pinhole.sigma) == (params[1, :2].mean(), known[1, :2].mean())
    weight = known[[2, 3, 0], 3] ** -2
    k = params[[2, 3, 0], 3]
    mean = (weight * k).sum() / weight.sum()
    assert first.distortion == pytest.approx((weight * (k - mean) ** 2).sum() / 2)
    assert pinhole.distortion == 0 and pinhole.order.tolist() == [0]
    # Half of the noise is that of outliers; of fx and fy, the less certain one counts.
    np.testing.assert_allclose(first.relative_sigma, 0.5 * (known / params)[[2, 3, 0], 0])
    assert pinhole.relative_sigma == pytest.approx(0.5 * max(known[1, :2] / params[1, :2]))
    assert groups_of([0], scale=2.0)[2][0].relative_sigma == known[0, 0] / params[0, 0]


@pytest.mark.parametrize(("seen", "is_covered"), [((0, 2), [True]), ((0, 1), [False, False])])
def test_a_group_with_all_cameras_that_are_seen_covers_the_model(seen, is_covered):
    assert [one.is_covered for one in groups_of(seen)[2]] == is_covered


@pytest.mark.parametrize("rest", ["fixed", "marginal"])
def test_a_local_adjustment_whose_lens_harms_other_images_is_named(rest):
    scene = bundle.synthesize(num_images=12, num_points=200, scene="drone-grid", seed=1)
    model = bundle.solve(scene.problem).problem
    named = model.image_ids[:3]

    def local(**options):
        result = bundle.solve_rounds(
            model, num_rounds=0, only_images=options.pop("images", named), rest=rest, **options
        )
        return result, local_lens(result, NextCommand(given=("--only-images", "1-3")))

    result, found = local()
    if rest == "marginal":
        assert found == ()
        return
    (one,) = found
    assert one.command.endswith(" --only-images 1-3 --fix-cameras 1")
    end, given = result.problem, result.problem.replace(camera_params=model.camera_params)
    near = np.isin(end.observation_point, end.observation_point[end.observation_image < 3])
    rmse = [np.sqrt((errors_or_nan(one)[~near] ** 2).mean()) for one in (given, end)]
    np.testing.assert_allclose(
        [one.evidence["rmse_before"], one.evidence["rmse"]], rmse, rtol=1e-12
    )
    assert rmse[1] > 1.01 * rmse[0] and one.evidence["num_images"] == 9
    assert local(fixed_camera_ids=[1])[1] == () == local(images=model.image_ids)[1]
    assert local(refine=("poses", "points"))[1] == ()
