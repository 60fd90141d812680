"""The unit of length and the origin: a solve does not depend on them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests import rig_scenes, scenes


def in_units(problem, factor, shift=0.0):
    """Return a problem with all lengths times a factor, then moved."""

    def moved(poses, shift):
        poses = np.array(poses)
        if len(poses):
            turns = Rotation.from_quat(poses[:, :4])
            poses[:, 4:] = poses[:, 4:] * factor - turns.apply(np.full(3, shift))
        return poses

    return problem.replace(
        cam_from_world=moved(problem.cam_from_world, shift),
        rig_from_world=moved(problem.rig_from_world, shift),
        sensor_from_rig=moved(problem.sensor_from_rig, 0.0),
        points=problem.points * factor + shift,
    )


SCALES = [2.0**-40, 1e-12, 1e-7, 1e-4, 1e6, 1e9, 1e12, 2.0**40, 1e30]


@pytest.mark.parametrize("gauge", ["none", "two_cameras"])
@pytest.mark.parametrize("factor", SCALES)
def test_the_unit_of_length_changes_no_cost(solve, factor, gauge):
    problem = scenes.make_problem(num_points=30)
    one = bundle.solve(problem, gauge=gauge).summary
    result = solve(in_units(problem, factor), gauge=gauge)
    assert result.summary.final_cost == pytest.approx(one.final_cost, rel=1e-6)
    assert result.summary.warning_kinds == ()
    assert result.summary.termination_type == "CONVERGENCE"
    errors, _ = bundle.reprojection_errors(result.problem)
    assert 0.5 * np.sum(errors**2) == pytest.approx(result.summary.final_cost, rel=1e-6)


@pytest.mark.parametrize("factor", [1e-10, 1e10])
def test_of_rigs_and_far_from_the_origin(solve, factor):
    rigs = rig_scenes.rig_problem(num_frames=3, num_points=25)
    one = solve(rigs).summary.final_cost
    assert solve(in_units(rigs, factor)).summary.final_cost == pytest.approx(one, rel=1e-6)
    problem = scenes.make_problem(num_points=30)
    one = solve(problem).summary.final_cost
    moved = solve(in_units(problem, factor, shift=1e5 * factor))
    assert moved.summary.final_cost == pytest.approx(one, rel=1e-6)
    (sentence,) = moved.summary.warnings
    assert moved.summary.warning_kinds == ("far_origin",)
    assert f"{1e5 * factor * 3**0.5:.3g}"[:3] in sentence  # in the unit of the user


def test_a_power_of_two_is_no_change_at_all(solve):
    """Beyond the bounds every such unit is solved in the same numbers.

    One thread: Ceres adds in the order in which its threads finish.
    """
    problem = scenes.make_problem(num_points=30)
    first, second = (solve(in_units(problem, 2.0**k), num_threads=1) for k in (30, 45))
    np.testing.assert_array_equal(first.problem.points * 2.0**15, second.problem.points)
    np.testing.assert_array_equal(first.iterations["cost"], second.iterations["cost"])


def test_what_is_held_keeps_its_bits(solve):
    problem = in_units(scenes.make_problem(num_points=30), 3e11)
    result = solve(problem, fixed_image_ids=(2,), fixed_point_ids=(1, 4))
    assert result.problem.cam_from_world[1].tolist() == problem.cam_from_world[1].tolist()
    held = np.isin(problem.point_ids, (1, 4))
    assert result.problem.points[held].tolist() == problem.points[held].tolist()


def test_priors_keep_their_unit_and_say_so(solve):
    problem = in_units(scenes.make_problem(num_points=30), 1e12)
    turns = Rotation.from_quat(problem.cam_from_world[:, :4])
    centers = -turns.inv().apply(problem.cam_from_world[:, 4:].copy())
    priors = [
        bundle.PositionPrior(image, center, 1e10)
        for image, center in zip(problem.image_ids.tolist(), centers, strict=True)
    ]
    kinds = solve(problem, priors=priors, align=False).summary.warning_kinds
    assert "world_scale" in kinds
    assert "world_scale" not in solve(problem).summary.warning_kinds
