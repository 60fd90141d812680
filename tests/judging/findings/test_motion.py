"""Motion beside other faults, and whether a rolling shutter pays for its parameters."""

import shlex
from dataclasses import replace

import numpy as np
import pytest

import bundle
from bundle.interface.finding import Finding
from bundle.judging.findings import find as module
from bundle.judging.findings import images
from bundle.judging.findings.find import find
from bundle.judging.findings.focal_lengths import PRIOR
from bundle.judging.findings.images import certain_gain, gain_of_shutter
from bundle.judging.findings.larger_lens import Step
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.repaired import repaired
from tests.campaigns.advice import similar
from tests.campaigns.findings import judge, make


def solved(seed, faults=("motion",)):
    scene = make(seed, faults)
    return scene, bundle.solve(scene.start, num_threads=1, max_num_iterations=200).problem


def position_error(problem, truth):
    centers = truth.projection_centers
    return np.linalg.norm(similar(problem.projection_centers, centers) - centers)


@pytest.mark.parametrize(("seed", "gain", "pays"), [(63_127, 1.21, False), (63_024, 1.31, True)])
def test_a_shutter_is_advised_if_its_gain_is_certain(seed, gain, pays):
    _, problem = solved(seed)
    (found,) = find(problem, is_minimum=True)
    assert found.kind == "motion" and found.evidence["gain"] == pytest.approx(gain, abs=0.02)
    assert found.evidence["shutter"] == ("rows" if pays else "")
    assert found.command == ("bundle refine INPUT -o OUTPUT --rolling-shutter rows" if pays else "")
    assert ("It is uncertain" in found.sentence) != pays


def rolled(problem):
    return problem.replace(
        rolling_shutter=bundle.RollingShutter(
            direction=("rows",) * problem.num_cameras, twist=np.zeros((problem.num_images, 6))
        )
    )


def test_the_gain_is_that_of_a_solve_with_the_shutter(monkeypatch):
    scene, problem = solved(60_016)
    rolling = bundle.solve(rolled(problem), num_threads=1).problem
    assert position_error(rolling, scene.truth) > 1.5 * position_error(problem, scene.truth)
    moved = similar(rolling.projection_centers, problem.projection_centers)
    measured = Measured(whole=problem, command=NextCommand())
    steps = [Step(one, measured.options) for one in (problem, rolled(problem))]
    covariances = [one.position_covariance() * steps[1].variance for one in steps]
    gain = certain_gain((moved - problem.projection_centers).ravel(), *covariances)
    assert gain_of_shutter(measured, "rows") == pytest.approx(gain, abs=0.05) and gain < 0
    for step, one in zip(steps, covariances, strict=True):
        mean = np.trace(one) / problem.num_images * step.variance / steps[1].variance
        assert np.sqrt(mean) == pytest.approx(step.position_sigma(), rel=1e-6)
    # The start need not be the minimum, as where positions pull at it.
    poses = problem.cam_from_world.copy()
    size = np.sqrt((moved - problem.projection_centers).var())
    poses[:, 4:] += 0.5 * size * np.random.default_rng(0).normal(size=(len(poses), 3))
    pulled = Measured(whole=problem.replace(cam_from_world=poses), command=NextCommand())
    assert gain_of_shutter(pulled, "rows") == pytest.approx(gain, abs=0.2)
    # Neither a model that is too large for the step nor one that rolls already.
    monkeypatch.setattr(images, "MOST_WORK", 0)
    assert gain_of_shutter(measured, "rows") == np.inf
    assert np.isnan(gain_of_shutter(Measured(whole=rolling, command=NextCommand()), "rows"))


@pytest.mark.parametrize("spectrum", [(1.0,), (1.0, 0.3, 0.1, 0.03), (1.0,) * 10])
@pytest.mark.parametrize("present", [0.0, 0.5])
def test_advice_harms_less_than_one_model_in_twenty_of_any_motion(spectrum, present):
    rng, count = np.random.default_rng(1), 4000
    added = np.diag(spectrum)
    before = present * np.mean(spectrum) * np.eye(len(spectrum))
    noise = rng.normal(size=(count, len(spectrum))) * np.sqrt(spectrum)
    errors = rng.normal(size=(count, len(spectrum))) @ np.sqrt(before)
    num_advised = []
    for size in (0.0, 1.0, 1.25, 1.5, 2.0, 3.0, 6.0):
        motion = np.zeros(len(spectrum))
        motion[0] = size * np.sqrt(np.trace(added))
        gain = np.array([certain_gain(one, before, before + added) for one in noise - motion])
        is_advised = gain > images.GAIN
        change = ((noise + errors) ** 2 - (motion + errors) ** 2).sum(axis=1)
        assert (is_advised & (change > 0)).mean() < 0.05
        num_advised.append(is_advised.mean())
    assert num_advised[0] < 0.01 and num_advised[-1] > 0.95


def test_lenses_that_differ_are_not_shared():
    joint, found, places = judge(make(50_003))
    assert [one.kind for one in (joint, found, places)] == ["weak_joint", "motion", "positions"]
    assert "--share-cameras" not in found.command + places.command
    assert "f prior" not in found.command  # focal lengths of the start are wrong by up to 19 %


