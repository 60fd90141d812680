"""A solve that is divided takes the steps of one that is not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.solving.layout import resolve_defaults
from bundle.solving.ranks.divided_solve import solve_divided
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, scene
from tests.solving.ranks.thread_crew import ThreadCrew, processes

SAME = {"rtol": 1e-9, "atol": 0}
QUICK = {"num_threads": 1, "max_num_iterations": 8}


def both(problem, num_ranks, **options):
    alone = bundle.solve(problem, **(QUICK | options))
    with processes(num_ranks):
        divided = bundle.solve(problem, **(QUICK | options))
    return alone, divided


def check(alone, divided, num_ranks):
    np.testing.assert_allclose(divided.iterations["cost"], alone.iterations["cost"], **SAME)
    for name in ("linear_solver_iterations", "step_is_successful"):
        assert list(divided.iterations[name]) == list(alone.iterations[name])
    np.testing.assert_allclose(divided.problem.points, alone.problem.points, rtol=0, atol=1e-6)
    a, b = alone.summary, divided.summary
    same = [name for name in vars(a) if name.startswith("num_") and "threads" not in name]
    same = [name for name in same if name != "num_processes"]
    same += ["termination_type", "warning_kinds", "linear_solver_type_used", "origin"]
    same += ["linear_solver_ordering_used", "schur_structure_used", "factor_ordering"]
    assert {name: getattr(b, name) for name in same} == {name: getattr(a, name) for name in same}
    assert b.fixed_cost == pytest.approx(a.fixed_cost, rel=1e-12)
    assert b.num_processes == num_ranks


@pytest.mark.parametrize("num_ranks", [1, 2, 3])
@pytest.mark.parametrize(
    ("solver", "preconditioner"),
    [
        ("auto", "auto"),
        ("dense_schur", "auto"),
        ("sparse_schur", "auto"),
        ("iterative_schur", "schur_jacobi"),
        ("iterative_schur", "jacobi"),
        ("iterative_schur", "two_level"),
    ],
)
def test_same_steps_by_each_solver(num_ranks, solver, preconditioner):
    problem = bundle.synthesize(scene="street", num_images=30, num_points=500, seed=3).problem
    options = {"linear_solver_type": solver, "preconditioner_type": preconditioner}
    if preconditioner in ("jacobi", "schur_jacobi"):
        # On a street, hundreds of conjugate gradients make more of what rounding changes in S.
        problem = make_problem(num_images=8, num_points=60, model="SIMPLE_PINHOLE")
    check(*both(problem, num_ranks, **options), num_ranks)


def test_a_divided_structure_is_that_of_the_whole():
    """Some pairs of images are coupled by points of one process alone."""
    problem = bundle.synthesize(scene="street", num_images=60, num_points=300, seed=1).problem
    alone, divided = both(problem, 4, linear_solver_type="sparse_schur")
    assert alone.summary.num_reduced_nonzeros == divided.summary.num_reduced_nonzeros
    check(alone, divided, 4)


@pytest.mark.parametrize("strategy", ["dogleg", "subspace_dogleg"])
def test_doglegs(strategy):
    options = {"trust_region_strategy_type": strategy, "gauge": "two_cameras"}
    problem = make_problem(num_images=6, num_points=40, model="SIMPLE_RADIAL", perturbation=0.05)
    check(*both(problem, 3, **options), 3)


CASES = {
    "loss": {"loss": "cauchy", "loss_scale": 0.5},
    "shared camera": {},
    "points held": {"fixed_point_ids": (1, 2, 3, 17)},
    "points and images held": {"fixed_point_ids": (4, 30), "fixed_image_ids": (2,)},
    "one image varies": {"fixed_image_ids": (1, 2, 3, 4, 5)},
    "far from the origin": {},
    "bounds": {"bounds": {("camera", 1): ([600, -9, 0, -0.05], [700, 9e9, 9e9, 0.0])}},
    "rules": {"constraints": ("cameras *: f prior 2 %", "image 3: position fixed")},
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_held_bounded_or_far(case):
    problem = make_problem(
        num_images=6, num_points=40, model="SIMPLE_RADIAL", shared=case == "shared camera"
    )
    options = dict(CASES[case])
    if case == "far from the origin":
        problem = moved(problem, [5e5, 4e6, 100])
    if "bounds" in options:
        f = problem.camera_params[0, 0]
        low, high = np.full(4, -np.inf), np.full(4, np.inf)
        low[0], high[0] = f - 0.2, f + 0.2
        options["bounds"] = {("camera", 1): (low, high)}
    check(*both(problem, 3, **options), 3)


def moved(problem, shift):
    rotations = [bundle.model.rigid_motions.rotation_matrices(problem.cam_from_world[:, :4])]
    poses = np.array(problem.cam_from_world)
    poses[:, 4:] -= np.einsum("nij,j->ni", rotations[0], np.asarray(shift, float))
    return problem.replace(cam_from_world=poses, points=problem.points + shift)


@pytest.mark.parametrize("refine", ["poses,points", "poses,points,focal,sensor_from_rig"])
@pytest.mark.parametrize("gauge", ["none", "two_cameras"])
def test_rigs(refine, gauge):
    problem = rig_problem(num_frames=5, num_alone=2)
    check(*both(problem, 3, refine=refine, gauge=gauge), 3)


def test_rigs_whose_gauge_points_hold():
    """Points that are held on other processes count in the gauge."""
    problem = rig_problem(num_frames=5)
    held = tuple(problem.point_ids[[0, 11, 29]].tolist())
    check(*both(problem, 3, gauge="two_cameras", fixed_point_ids=held), 3)


def test_factors_are_evaluated_once():
    problem = make_problem(num_images=5, num_points=40)
    factors = [
        bundle.PriorFactor(("point", int(key)), problem.points[row] + 0.1, np.eye(3))
        for row, key in enumerate(problem.point_ids[:20])
    ]
    factors += [
        bundle.PositionFactor(("image", 2), [0.1, 0.2, 0.3], np.eye(3)),
        bundle.PriorFactor(("camera", 1), problem.camera_params[0], np.eye(4) * 1e-4),
        bundle.PriorFactor(("point", 3), problem.points[2], np.eye(3)),
    ]
    for options in ({}, {"fixed_point_ids": (3, 4, 25), "fixed_image_ids": (2,)}):
        alone, divided = both(problem, 3, factors=factors, **options)
        check(alone, divided, 3)
        for name in ("factor_costs_before", "factor_costs_after"):
            np.testing.assert_allclose(getattr(divided, name), getattr(alone, name), rtol=1e-7)


def test_observations_that_go_behind():
    problem = make_problem(num_images=5, num_points=30, perturbation=0.02)
    points = np.array(problem.points)
    points[::4] *= -6  # behind some of the cameras
    check(*both(problem.replace(points=points), 3, cheirality="zero"), 3)


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_what_is_held_and_what_counts_again(solver):
    """A camera a little too far ahead: points behind it are in front where the solve converges."""
    problem = make_problem(num_images=6, num_points=60, seed=4, noise=0.3)
    poses = np.array(problem.cam_from_world)
    depths = (Rotation.from_quat(poses[0, :4]).apply(np.array(problem.points)) + poses[0, 4:])[:, 2]
    poses[0, 6] -= np.sort(depths)[2] + 1e-3
    problem = problem.replace(cam_from_world=poses)
    options = {"linear_solver_type": solver, "max_num_iterations": 80}
    alone, divided = both(problem, 3, **options)
    rises = np.diff(alone.iterations["cost"]) > 0
    assert (alone.iterations["step_is_successful"][1:] & rises).any()
    assert divided.summary.final_cost == pytest.approx(alone.summary.final_cost, rel=1e-9)
    assert divided.summary.held_cost == pytest.approx(alone.summary.held_cost, rel=1e-6)
    assert divided.iterations["cost"][-1] == pytest.approx(alone.iterations["cost"][-1], rel=1e-9)


def test_points_far_outside_the_scene():
    problem = make_problem(num_images=5, num_points=30)
    points = np.array(problem.points)
    points[[3, 20]] *= 1e7
    alone, divided = both(problem.replace(points=points), 3)
    assert "far_points" in alone.summary.warning_kinds
    check(alone, divided, 3)
    assert divided.summary.warnings == alone.summary.warnings


def test_points_seen_once_and_an_image_that_one_process_sees():
    problem = scene(num_images=6, num_points=40)
    seen = np.arange(len(problem.observation_image))
    keep = (problem.observation_point < 34) | (problem.observation_image == 5)
    kept = seen[keep]
    part = problem.replace(
        **{
            name: getattr(problem, name)[kept]
            for name in vars(problem)
            if name.startswith("observation_") and getattr(problem, name) is not None
        }
    )
    alone, divided = both(part, 3)
    assert "points_seen_once" in alone.summary.warning_kinds
    check(alone, divided, 3)
    assert divided.summary.warnings == alone.summary.warnings


def test_runs_with_as_many_processes_are_equal():
    problem = scene()
    runs = []
    for _ in range(2):
        with processes(3):
            runs.append(bundle.solve(problem, deterministic=True, **QUICK))
    assert np.array_equal(runs[0].problem.points, runs[1].problem.points)
    assert np.array_equal(runs[0].problem.cam_from_world, runs[1].problem.cam_from_world)


def test_the_record_says_who_had_what():
    problem = scene()
    with processes(3):
        summary = bundle.solve(problem, **QUICK).summary
    record = summary.processes
    assert sum(part.num_points for part in record.parts) == problem.num_points
    observations = [part.num_observations for part in record.parts]
    assert sum(observations) == len(problem.observation_xy)
    assert record.balance == max(observations) / (sum(observations) / 3) < 1.2
    assert all(part.peak_memory_in_bytes > 0 for part in record.parts)
    of = {kind.what: kind for kind in record.traffic}
    # S of 4 blocks of 9 columns, all coupled, whole diagonal blocks; its right-hand side. Sums
    # have two numbers each.
    solves = summary.num_jacobian_evaluations
    assert of["normal equations"].num_bytes == solves * 16 * (10 * 81 + 36)
    # One more solve measures the distance to the minimum.
    assert of["step"].num_bytes == (summary.num_linear_solves + 1) * 8 * 36
    assert record.num_bytes == sum(kind.num_bytes for kind in record.traffic)


def test_progress_stops_all():
    seen = []

    def stop(record):
        seen.append(record["iteration"])
        if len(seen) == 3:
            raise KeyboardInterrupt

    with processes(3):
        result = bundle.solve(scene(), progress=stop, **QUICK)
    assert result.summary.interrupted
    assert seen == [0, 1, 2]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"backend": "fused", "refine": "points"}, "refine"),
        ({"backend": "fused", "linear_solver_type": "dense_qr"}, "linear_solver_type"),
        ({"fixed_point_ids": (999,)}, "999"),
    ],
)
def test_refusals(options, word):
    with processes(2), pytest.raises(bundle.InputError, match=word):
        bundle.solve(scene(), **(QUICK | options))


def test_more_processes_than_points():
    with pytest.raises(bundle.InputError, match=r"\(5\), found 6"), processes(6):
        bundle.solve(scene(num_points=5), **QUICK)


def test_a_factor_of_two_points():
    factor = bundle.BetweenFactor(("point", 1), ("point", 2), np.zeros(3), np.eye(3))
    with processes(2), pytest.raises(bundle.InputError, match="one point"):
        bundle.solve(scene(), factors=[factor], backend="fused", **QUICK)


def test_alone_without_a_crew():
    crew = ThreadCrew(1)
    problem = scene()
    options = resolve_defaults(problem, bundle.SolveOptions(**QUICK))
    output = solve_divided(crew, problem, options.asdict(), None, None, None)
    alone = bundle.solve(problem, **QUICK)
    assert np.array_equal(output["points"], alone.problem.points)  # bit for bit


def test_checkpoint_of_processes_resumes_at_its_end(tmp_path):
    """With the record of the processes, which a resume reports again."""
    path = tmp_path / "run.npz"
    with processes(2):
        first = bundle.solve_rounds(scene(), num_rounds=0, checkpoint=path)
    again = bundle.solve_rounds(scene(), num_rounds=0, resume=path)
    assert again.summary.processes == first.summary.processes
    assert len(again.summary.processes.parts) == 2
    np.testing.assert_array_equal(again.problem.points, first.problem.points)
