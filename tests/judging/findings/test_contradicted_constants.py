"""Constants that the observations contradict, and right ones that they do not."""

from __future__ import annotations

import shlex

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.judging.findings import contradicted_constants, repaired
from bundle.judging.findings.contradicted_constants import is_notable
from bundle.judging.findings.find import find
from bundle.model.rig_arrays import compose
from bundle.solving.constraints.rule_list import rules_of
from tests.rig_scenes import STEREO, rig_problem

HELD = {"refine": ("poses", "points")}


def held(made, factor=1.0, given=(), **options):
    """Return the finding after a solve with the true lenses, focal lengths times a factor."""
    params = made.ground_truth.camera_params * [factor, 1.0, 1.0, 1.0]
    start = made.problem.replace(camera_params=params)
    result = bundle.solve(start, max_num_iterations=200, **(options or HELD))
    found = find(result.problem, options=result.options, start=start, given=given)
    return next((one for one in found if one.kind == "constant_lens"), None)


@pytest.mark.parametrize("scene", ["orbit", "street"])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_focal_length_is_named_and_a_right_one_is_not(scene, seed):
    made = bundle.synthesize(num_images=12, num_points=250, scene=scene, seed=seed)
    assert held(made) is None
    found = held(made, 1.1, ("--refine", "poses,points", "--loss", "huber"))
    share, chi2 = found.evidence["share"], found.evidence["chi2"]
    assert found.evidence["dof"] == 2 and found.sentence.endswith("for 2 terms).")
    problem = made.problem
    unknowns = 6 * problem.num_images + 3 * problem.num_points + 2 - 7
    redundancy = 2 * problem.num_observations - unknowns
    assert chi2 == pytest.approx(redundancy * share / (1 - share), rel=1e-6)
    words = ["--loss", "huber", "--refine", "poses,points,focal,extra"]
    assert shlex.split(found.command)[5:] == words
    free = bundle.solve(
        made.problem.replace(camera_params=made.ground_truth.camera_params * [1.1, 1, 1, 1])
    )
    focal = float(made.ground_truth.camera_params[0, 0])
    assert free.problem.camera_params[0, 0] == pytest.approx(focal, rel=0.02)
    # The fall that one step predicts is that of a solve.
    bent = bundle.solve(free.initial_problem, **HELD, max_num_iterations=200)
    fall = 1 - free.summary.final_cost / bent.summary.final_cost
    assert found.evidence["share"] == pytest.approx(fall, abs=0.03)


def test_only_the_constant_cameras_are_named_and_the_others_stay_refined():
    made = bundle.synthesize(
        num_images=12, num_points=250, scene="orbit", cameras="individual", seed=3
    )
    ids = tuple(made.problem.camera_ids[:2].tolist())
    flags = ("--fix-cameras", ",".join(map(str, ids)))
    found = held(made, 1.2, flags, fixed_camera_ids=ids)
    assert tuple(found.evidence["camera_ids"]) == ids
    assert "--fix-cameras" not in found.command
    assert held(made, fixed_camera_ids=ids) is None


def test_further_parameters_stay_in_the_command():
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=1)
    refine = ("poses", "points", "principal_point")
    found = held(made, 1.1, ("--refine", "poses,points,principal-point"), refine=refine)
    words = shlex.split(found.command)
    assert words[5:] == ["--refine", "poses,points,focal,principal-point,extra"]


def test_lenses_that_other_options_keep_are_refined_by_name():
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=1)
    given = ("--refine", "poses,points", "--colmap-options", "project.ini")
    found = held(made, 1.1, given)
    words = ["--colmap-options", "project.ini", "--refine", "poses,points,focal,extra"]
    assert shlex.split(found.command)[5:] == words


def contradictions(start, flags=(), rules=(), **options):
    """Return the findings about constants and rules after a solve."""
    result = bundle.solve(start, constraints=rules, max_num_iterations=200, **options)
    assert result.summary.termination_type == "CONVERGENCE"
    given = (*flags, *(word for rule in rules for word in ("--set", rule)))
    known = {"options": result.options, "start": start, "is_minimum": True, "given": given}
    found = find(result.problem, constraints=rules_of(rules) if rules else (), **known)
    return [one for one in found if one.kind == "rules" or one.kind.startswith("constant_")]


