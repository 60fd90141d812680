"""The patterns of S and of the whole problem, and the core's refusal of arrays that are none."""

import numpy as np
import pytest

import bundle
from bundle import InputError, SolveOptions, _core
from bundle.planning.inspection.graph_inspection import inspect_graph
from tests.scenes import make_problem

# Enough images not to see each other's points, and a lens that a whole rig shares.
OWN = make_problem(num_images=12, num_points=30, track=3)
SHARED = make_problem(num_images=12, num_points=30, track=3, shared=True)
HALVES = OWN.replace(image_camera=np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 3, 4, 5]))
TWICE = OWN.replace(
    observation_image=np.append(OWN.observation_image, OWN.observation_image[:5]),
    observation_point=np.append(OWN.observation_point, OWN.observation_point[:5]),
    observation_xy=np.vstack([OWN.observation_xy, OWN.observation_xy[:5] + 1]),
    observation_keypoint=np.append(OWN.observation_keypoint, OWN.observation_keypoint[:5]),
)

CASES = {
    "own": (OWN, {}),
    "shared": (SHARED, {}),
    "halves": (HALVES, {}),
    "observed-twice": (TWICE, {}),
    "poses-points": (SHARED, {"refine": ("poses", "points")}),
    "poses": (SHARED, {"refine": ("poses", "focal")}),
    "points": (OWN, {"refine": ("points",)}),
    "lens": (SHARED, {"refine": ("focal",)}),
    "focal-points": (HALVES, {"refine": ("focal", "points")}),
    "fixed": (OWN, {"fixed_image_ids": (1, 5), "fixed_camera_ids": (5,), "fixed_point_ids": (1,)}),
    "gauge": (SHARED, {"gauge": "two_cameras"}),
}


def patterns(name):
    problem, changes = CASES[name]
    options = SolveOptions(**{"gauge": "none", "cheirality": "zero", **changes})
    given = options.asdict()
    return (
        problem,
        options,
        _core.reduced_pattern(problem, given),
        _core.full_pattern(problem, given),
    )


def edges_of(pattern):
    _, begin, rows = pattern
    columns = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    return {(int(a), int(b)) for a, b in zip(columns, rows, strict=True) if a != b}


@pytest.mark.parametrize("name", CASES)
def test_patterns_have_the_unknowns_of_a_solve(name, backend):
    problem, options, reduced, full = patterns(name)
    if backend == "fused" and name in ("poses", "points", "lens"):
        pytest.skip("the fused backend refines points and cameras, not one without the other")
    summary = bundle.solve(
        problem, options, backend=backend, linear_solver_type="dense_schur", max_num_iterations=1
    ).summary
    assert full[0].sum() == summary.num_parameters_reduced
    num_points = len(full[0]) - len(reduced[0])
    assert np.array_equal(full[0], np.append(np.full(num_points, 3), reduced[0]))


@pytest.mark.parametrize("name", CASES)
def test_the_reduced_pattern_is_what_eliminating_the_points_leaves(name):
    _, _, reduced, full = patterns(name)
    num_points = len(full[0]) - len(reduced[0])
    graph = inspect_graph(np.array(sorted(edges_of(full))), len(full[0]), block_size=full[0])
    left = set(graph.edges) | {edge for step in graph.steps[:num_points] for edge in step.fill}
    expected = {(a - num_points, b - num_points) for a, b in left if a >= num_points}
    assert edges_of(reduced) == expected
    # Points first, then S by itself: the factor of the whole is both.
    natural = _core.count_factor(*reduced, np.arange(len(reduced[0]), dtype=np.int32))
    points = sum(graph.scalar_column_counts[: 3 * num_points]) + 3 * num_points
    assert graph.nnz_factor == points + natural["entries"]


def test_whom_a_point_meets():
    problem, _, reduced, full = patterns("halves")
    num_points = len(full[0]) - len(reduced[0])
    assert num_points == problem.num_points
    # Blocks: twelve images, of which the last four bring their cameras' numbers along, two cameras.
    assert reduced[0].tolist() == [6] * 8 + [8] * 4 + [2] * 2
    expected = set()
    pairs = zip(problem.observation_image, problem.observation_point, strict=True)
    for image, point in pairs:
        camera = problem.image_camera[image]
        expected.add((int(point), int(num_points + image)))
        if camera < 2:
            expected.add((int(point), int(num_points + 12 + camera)))
            expected.add((int(num_points + image), int(num_points + 12 + camera)))
    assert edges_of(full) == expected


