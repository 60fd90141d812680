"""Factor graphs under inspect: equal to the same problem, exact for any other, refused in words."""

import numpy as np
import pytest

import bundle
from bundle.graphs.factors.same_problem import pose_graph_of, problem_of
from bundle.planning.inspection.elimination_costs import inspect_factor_graph
from tests.graphs.factors import both_ways
from tests.graphs.pose_graphs import graphs
from tests.planning.inspection.test_inspect_pose_graph import chain

SMALL = bundle.SceneOptions(num_images=6, num_points=40, seed=3)


def small_problem():
    return bundle.synthesize(SMALL).problem


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", [int, lambda key: f"x{key}", lambda key: ("pose", key)])
def test_a_pose_graph_has_the_table_of_its_file(dimension, name, tmp_path):
    graph = chain(30, 12, dimension)
    bundle.save(graph, tmp_path / "x.g2o")
    assert bundle.inspect(both_ways.of_pose_graph(graph, name)) == bundle.inspect(
        tmp_path / "x.g2o"
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_its_structure_alone_gives_the_same_counts(dimension):
    graph = chain(30, 12, dimension)
    by_structure = inspect_factor_graph(both_ways.of_pose_graph(graph))
    as_graph = bundle.inspect(graph)
    for ours, theirs in zip(by_structure.costs, as_graph.costs, strict=True):
        for field in ("ordering", "nnz_factor", "fill", "flops", "tree_height", "memory_in_bytes"):
            assert getattr(ours, field) == getattr(theirs, field)
    assert by_structure.nnz == as_graph.nnz_free


def test_reprojections_have_the_table_of_their_problem():
    problem = small_problem()
    first = int(problem.image_ids[0])
    graph = both_ways.of_problem(problem, fixed_images=(first,), held=(1, 2))
    options = {"fixed_image_ids": (first,), "gauge": "none", "cheirality": "algebraic"}
    ours, theirs = bundle.inspect(graph), bundle.inspect(problem, **options)
    assert len(ours.methods) == len(theirs.methods) > 5
    for one, other in zip(ours.methods, theirs.methods, strict=True):
        np.testing.assert_equal(
            (one.name, one.nnz_factor, one.fill, one.flops, one.nnz_information, one.nnz_reduced),
            (other.name, other.nnz_factor, other.fill, other.flops, other.nnz_information,
             other.nnz_reduced),
        )  # fmt: skip
        np.testing.assert_allclose(
            one.time_per_step_in_seconds, other.time_per_step_in_seconds, rtol=1e-9
        )
    whole = next(m for m in ours.methods if m.name.startswith("SPARSE_NORMAL_CHOLESKY"))
    assert inspect_factor_graph(graph).nnz == whole.nnz_information


def test_any_other_graph_is_counted_like_a_dense_factorisation():
    rng = np.random.default_rng(5)
    graph = bundle.FactorGraph()
    sizes = [1, 3, 2, 4, 1, 2]
    for k, size in enumerate(sizes):
        graph.add_variable(f"v{k}", rng.normal(size=size), fixed=[0] if size == 4 else False)
    for keys in [(0, 1, 2), (2, 3), (4, 5), (0, 4)]:
        total = sum(sizes[k] for k in keys)
        names = tuple(f"v{k}" for k in keys)
        points = {name: np.zeros(sizes[k]) for name, k in zip(names, keys, strict=True)}
        graph.add_factor(bundle.LinearPrior(np.eye(total), np.zeros(total), points, names))
    found = bundle.inspect(graph)
    begin = np.cumsum([0, 1, 3, 2, 3, 1, 2])
    matrix = np.zeros((12, 12))
    for keys in [(0, 1, 2), (2, 3), (4, 5), (0, 4)]:
        rows = np.concatenate([np.arange(begin[k], begin[k + 1]) for k in keys])
        matrix[np.ix_(rows, rows)] += 1
    assert found.nnz == (matrix != 0).sum() and found.num_edges == 6 and found.largest_clique == 3
    factor = np.linalg.cholesky(matrix + 50 * np.eye(12))
    natural, dense = found.costs[0], found.costs[-1]
    assert natural.nnz_factor == (np.abs(factor) > 1e-14).sum()
    assert dense.nnz_factor == 12 * 13 // 2 and dense.memory_in_bytes == 8 * 144
    assert found.auto_ordering == "dense" and "Dense" in found.recommendation
    assert "6 variables, 4 factors" in str(found)


def test_a_landmark_makes_a_pose_graph_another_problem():
    graph = both_ways.of_pose_graph(graphs.loop(3, num_poses=9))
    assert pose_graph_of(graph) is not None and problem_of(graph) is None
    graph.add_variable("landmark", [0.0, 0, 0])
    graph.add_factor(bundle.PriorFactor("landmark", [0.0, 0, 0], 1))
    assert pose_graph_of(graph) is None
    assert bundle.inspect(graph).manifolds == {"se3": 9, "euclidean": 1}


def test_what_the_other_input_cannot_hold_is_no_such_problem():
    problem = small_problem()
    one_held = both_ways.of_problem(problem, held=(1,))  # cx without cy
    assert problem_of(one_held) is None and bundle.inspect(one_held).num_factors > 0
    robust = problem_of(both_ways.of_problem(problem, loss="huber"))
    assert robust is not None and robust.options.loss == "huber"
    assert robust.options.refine == ("poses", "points", "focal", "principal_point", "extra")


def test_nothing_to_order_is_one_line():
    empty = bundle.FactorGraph()
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one variable, found 0"):
        bundle.inspect(empty)
    empty.add_variable("x", [0.0])
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one factor, found 0"):
        bundle.inspect(empty)
    held = bundle.FactorGraph()
    held.add_variable("x", [0.0], fixed=True)
    held.add_factor(bundle.PriorFactor("x", [1.0], 1))
    with pytest.raises(bundle.InputError, match=r"^graph: expected a free coordinate"):
        bundle.inspect(held)
    with pytest.raises(bundle.InputError, match=r"^refine: expected the default"):
        bundle.inspect(both_ways.of_problem(small_problem()), refine="poses")
