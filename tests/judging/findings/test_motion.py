"""Motion beside other faults, and whether a rolling shutter pays for its parameters."""

import shlex

import numpy as np
import pytest

import bundle
from bundle.judging.findings import images
from bundle.judging.findings.find import find
from bundle.judging.findings.images import shutter_movement
from bundle.judging.findings.larger_lens import Step
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from tests.campaigns.advice import similar
from tests.campaigns.findings import judge, make


def solved(seed, faults=("motion",)):
    scene = make(seed, faults)
    return scene, bundle.solve(scene.start, num_threads=1, max_num_iterations=200).problem


def position_error(problem, truth):
    centers = truth.projection_centers
    return np.linalg.norm(similar(problem.projection_centers, centers) - centers)


@pytest.mark.parametrize(("seed", "gain", "pays"), [(60_042, 1.93, False), (60_012, 2.08, True)])
def test_a_shutter_is_advised_from_twice_the_movement_of_noise(seed, gain, pays):
    _, problem = solved(seed)
    (found,) = find(problem, is_minimum=True)
    assert found.kind == "motion" and found.evidence["gain"] == pytest.approx(gain, abs=0.02)
    assert found.evidence["shutter"] == ("rows" if pays else "")
    assert found.command == ("bundle refine INPUT -o OUTPUT --rolling-shutter rows" if pays else "")
    assert ("would increase standard deviations" in found.sentence) != pays


def test_the_gain_is_that_of_a_solve_with_the_shutter(monkeypatch):
    scene, problem = solved(60_016)
    shutter = bundle.RollingShutter(
        direction=("rows",), twist=np.zeros((problem.num_images, 6)), readout=np.full(1, np.nan)
    )
    rolling = bundle.solve(problem.replace(rolling_shutter=shutter), num_threads=1).problem
    assert position_error(rolling, scene.truth) > 1.5 * position_error(problem, scene.truth)
    moved = problem.projection_centers - similar(
        rolling.projection_centers, problem.projection_centers
    )
    measured = Measured(whole=problem, command=NextCommand())
    both = problem, problem.replace(rolling_shutter=shutter)
    steps = [Step(one, measured.options) for one in both]
    spread = (steps[1].position_variance() - steps[0].position_variance()) * steps[1].variance
    rms = np.sqrt((moved**2).sum(axis=1).mean())
    assert shutter_movement(measured, "rows") == pytest.approx(rms / np.sqrt(spread), rel=0.05)
    # The start need not be the minimum, as where positions pull at it.
    poses = problem.cam_from_world.copy()
    poses[:, 4:] += 0.5 * rms * np.random.default_rng(0).normal(size=(len(poses), 3))
    pulled = Measured(whole=problem.replace(cam_from_world=poses), command=NextCommand())
    assert shutter_movement(pulled, "rows") == pytest.approx(rms / np.sqrt(spread), rel=0.15)
    # Neither a model that is too large for the step nor one that rolls already.
    monkeypatch.setattr(images, "is_cheap", lambda _: False)
    assert shutter_movement(measured, "rows") == np.inf
    assert shutter_movement(Measured(whole=rolling, command=NextCommand()), "rows") == 0.0


def test_lenses_that_differ_are_not_shared():
    scene = make(50_003)
    (joint, undetermined, found, places) = judge(scene)
    kinds = [one.kind for one in (joint, undetermined, found, places)]
    assert kinds == ["weak_joint", "undetermined_intrinsics", "motion", "positions"]
    assert "--share-cameras" not in undetermined.command + found.command + places.command
    assert "camera 27: f prior 2 %" in shlex.split(undetermined.command)


def test_wrong_sigmas_beside_motion_are_no_drift():
    # Both bend the model; each command mends both.
    found, places = judge(make(51_010))
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
