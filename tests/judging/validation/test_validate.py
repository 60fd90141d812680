"""Validation of candidates: reference numbers, planted lenses, and inputs of all kinds."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.judging.validation.validation_result import decide
from bundle.model.folds import folds_of
from bundle.model.residuals import summarize_clipped
from bundle.solving.hold_out import with_values
from tests.georeference.flights import flight
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, residuals, scene, with_observations

DATA = Path(os.environ.get("BUNDLE_DATA", "../shared/data"))
TIGHT = {"function_tolerance": 1e-12, "gradient_tolerance": 1e-14, "parameter_tolerance": 1e-14}
QUICK = {"num_folds": 3, "camera_models": "SIMPLE_RADIAL,OPENCV", "share": "size,each"}


def photographs(num_images=10, num_points=400, k=-0.1, **changes):
    """Return photographs of one lens with a camera each, far enough from the middle to see k."""
    rng = np.random.default_rng(1)
    problem = make_problem(num_images=num_images, num_points=num_points, noise=0.4, **changes)
    params = problem.camera_params.copy()
    params[:, 0], params[:, 3] = 700, k
    truth = problem.replace(camera_params=params)
    noise = 0.4 * rng.standard_normal((truth.num_observations, 2))
    xy = problem.observation_xy + residuals(truth) + noise
    return with_observations(
        truth.replace(observation_xy=xy), rng.random(truth.num_observations) < 0.5
    )


def real(name):
    path = DATA / "colmap" / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    return bundle.load(path)


@pytest.mark.parametrize(
    ("name", "model", "share", "backend", "expected"),
    [
        ("bartoszek", "SIMPLE_RADIAL", "size", "ceres", 1.8020750316),
        ("bartoszek", "OPENCV", "size", "ceres", 1.7976744056),
        ("bartoszek", "OPENCV", "each", "fused", 1.8064073005),
        ("crane_mast", "SIMPLE_RADIAL", "size", "fused", 2.6774485689),
        ("crane_mast", "OPENCV", "size", "fused", 1.5836311620),
    ],
)
def test_held_out_errors_of_real_models(name, model, share, backend, expected):
    found = bundle.validate(
        real(name),
        camera_models=model,
        share=share,
        losses="trivial",
        backend=backend,
        max_num_iterations=500,
        **TIGHT,
    )
    assert found.candidates[0].held_out_rmse == pytest.approx(expected, abs=1e-6)
    assert found.candidates[0].is_converged


def test_errors_are_those_of_fits_by_hand():
    problem = photographs()
    options = {**TIGHT, "loss": "cauchy"}
    found = bundle.validate(
        problem, camera_models="SIMPLE_RADIAL", share="input", num_folds=3, **TIGHT
    )
    folds, errors = folds_of(problem, 3), np.full(problem.num_observations, np.nan)
    for fold in range(3):
        kept = problem.select(observations=folds != fold).problem
        fitted = with_values(problem, bundle.solve(kept, **options).problem)
        errors[folds == fold] = bundle.reprojection_errors(fitted)[0][folds == fold]
    rows = np.flatnonzero(folds >= 0)
    np.testing.assert_array_equal(found.observations, rows)
    np.testing.assert_allclose(found.errors[0], errors[rows], rtol=1e-4, atol=1e-4)
    one = found.candidates[0]
    assert one.held_out_rmse == pytest.approx(
        summarize_clipped(errors[rows]).clipped_rmse, rel=1e-6
    )
    full = bundle.solve(problem, **options)
    assert one.fitted_rmse == pytest.approx(full.reprojection_error_after.rmse, rel=1e-6)


def test_one_lens_is_found_and_can_be_decided_again_from_the_arrays():
    found = bundle.validate(photographs(), **QUICK)
    chosen = found.candidates[found.recommended]
    assert (chosen.camera_model, chosen.share, chosen.num_intrinsics) == (
        "SIMPLE_RADIAL",
        "size",
        2,
    )
    assert "--share-cameras size" in found.command
    assert found.verdict in ("simpler", "no difference")
    again = decide(
        found.normalized,
        found.image,
        [one.num_intrinsics for one in found.candidates],
        [one.vetoed for one in found.candidates],
    )
    assert again.recommended == found.recommended
    np.testing.assert_array_equal(again.scores, [one.score for one in found.candidates])
    assert found.sigma == pytest.approx(0.4, rel=0.15)
    each = next(one for one in found.candidates if one.share == "each")
    assert each.position_sigma > chosen.position_sigma
    assert each.num_parameters - chosen.num_parameters == each.num_intrinsics - 2
    assert chosen.bic == 0
    assert "SIMPLE_RADIAL, shared" in repr(found)


def test_a_lens_that_is_too_small_is_replaced():
    problem = photographs(k=-0.2)
    pinhole = bundle.change_camera_model(bundle.share_cameras(problem), "SIMPLE_PINHOLE").problem
    found = bundle.validate(pinhole, camera_models="SIMPLE_PINHOLE,SIMPLE_RADIAL")
    assert found.verdict == "better"
    assert found.candidates[found.recommended].camera_model == "SIMPLE_RADIAL"
    assert found.present == 0
    assert found.candidates[0].difference > 4 * found.candidates[0].standard_error
    assert found.candidates[0].bic > 0


def test_lenses_that_differ_are_not_shared():
    problem = photographs()
    zoom = np.random.default_rng(5).uniform(0.8, 1.2, problem.num_images)
    params = problem.camera_params.copy()
    params[:, 0] *= zoom
    old = problem.camera_params[0, 1:3]
    scale = zoom[problem.observation_image][:, None]
    zoomed = problem.replace(
        camera_params=params, observation_xy=old + (problem.observation_xy - old) * scale
    )
    found = bundle.validate(zoomed, num_folds=3, camera_models="SIMPLE_RADIAL")
    assert [one.share for one in found.candidates] == ["size", "focal", "each"]
    chosen = found.candidates[found.recommended]
    assert chosen.share == "focal"
    assert found.candidates[0].held_out_rmse > 1.5 * chosen.held_out_rmse


def test_candidates_that_cannot_start_leave_the_others():
    problem = photographs(num_images=6)
    sizes = problem.camera_sizes.copy()
    sizes[0] = [400, 300]
    found = bundle.validate(
        problem.replace(camera_sizes=sizes), camera_models="SIMPLE_RADIAL", share="each,all"
    )
    shares = {one.share: one for one in found.candidates}
    assert "expected the size of camera" in shares["all"].error
    assert np.isnan(shares["all"].held_out_rmse)
    assert found.candidates[found.recommended].share == "each"
    assert any("cannot start" in note for note in found.notes)
    with pytest.raises(bundle.InputError, match=r"candidates: .*expected the size of camera"):
        bundle.validate(problem.replace(camera_sizes=sizes), share="all", camera_models="RADIAL")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_folds": 1}, "num_folds: expected"),
        ({"seed": -1}, "seed: expected"),
        ({"camera_models": "OPENCVV"}, "camera_models: expected"),
        ({"share": "some"}, "share: expected"),
        ({"losses": ("huge",)}, "losses: expected"),
        ({"refine_sets": [["poses", "everything"]]}, "refine: expected"),
        ({"clip": 0}, "clip: expected"),
        ({"progress": 3}, "progress: expected"),
    ],
)
def test_bad_arguments(changes, message):
    with pytest.raises(bundle.InputError, match=message):
        bundle.validate(photographs(), **changes)


def test_too_few_observations_to_hold_out():
    with pytest.raises(bundle.InputError, match=r"^problem: expected at least 50 observations"):
        bundle.validate(make_problem(num_images=6, num_points=200, track=2))
    with pytest.raises(bundle.InputError, match=r"^problem: expected at least 50 observations"):
        bundle.validate(make_problem(num_images=3, num_points=12))


def test_folds_longer_than_the_tracks():
    """With more folds than images of a point each fold holds out one image of it or none."""
    found = bundle.validate(
        photographs(), num_folds=50, camera_models="SIMPLE_RADIAL", share="size"
    )
    assert np.isfinite(found.candidates[0].score)
    assert found.verdict == "unknown"


@pytest.mark.parametrize("kind", ["bal", "rigs", "fisheye", "one camera", "sigmas"])
def test_inputs_of_all_kinds(kind):
    problem = {
        "bal": lambda: scene(num_images=6, num_points=80),
        "rigs": lambda: rig_problem(num_alone=2),
        "fisheye": lambda: make_problem(model="OPENCV_FISHEYE", num_points=80),
        "one camera": lambda: make_problem(shared=True, num_points=80),
        "sigmas": lambda: make_problem(num_points=80).replace(observation_sigma=np.full(400, 0.5)),
    }[kind]()
    found = bundle.validate(problem, num_folds=3)
    assert found.present >= 0
    assert all(not one.error for one in found.candidates), [one.error for one in found.candidates]
    assert np.isfinite([one.score for one in found.candidates]).all()
    assert found.candidates[found.recommended].num_intrinsics <= 30
    if kind == "sigmas":
        assert found.sigma == pytest.approx(1.0, rel=0.25)  # 0.5 px of noise in units of 0.5


def test_order_of_rows_and_frame_of_the_world_have_no_influence():
    problem, rng = photographs(), np.random.default_rng(0)
    rows = rng.permutation(problem.num_observations)
    tight = {**QUICK, "function_tolerance": 1e-10}
    plain = bundle.validate(problem, **tight)
    mixed = bundle.validate(with_observations(problem, rows), **tight)
    scores = [[one.score for one in found.candidates] for found in (plain, mixed)]
    np.testing.assert_allclose(scores[0], scores[1], rtol=1e-5)
    large = problem.cam_from_world.copy()
    large[:, 4:] *= 100
    scaled = bundle.validate(
        problem.replace(cam_from_world=large, points=100 * problem.points), **tight
    )
    np.testing.assert_allclose(scores[0], [one.score for one in scaled.candidates], rtol=1e-4)
    ratios = [
        b.position_sigma / a.position_sigma
        for a, b in zip(plain.candidates, scaled.candidates, strict=True)
    ]
    np.testing.assert_allclose(ratios, 100, rtol=1e-2)


def test_progress_and_interruption():
    told = []
    found = bundle.validate(photographs(), progress=lambda *step: told.append(step), **QUICK)
    assert sorted(done for done, _, _ in told) == list(range(1, 17))
    assert {count for _, count, _ in told} == {16}
    assert {name for _, _, name in told} == {one.name for one in found.candidates}

    def stop(done, _count, _name):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bundle.validate(photographs(), progress=stop, **QUICK)


def test_check_points_and_positions_are_measured_for_each_candidate():
    places = [[-20, 0, 0], [20, 3, 1], [0, 25, 0.5], [5, -22, 0], [12, 14, 0.3]]
    made = flight(places, noise=0.5, num_points=300)
    gcps = [*made.gcps[:4], dataclasses.replace(made.gcps[4], role="check")]
    centers, rng = made.truth.projection_centers, np.random.default_rng(0)
    gps = [
        bundle.PositionPrior(name, centers[row] + 0.5 * rng.standard_normal(3), 0.5)
        for row, name in enumerate(made.problem.image_names)
    ]
    problem = made.elsewhere()
    found = bundle.validate(problem, priors=[*gcps, *gps], num_folds=3, **{
        "camera_models": "SIMPLE_PINHOLE,SIMPLE_RADIAL", "share": "size",
        "function_tolerance": 1e-9,
    })  # fmt: skip
    assert len(found.observations) <= problem.num_observations  # pixels of targets are not held out
    for one in found.candidates:
        lens = bundle.change_camera_model(problem, one.camera_model).problem
        solved = bundle.solve(
            lens, priors=[*gcps, *gps], loss="cauchy", align=True, function_tolerance=1e-9
        )
        check = np.linalg.norm(solved.control_points[4].residual)
        assert one.check_points_rms == pytest.approx(check, rel=0.02, abs=1e-4)
        apart = solved.problem.projection_centers - [prior.position for prior in gps]
        assert one.gps_rms == pytest.approx(np.sqrt((apart**2).sum() / len(gps)), rel=1e-2)
    assert found.candidates[found.recommended].camera_model == "SIMPLE_RADIAL"
    assert found.candidates[1].check_points_rms < 0.2


def test_rules_hold_images_while_lenses_are_merged():
    """Merging lenses moves images along their axes to keep their scale: not those of a rule."""
    problem = photographs()
    params = problem.camera_params.copy()
    params[:, 0] *= np.linspace(0.98, 1.02, len(params))
    problem = problem.replace(camera_params=params)
    rules = ("images *: position fixed", "images *: rotation fixed")
    found = bundle.validate(
        problem, camera_models="SIMPLE_RADIAL", share="all", num_folds=3, constraints=rules, **TIGHT
    )
    shared = bundle.share_cameras(problem)
    by_hand = bundle.solve(shared, loss="cauchy", constraints=rules, **TIGHT)
    np.testing.assert_array_equal(by_hand.problem.cam_from_world, problem.cam_from_world)
    (one,) = found.candidates
    assert one.fitted_rmse == pytest.approx(by_hand.reprojection_error_after.rmse, rel=1e-6)