def test_more_images_than_one_table_of_pairs_has_room_for():
    # 16 MiB of bits hold all pairs of 11585 blocks.
    num_images, num_points = 13_000, 20_000
    rng = np.random.default_rng(0)
    image = rng.integers(num_images, size=(num_points, 3))
    problem = SHARED.replace(
        cam_from_world=np.tile(SHARED.cam_from_world[:1], (num_images, 1)),
        image_ids=np.arange(num_images),
        image_names=[""] * num_images,
        image_camera=np.zeros(num_images, int),
        points=rng.standard_normal((num_points, 3)),
        point_ids=np.arange(num_points),
        observation_image=image.ravel(),
        observation_point=np.repeat(np.arange(num_points), 3),
        observation_xy=np.zeros((image.size, 2)),
        observation_keypoint=np.full(image.size, -1),
    )
    options = SolveOptions(gauge="none", cheirality="zero", refine=("poses", "points"))
    observed, image = np.unique(image, return_inverse=True)
    image = np.sort(image.reshape(num_points, 3), axis=1)
    expected = {(int(a), int(b)) for a, b in np.vstack([image[:, [0, 1]], image[:, 1:]])}
    expected |= {(int(a), int(b)) for a, b in image[:, [0, 2]]}
    reduced = _core.reduced_pattern(problem, options.asdict())
    assert len(reduced[0]) == len(observed)
    assert edges_of(reduced) == {(a, b) for a, b in expected if a != b}
    rows = np.split(reduced[2], reduced[1][1:-1])
    assert all(rows[j][0] == j and (np.diff(rows[j]) > 0).all() for j in range(len(rows)))


@pytest.mark.parametrize("name", CASES)
def test_patterns_are_of_the_form_that_the_counts_ask_for(name):
    for pattern in patterns(name)[2:]:
        order = _core.order_blocks(*pattern, "amd")
        counts = _core.count_factor(*pattern, order)
        assert len(counts["rows_below"]) == len(counts["blocks_below"]) == len(pattern[0])
        again = _core.count_factor(*pattern, order[counts["postorder"]])
        assert again["entries"] == counts["entries"]
        parents = counts["parent"][counts["parent"] >= 0]
        assert (parents > np.flatnonzero(counts["parent"] >= 0)).all()


def pattern(sizes, column_begin, rows):
    return np.array(sizes, np.int32), np.array(column_begin, np.int64), np.array(rows, np.int32)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (pattern([1, 1], [0, 2], [0, 1]), "column_begin: expected 3 entries, found 2"),
        (pattern([1, 1], [0, 2, 3], [0, 1]), "rows: expected 3 entries, found 2"),
        (pattern([1, 1], [0, 2, -3], [0, 1]), "rows: expected -3 entries, found 2"),
        (pattern([1, 1], [0, 2, 3], [0, 2, 1]), "block column 0: expected rows below 2, found 2"),
        (pattern([1, 1], [0, 2, 3], [0, -1, 1]), "block column 0: expected ascending rows, found"),
        (pattern([1, -1], [0, 1, 2], [0, 1]), "block 1: expected a size of at least 1, found -1"),
        (pattern([[1]], [0, 1], [0]), "sizes: expected one entry per block"),
        (pattern([1], [[0], [1]], [0]), "column_begin: expected 2 entries, found 2 x 1"),
    ],
)
def test_arrays_that_are_no_pattern_are_refused(arrays, message):
    for call in (
        lambda: _core.order_blocks(*arrays, "amd"),
        lambda: _core.count_factor(*arrays, np.zeros(2, np.int32)),
    ):
        with pytest.raises(InputError) as refused:
            call()
        assert str(refused.value).startswith(message)


def test_orders_that_are_none_are_refused():
    chain = pattern([1, 1], [0, 2, 3], [0, 1, 1])
    with pytest.raises(InputError, match=r"ordering: expected one of natural, .*, found best"):
        _core.order_blocks(*chain, "best")
    with pytest.raises(InputError, match="order: expected 2 entries, found 1"):
        _core.count_factor(*chain, np.zeros(1, np.int32))
    with pytest.raises(InputError, match="order: expected each of the blocks 0 to 1 once, found 0"):
        _core.count_factor(*chain, np.zeros(2, np.int32))
    with pytest.raises(InputError, match="once, found 7"):
        _core.count_factor(*chain, np.array([7, 0], np.int32))
    with pytest.raises(TypeError):  # never rounded, never cut off
        _core.count_factor(*chain, np.array([0, 1]))