@pytest.fixture(scope="module", params=["orbit", "street"])
def exact(request):
    """A scene at its true values, with noisy pixels."""
    made = bundle.synthesize(num_images=12, num_points=250, scene=request.param, seed=4)
    return made.ground_truth.replace(observation_xy=made.problem.observation_xy)


def moved(problem, ids, kind):
    """Return a problem whose images or points with these ids are wrong by 1 % of its size."""
    rng = np.random.default_rng(0)
    name = "cam_from_world" if kind == "image" else "points"
    values = getattr(problem, name).copy()
    rows = np.isin(getattr(problem, f"{kind}_ids"), ids)
    size = np.ptp(problem.projection_centers, axis=0).max()
    values[rows, -3:] += 0.01 * size * rng.standard_normal((int(rows.sum()), 3))
    return problem.replace(**{name: values})


@pytest.mark.parametrize("kind", ["image", "point"])
def test_constant_poses_and_points_are_named_if_they_are_wrong(exact, kind):
    ids = getattr(exact, f"{kind}_ids")[: {"image": 9, "point": 24}[kind] : 4].tolist()
    options, flags = {f"fixed_{kind}_ids": ids}, (f"--fix-{kind}s", ",".join(map(str, ids)))
    assert contradictions(exact, flags, **options) == []
    (found,) = contradictions(moved(exact, ids, kind), (*flags, "--threads", "1"), **options)
    assert found.kind == {"image": "constant_poses", "point": "constant_points"}[kind]
    assert list(found.evidence[f"{kind}_ids"]) == ids and found.evidence["share"] > 0.1
    assert shlex.split(found.command)[5:] == ["--threads", "1"]
    # The numbers that are held, without the gauge.
    assert found.evidence["dof"] == 18 - 7


@pytest.mark.parametrize("kind", ["image", "point"])
def test_solves_of_a_large_model_find_what_steps_of_a_small_one_find(exact, kind, monkeypatch):
    ids = getattr(exact, f"{kind}_ids")[: {"image": 9, "point": 24}[kind] : 4].tolist()
    options = {f"fixed_{kind}_ids": ids}
    small = contradictions(moved(exact, ids, kind), **options)[0]
    monkeypatch.setattr(contradicted_constants, "MOST_WORK", 0)
    assert contradictions(exact, **options) == []
    (large,) = contradictions(moved(exact, ids, kind), **options)
    assert (large.kind, large.command) == (small.kind, small.command)
    assert large.evidence["dof"] == pytest.approx(small.evidence["dof"], abs=7)  # by the gauge
    assert large.evidence["share"] == pytest.approx(small.evidence["share"], abs=0.1)
    monkeypatch.setattr(repaired, "is_affordable", lambda *_: False)
    assert contradictions(moved(exact, ids, kind), **options) == []


@pytest.mark.parametrize(("refined", "kind"), [("points", "image"), ("poses", "point")])
def test_what_refine_leaves_out_is_named_if_it_is_wrong(exact, refined, kind):
    assert contradictions(exact, ("--refine", refined), refine=(refined,)) == []
    ids = getattr(exact, f"{kind}_ids").tolist()
    wrong = moved(exact, ids, kind)
    (found,) = contradictions(wrong, ("--refine", refined), refine=(refined,))
    assert list(found.evidence[f"{kind}_ids"]) == ids
    assert shlex.split(found.command)[5:] == ["--refine", "poses,points"]


def test_of_several_constants_the_one_that_explains_most_is_named(exact):
    options = {"refine": ("points",)}
    params = exact.camera_params * [1.2, 1.0, 1.0, 1.0]
    (found,) = contradictions(exact.replace(camera_params=params), **options)
    assert found.kind == "constant_lens"
    (found,) = contradictions(moved(exact, exact.image_ids, "image"), **options)
    assert found.kind == "constant_poses"


@pytest.mark.parametrize("kind", ["image", "point"])
def test_a_rule_that_fixes_a_wrong_position_is_named(exact, kind):
    ids = getattr(exact, f"{kind}_ids")[: {"image": 9, "point": 24}[kind] : 4].tolist()
    rules = [f"{kind}s {','.join(map(str, ids))}: position fixed", "cameras *: k in [-1, 1]"]
    assert contradictions(exact, rules=rules) == []
    (found,) = contradictions(moved(exact, ids, kind), rules=rules)
    assert found.kind == "rules" and found.evidence["rule"] == str(rules_of(rules)[0])
    assert shlex.split(found.command)[5:] == ["--set", rules[1]]


