"""Lenses that agree: the joint test over focal length and distortion, and what it advises."""

import shlex
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

import bundle
from bundle.judging.findings import focal_lengths as module
from bundle.judging.findings.find import find
from bundle.judging.findings.focal_lengths import FocalLengths, joint_statistic, shared_lens
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from tests.judging.findings.dense_normal_equations import Dense
from tests.rig_scenes import rig_problem


def solved(scene="orbit", *, differs=0.0, seed=1, images=8, points=90, share=True):
    """Solve a scene with a lens per image, equal but for k, which differs by so much."""
    made = bundle.synthesize(
        scene=scene, num_images=images, num_points=points, seed=seed, pixel_noise=0.5,
        cameras="shared" if share else "individual",
    )  # fmt: skip
    problem = bundle.split_cameras(made.ground_truth)
    if differs:
        params = problem.camera_params.copy()
        params[:, 3] += differs * np.random.default_rng(seed).standard_normal(len(params))
        before, after = (pixels(problem), pixels(problem.replace(camera_params=params)))
        problem = problem.replace(observation_xy=problem.observation_xy + after - before)
    return bundle.solve(problem, num_threads=1, max_num_iterations=200).problem


def pixels(problem):
    from bundle.model.residuals import residuals

    return problem.observation_xy + residuals(problem, "algebraic").xy


def measured(problem, **more):
    return Measured(whole=problem, command=NextCommand(), **more)


def group_of(problem, cameras=None, **more):
    cameras = np.arange(problem.num_cameras) if cameras is None else np.array(cameras)
    known = {
        "focal": problem.camera_params[cameras, 0],
        "sigma": np.full(len(cameras), 2.0),
        "distortion": 1.5,
        "relative_sigma": np.full(len(cameras), 0.002),
        "order": np.zeros(len(cameras)),
        "is_covered": len(cameras) == problem.num_cameras,
    }
    return FocalLengths(cameras=cameras, **{**known, **more})


@pytest.mark.parametrize("cameras", [None, [1, 4, 6]])
def test_the_statistic_is_that_of_the_dense_covariance(cameras):
    problem = solved(differs=0.02)
    group = group_of(problem, cameras)
    dense = Dense(problem)
    columns = [dense.columns[camera, k] for camera in group.cameras for k in (0, 3)]
    covariance = dense.inverse[np.ix_(columns, columns)]
    theta = problem.camera_params[group.cameras][:, [0, 3]].reshape(-1)
    count = len(group.cameras)
    contrasts = np.kron(np.eye(count)[1:] - np.eye(count)[:1], np.eye(2))
    difference = contrasts @ theta
    wanted = difference @ np.linalg.solve(contrasts @ covariance @ contrasts.T, difference)
    residual_variance = (
        2 * problem.num_observations - dense.num_parameters
    ) * dense.variance + dense.explained
    wanted /= residual_variance / (2 * problem.num_observations - dense.num_parameters)
    statistic, degrees = joint_statistic(measured(problem), group)
    assert degrees == 2 * (count - 1)
    assert statistic == pytest.approx(wanted, rel=1e-4)


def test_held_distortion_does_not_count():
    problem = solved()
    held = bundle.SolveOptions(refine=("poses", "points", "focal"))
    _, degrees = joint_statistic(measured(problem, options=held), group_of(problem))
    assert degrees == problem.num_cameras - 1


def test_too_many_lenses_are_not_compared(monkeypatch):
    problem = solved()
    monkeypatch.setattr(module, "MOST_FUNCTIONS", 2 * problem.num_cameras)
    assert joint_statistic(measured(problem), group_of(problem)) is not None
    monkeypatch.setattr(module, "MOST_FUNCTIONS", 2 * problem.num_cameras - 1)
    assert joint_statistic(measured(problem), group_of(problem)) is None


def rational(differs):
    """Solve with a FULL_OPENCV lens per image, equal but for k1, which differs by so much."""
    made = bundle.synthesize(
        scene="orbit", num_images=8, num_points=800, seed=3, pixel_noise=0.5, cameras="shared"
    )
    straight = bundle.change_camera_model(made.ground_truth, "FULL_OPENCV").problem
    straight = bundle.split_cameras(straight)
    params = straight.camera_params.copy()
    params[:, 4:12] = (-0.2, 0.05, 0.0, 0.0, 0.02, 0.1, 0.0, 0.0)
    params[:, 4] += differs * np.random.default_rng(3).standard_normal(len(params))
    lenses = straight.replace(camera_params=params)
    seen = straight.observation_xy + pixels(lenses) - pixels(straight)
    problem = lenses.replace(observation_xy=seen)
    return bundle.solve(problem, num_threads=1, max_num_iterations=300).problem