def test_a_shutter_has_the_prior_of_a_lens_that_only_a_global_one_determines():
    scene, problem = solved(45_003, None)
    known = {"start": scene.start, "is_minimum": True}
    kinds = {one.kind: one for one in find(problem, **known)}
    assert "undetermined_intrinsics" not in kinds
    found = kinds["motion"]
    rule = "camera 1: f prior 2 %"
    assert shlex.split(found.command)[5:] == ["--rolling-shutter", "rows", "--set", rule]
    free, prior = (
        bundle.solve(rolled(scene.start), constraints=rules, num_threads=1, max_num_iterations=400)
        for rules in ((), (rule,))
    )
    # Twists imitate a focal length of 1630 px where 1024 px are right.
    assert abs(free.problem.camera_params[0, 0] - 1024) > 300 and len(free.iterations["cost"]) > 101
    assert abs(prior.problem.camera_params[0, 0] - 1024) < 60 and len(prior.iterations["cost"]) < 40
    errors = [position_error(one.problem, scene.truth) for one in (free, prior)]
    assert errors[1] < 0.5 * errors[0]
    for result, rules, is_open in ((free, (), True), (prior, (rule,), False)):
        kinds = [one.kind for one in find(result.problem, constraints=rules, is_minimum=True)]
        assert ("undetermined_intrinsics" in kinds) == is_open
    # No prior at bent focal lengths, if the bent model is the input.
    (bent,) = [one for one in find(problem, is_minimum=True) if one.kind == "motion"]
    assert bent.command.endswith("--rolling-shutter rows")


def test_later_commands_have_the_shutter_and_the_prior_beside_it(monkeypatch):
    scene, problem = solved(62_008, ("motion", "lens_model"))
    asked, rule = [], "camera 1: f prior 2 %"

    def loose(measured, _, *limit):
        asked.append((measured.whole, *limit))
        command = measured.command.refine("--set", rule)
        return Finding(kind="undetermined_intrinsics", sentence="", command=command)

    monkeypatch.setattr(module, "undetermined_intrinsics", loose)
    found = {one.kind: one for one in find(problem, start=scene.start, is_minimum=True)}
    (rolling, limit), (still,) = asked
    assert rolling.rolling_shutter is not None and limit == PRIOR
    assert still is problem  # the model without what a shutter leaves open
    shutter, prior = ["--rolling-shutter", "rows"], ["--set", rule]
    lens = ["--camera-model", "OPENCV"]
    assert {kind: shlex.split(one.command)[5:] for kind, one in found.items()} == {
        "motion": [*shutter, *prior],
        "lens_model": [*shutter, *prior, *lens],
        "undetermined_intrinsics": [*shutter, *lens, *prior],
    }
    asked.clear()
    _, problem = solved(20_000, ("lens_model",))  # nothing moves: the larger lens may be open
    (larger, _) = find(problem, is_minimum=True)
    assert [one[0].camera_models for one in asked] == [(larger.evidence["larger_model"],)]


def test_a_lens_that_only_the_shutter_leaves_open_is_no_finding():
    scene, problem = solved(68_058, None)
    (found,) = find(problem, start=scene.start, is_minimum=True)
    assert found.kind == "motion" and found.command.endswith("'camera 1: f prior 2 %'")


def test_wrong_sigmas_beside_motion_are_no_drift():
    # Both bend the model; each command mends both.
    found, places = judge(make(51_038, ("motion", "positions")))
    assert (found.kind, places.kind) == ("motion", "positions")
    for one in (found, places):
        words = shlex.split(one.command)
        assert {"--rolling-shutter", "--gps-sigma-scale"} <= set(words)
    assert max(places.evidence["factors"]) == pytest.approx(6, abs=1.5)


def test_motion_without_a_shutter_leaves_the_sigmas():
    # Sigmas of 4.4 mm, where 35 mm are right, hold a model that motion bends by more.
    moves, places, _ = judge(make(54_005))
    assert (moves.kind, moves.command) == ("motion", "")
    assert (places.kind, places.command) == ("positions", "")
    assert "8.283 times the sigmas. Motion during the exposure bends the model" in places.sentence


def test_a_lens_that_lenses_per_image_hide_is_no_motion(monkeypatch):
    scene = make(54_001)
    lens, joint = judge(scene)
    assert (lens.kind, lens.evidence["larger_model"], joint.kind) == (
        *("lens_model", "OPENCV", "weak_joint"),
    )
    assert lens.evidence["dof"] == 4 * scene.truth.num_cameras
    monkeypatch.setattr(images, "explains_more", lambda *_: False)
    assert "motion" in {one.kind for one in judge(scene)}


def test_motion_does_not_hide_a_lens():
    _, problem = solved(62_008, ("motion", "lens_model"))
    lens, found = find(problem, is_minimum=True)
    assert (lens.kind, found.kind) == ("lens_model", "motion")
    assert lens.command.endswith("--rolling-shutter rows --camera-model OPENCV")
    assert found.command.endswith("OUTPUT --rolling-shutter rows")


def test_a_repair_changes_the_start_as_the_model():
    scene, problem = solved(63_024)
    measured = Measured(whole=problem, start=scene.start, command=NextCommand())
    start = repaired(measured, "OPENCV", "rows").start
    assert start.camera_models == ("OPENCV",) and start.rolling_shutter.direction == ("rows",)
    np.testing.assert_array_equal(start.cam_from_world, scene.start.cam_from_world)
    assert repaired(measured).start is scene.start
    own = repaired(replace(measured, start=None), "OPENCV", "rows").start  # the model itself
    assert own.camera_models == ("OPENCV",) and own.rolling_shutter.direction == ("rows",)
    np.testing.assert_array_equal(own.cam_from_world, problem.cam_from_world)