@pytest.mark.parametrize("rule", ["fixed", "in [{:.3f}, {:.3f}]"])
def test_a_rule_that_holds_a_wrong_focal_length_is_named(rule):
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=4)
    for factor in (1.0, 1.25):
        params = made.ground_truth.camera_params * [factor, 1.0, 1.0, 1.0]
        focal = float(params[0, 0])
        text = f"cameras *: f {rule.format(0.98 * focal, 1.02 * focal)}"
        found = contradictions(made.problem.replace(camera_params=params), rules=[text])
        assert [one.kind for one in found] == ["rules"] * (factor > 1)
    bent = bundle.solve(made.problem.replace(camera_params=params), constraints=[text])
    free = bundle.solve(made.problem)
    fall = 1 - free.summary.final_cost / bent.summary.final_cost
    assert found[0].evidence["share"] == pytest.approx(fall, abs=1e-3)
    assert "--set" not in found[0].command


@pytest.mark.parametrize(
    ("fall", "squares", "count", "redundancy", "expected"),
    [
        (11.0, 89.0, 1, 1000, True),
        (9.0, 91.0, 1, 1000, False),  # below 10 %
        (39.0, 100.0, 10, 100, False),  # T below 4 per term
        (41.0, 100.0, 10, 100, True),
        (5.0, 10.0, 1, 10, False),  # p = 0.025
        (16.0, 10.0, 1, 10, True),
        (11.0, 89.0, 0, 1000, False),
        (11.0, 89.0, 1, 0, False),
        (11.0, 0.0, 1, 1000, False),
    ],
)
def test_a_notable_fall_is_large_and_significant(fall, squares, count, redundancy, expected):
    assert is_notable(fall, squares, count, redundancy) == expected


def test_one_constant_image_holds_the_gauge_alone(exact):
    wrong = moved(exact, exact.image_ids[:1], "image")
    ids = wrong.image_ids[:1].tolist()
    assert contradictions(wrong, fixed_image_ids=ids) == []


def test_what_a_free_lens_absorbs_of_outliers_is_no_contradiction():
    falls = []
    for seed in range(6):
        made = bundle.synthesize(
            num_images=10, num_points=200, scene="orbit", seed=seed, outlier_share=0.03
        )
        assert held(made) is None
        params = made.ground_truth.camera_params
        start = made.problem.replace(camera_params=params)
        costs = [
            bundle.solve(start, max_num_iterations=300, **more).summary.final_cost
            for more in (HELD, {})
        ]
        falls.append(1 - costs[1] / costs[0])
    assert np.max(falls) > 0.05


def turned_sensor(degrees):
    """Return stereo rigs whose second sensor is turned about its y axis."""
    rigs = rig_problem(num_frames=8, num_points=150, model="SIMPLE_RADIAL", rigs=(STEREO, STEREO))
    turn = Rotation.from_rotvec([0, np.deg2rad(degrees), 0])
    sensors, poses = rigs.sensor_from_rig.copy(), rigs.cam_from_world.copy()
    sensors[0, :4] = (turn * Rotation.from_quat(sensors[0, :4])).as_quat()
    sensors[0, 4:] = turn.apply(sensors[0, 4:])
    on_rig = rigs.image_sensor == 0
    poses[on_rig] = compose(sensors[:1], rigs.rig_from_world[rigs.image_frame[on_rig]])
    return rigs.replace(sensor_from_rig=sensors, cam_from_world=poses)


def test_a_wrong_calibration_of_a_rig_is_named():
    given = ("--max-iterations", "150")
    assert contradictions(turned_sensor(0.0)) == []
    (found,) = contradictions(turned_sensor(1.0), given)
    assert found.kind == "constant_sensors" and found.evidence["dof"] == 11
    assert found.evidence["sensor_ids"] == [(1, 2), (2, 4)]
    assert shlex.split(found.command)[5:] == [*given, "--refine-sensor-from-rig"]
    options = {"refine_sensor_from_rig": True, "fixed_sensors": [(1, 2)]}
    flags = ("--refine-sensor-from-rig", "--fix-sensors", "1:2")
    (found,) = contradictions(turned_sensor(1.0), flags, **options)
    assert found.evidence["sensor_ids"] == [(1, 2)] and found.sentence.count("sensor 1:2: ") == 1
    assert shlex.split(found.command)[5:] == ["--refine-sensor-from-rig"]
