"""A gauge holds what held points, images and baselines leave of the world, and no more."""

import numpy as np
import pytest

import bundle
from tests.campaigns.gauges import EXACT
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem
from tests.solving.ranks.thread_crew import processes

RULES = {
    "one": ["point 1: position fixed"],
    "two": ["points 1-2: position fixed"],
    "part": ["image 2: position fixed", "point 3: position fixed"],
    "turn": ["image 2: rotation fixed"],
}
HELD = {
    "nothing": {},
    "a point": {"fixed_point_ids": (1,)},
    "two points": {"fixed_point_ids": (1, 2)},
    "three points": {"fixed_point_ids": (1, 2, 3)},
    "an image": {"fixed_image_ids": (2,)},
    "an image and a point": {"fixed_image_ids": (2,), "fixed_point_ids": (1,)},
    **{f"rules: {name}": {"constraints": rules} for name, rules in RULES.items()},
}


def images(**changes):
    return make_problem(num_points=25, seed=3, model="PINHOLE", **changes).replace(format="colmap")


def rigs(**changes):
    return rig_problem(num_frames=3, num_points=25, seed=4, num_alone=1, **changes).replace(
        format="colmap"
    )


def costs(problem, gauges=("none", "two_cameras"), **options):
    results = [bundle.solve(problem, gauge=gauge, **EXACT, **options) for gauge in gauges]
    kinds = {result.summary.warning_kinds for result in results}
    assert len(kinds) == 1
    assert not kinds & {("gauge_not_held",), ("gauge_beside_factors",)}
    return [result.summary.final_cost for result in results]


@pytest.mark.parametrize("held", HELD)
def test_the_minimum_is_that_without_a_gauge(backend, held):
    free, fixed = costs(images(), backend=backend, num_threads=1, **HELD[held])
    assert fixed == pytest.approx(free, rel=1e-9)


@pytest.mark.parametrize("sensors", [False, True])
@pytest.mark.parametrize("points", [(), (1,), (1, 2), (1, 2, 3)])
@pytest.mark.parametrize("arms", [STEREO, FIVE], ids=["stereo", "five"])
def test_the_minimum_of_rigs_is_that_without_a_gauge(backend, arms, points, sensors):
    options = {"fixed_point_ids": points, "refine_sensor_from_rig": sensors, "backend": backend}
    free, fixed = costs(rigs(rigs=(arms,)), num_threads=1, **options)
    assert fixed == pytest.approx(free, rel=1e-9)


def test_as_many_numbers_are_held_as_are_counted():
    """Numbers that stay bit for bit: w of a pose as its rotation, t by coordinate."""
    problem = images()
    for options, turns, shifts in (
        (HELD["a point"], 3, 1),
        (HELD["two points"], 0, 0),  # a part of a rotation, which moves all the same
        (HELD["an image"], 3, 4),
    ):
        end = bundle.solve(problem, gauge="two_cameras", max_num_iterations=3, **options).problem
        same = end.cam_from_world == problem.cam_from_world
        assert 3 * same[:, :4].all(axis=1).sum() == turns
        assert same[:, 4:].sum() == shifts


@pytest.mark.parametrize("options", [{"fixed_point_ids": (30,)}, {"fixed_point_ids": (1, 30)}])
def test_points_that_other_processes_hold_count(options):
    problem = make_problem(num_images=6, num_points=40, seed=5, track=4)
    settings = {"gauge": "two_cameras", "num_threads": 1, "backend": "fused"} | options
    alone = bundle.solve(problem, **EXACT, **settings)
    with processes(3):
        divided = bundle.solve(problem, **EXACT, **settings)
    free = bundle.solve(problem, **EXACT, **(settings | {"gauge": "none"}))
    assert divided.summary.final_cost == pytest.approx(alone.summary.final_cost, rel=1e-11)
    assert alone.summary.final_cost == pytest.approx(free.summary.final_cost, rel=1e-9)


def test_images_in_one_place_leave_the_scale(backend):
    """Their poses are held: nothing can hold it, and nothing is said of what nobody refines."""
    problem = make_problem(num_images=2, num_points=20, seed=9)
    poses = problem.cam_from_world.copy()
    poses[1] = poses[0]
    result = bundle.solve(
        problem.replace(cam_from_world=poses),
        gauge="two_cameras",
        fixed_image_ids=(1, 2),
        backend=backend,
        max_num_iterations=2,
    )
    assert "gauge_not_held" not in result.summary.warning_kinds


def test_an_image_on_a_refined_sensor_cannot_be_held(backend):
    problem = rigs()
    sensor = int(np.flatnonzero(problem.image_sensor >= 0)[1])
    reference = int(np.flatnonzero(problem.image_sensor < 0)[1])
    image, other = (int(problem.image_ids[k]) for k in (sensor, reference))
    for refine in ({"refine_sensor_from_rig": True}, {"refine": "poses,points,sensor_from_rig"}):
        with pytest.raises(bundle.InputError, match=rf"^fixed_image_ids: .* image {image} "):
            bundle.solve(problem, fixed_image_ids=(image,), backend=backend, **refine)
    ids = (int(problem.sensor_rig_ids[0]), int(problem.sensor_camera_ids[0]))
    for held, options, row in (
        (image, {"refine_sensor_from_rig": True, "fixed_sensors": (ids,)}, sensor),
        (other, {"refine_sensor_from_rig": True}, reference),
        (image, {}, sensor),
    ):
        end = bundle.solve(problem, fixed_image_ids=(held,), backend=backend, **options).problem
        assert (end.cam_from_world[row] == problem.cam_from_world[row]).all()


def test_factors_between_points_end_at_the_same_bits():
    """Ceres orders by address what it does not eliminate first."""
    problem = make_problem(num_images=5, num_points=60, seed=2, track=4)
    between = [
        bundle.BetweenFactor(
            ("point", 1), ("point", k), problem.points[k - 1] - problem.points[0], 1e2
        )
        for k in range(2, 30)
    ]
    rng = np.random.default_rng(0)
    blocks, ends = [], set()
    for _ in range(12):
        result = bundle.solve(problem, factors=between, deterministic=True, max_num_iterations=10)
        ends.add(result.problem.points.tobytes() + result.problem.cam_from_world.tobytes())
        blocks.append([bytearray(int(size)) for size in rng.integers(16, 5000, 200)])
        del blocks[::2]
    assert len(ends) == 1