@pytest.mark.parametrize(("differs", "ratios"), [(0.0, (0.0, 2.0)), (0.1, (4.0, 40.0))])
def test_lenses_whose_distortion_is_a_ratio_are_compared_by_their_costs(
    monkeypatch, differs, ratios
):
    problem = rational(differs)
    group = group_of(problem)
    statistic, degrees = joint_statistic(measured(problem), group)
    assert degrees == 7 * 10
    assert ratios[0] < statistic / degrees < ratios[1]
    own = bundle.solve(problem, num_threads=1).summary.initial_cost
    shared = bundle.share_cameras(problem)
    one = bundle.solve(shared, max_num_iterations=300, num_threads=1).summary.final_cost
    dof = 2 * problem.num_observations - 3 * problem.num_points - 8 * (6 + 10) + 7
    assert statistic == pytest.approx((one - own) / own * dof, rel=0.02, abs=3.0)
    # Coefficients on a curve: linear, even equal lenses seem to differ.
    monkeypatch.setattr(module, "is_affordable", lambda _: False)
    linear, _ = joint_statistic(measured(problem), group)
    assert linear > 10 * degrees


def advised(monkeypatch, problem, ratio, group=None, **more):
    """Return the finding for T / dof."""
    monkeypatch.setattr(module, "joint_statistic", lambda *_: (10 * ratio, 10))
    return shared_lens(measured(problem), [group_of(problem) if group is None else group], **more)


def test_what_is_advised_on_both_sides_of_each_threshold(monkeypatch):
    problem = solved()
    share = advised(monkeypatch, problem, 2 - 1e-9)
    assert share.command == "bundle refine INPUT -o OUTPUT --share-cameras all"
    for ratio in (2 + 1e-9, 4 - 1e-9):
        unsure = advised(monkeypatch, problem, ratio)
        assert unsure.command == "bundle validate INPUT" and "differ" in unsure.sentence
    assert advised(monkeypatch, problem, 4 + 1e-9) is None
    joint = {"is_jointed": True}  # only the limit of the finding is three times as high
    assert "share" in advised(monkeypatch, problem, 2 - 1e-9, **joint).command
    assert "validate" in advised(monkeypatch, problem, 2 + 1e-9, **joint).command
    assert "validate" in advised(monkeypatch, problem, 12 - 1e-9, **joint).command
    assert advised(monkeypatch, problem, 12 + 1e-9, **joint) is None
    evidence = share.evidence
    assert evidence["joint_chi2"] == pytest.approx(20) and evidence["joint_dof"] == 10
    assert evidence["p"] == pytest.approx(chi2.sf(20, 10), rel=1e-6)
    assert evidence["dof"] == problem.num_cameras - 1
    focal = problem.camera_params[:, 0]
    assert evidence["chi2"] == pytest.approx((((focal - focal.mean()) / 2.0) ** 2).sum())
    assert evidence["distortion_chi2_per_dof"] == 1.5


def test_groups_that_are_not_compared(monkeypatch):
    problem = solved()
    loose = group_of(problem, relative_sigma=np.r_[0.002 * np.ones(7), 0.0501])
    tight = group_of(problem, relative_sigma=np.r_[0.002 * np.ones(7), 0.0499])
    assert advised(monkeypatch, problem, 1.0, loose) is None
    assert advised(monkeypatch, problem, 1.0, tight) is not None
    assert advised(monkeypatch, problem, 1.0, group_of(problem, [3])) is None
    some = advised(monkeypatch, problem, 1.0, group_of(problem, [1, 3]))
    assert some.command.endswith("--share-cameras 2,4")
    order = np.linspace(-1, 1, 8)
    drifting = group_of(problem, focal=1000 + 20 * order, order=order)
    assert advised(monkeypatch, problem, 1.0, drifting) is None


def test_the_largest_group_counts(monkeypatch):
    problem = solved()
    monkeypatch.setattr(module, "joint_statistic", lambda *_: (1.0, 10))
    groups = [group_of(problem, [0, 1]), group_of(problem, [2, 3, 4])]
    assert shared_lens(measured(problem), groups).evidence["camera_ids"] == [3, 4, 5]


def test_equal_lenses_are_shared_and_different_distortion_is_not():
    (found,) = find(solved("drone-grid", images=10, points=200))
    assert found.kind == "shared_lens" and "--share-cameras all" in found.command
    for seed in (2, 3):
        different = solved("drone-grid", images=10, points=200, seed=seed, differs=0.017)
        assert "shared_lens" not in {one.kind for one in find(different)}


def test_sensors_of_rigs_are_tied_by_a_command_that_runs():
    rig = rig_problem(num_frames=6, num_points=150)
    group = group_of(rig)
    stub = SimpleNamespace(whole=rig, command=NextCommand())
    flag, rule = module._sharing(rig, group)
    assert flag == "--set"
    result = bundle.solve(rig, constraints=[rule], num_threads=1, max_num_iterations=50)
    focal = result.problem.camera_params[:, 0]
    assert np.ptp(focal) == pytest.approx(0, abs=1e-9 * focal[0])
    assert module._shared(stub, group, (30.0, 10), is_equal=False) is None
    loose = group_of(rig, relative_sigma=np.full(rig.num_cameras, 0.06))
    for found in (
        module._shared(stub, group, (10.0, 10), is_equal=True),
        module.undetermined_intrinsics(measured(result.problem), [loose]),
    ):
        assert shlex.split(found.command)[-2:] == ["--set", rule]
