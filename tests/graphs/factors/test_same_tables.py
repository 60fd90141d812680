"""Every instrument gives the same numbers for a pose graph's file and for its FactorGraph."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.reports.page.graph_facts import facts_of_factor_graph, facts_of_pose_graph
from tests.graphs.pose_graphs import graphs

SHAPES = {
    "loop": [*((k, k + 1) for k in range(8)), (0, 8), (2, 6)],
    "star": [(0, k) for k in range(1, 9)],
    "tree": [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5), (5, 6), (5, 7), (7, 8)],
    "two components": [(0, 1), (1, 2), (2, 0), *((k, k + 1) for k in range(3, 8)), (3, 8)],
}
UNITS = [1e-3, 1.0, 1e7]
FIXED = [(), (4,), (1, 7)]


def of_shape(dimension, edges, unit, fixed):
    """A graph at its minimum, with lengths in a unit and the information that belongs to it."""
    rng = np.random.default_rng(5)
    d = 3 if dimension == 2 else 6
    lengths = slice(0, 2) if dimension == 2 else slice(3, 6)
    scale = np.ones(d)
    scale[lengths] = 1 / unit
    truth = [graphs.random_pose(rng, dimension, size=3.0) for _ in range(9)]
    inverse = np.linalg.inv
    measurements = [
        graphs.pose_of(
            inverse(graphs.matrix(truth[a]))
            @ graphs.matrix(truth[b])
            @ graphs.matrix(graphs.random_pose(rng, dimension, size=0.01, angle=0.01))
        )
        for a, b in edges
    ]
    information = np.array([graphs.random_information(rng, d) for _ in edges])
    graph = bundle.PoseGraph(
        poses=np.array(truth),
        edges=np.array(edges),
        measurements=np.array(measurements),
        information=1e4 * information * np.outer(scale, scale),
        fixed=np.isin(np.arange(9), fixed),
    )
    positions = slice(0, 2) if dimension == 2 else slice(4, 7)
    poses, measured = graph.poses.copy(), graph.measurements.copy()
    poses[:, positions] *= unit
    measured[:, positions] *= unit
    return bundle.solve(graph.replace(poses=poses, measurements=measured)).problem


def as_factors(graph):
    found = bundle.FactorGraph()
    for key, pose, fixed in zip(graph.ids.tolist(), graph.poses, graph.fixed, strict=True):
        manifold = "se2" if graph.dimension == 2 else "se3"
        found.add_variable(f"x{key}", pose, manifold, fixed=bool(fixed))
    ends = graph.ids[graph.edges].tolist()
    for (a, b), z, omega in zip(ends, graph.measurements, graph.information, strict=True):
        found.add_factor(bundle.BetweenFactor(f"x{a}", f"x{b}", z, omega))
    return found


# All pairs of shapes, dimensions, units and fixed poses.
CASES = [
    (shape, dimension, unit, FIXED[(k + row + dimension) % 3])
    for row, shape in enumerate(SHAPES)
    for dimension in (2, 3)
    for k, unit in enumerate(UNITS)
]


@pytest.fixture(params=CASES, ids=str, scope="module")
def both(request, tmp_path_factory):
    shape, dimension, unit, fixed = request.param
    graph = of_shape(dimension, SHAPES[shape], unit, fixed)
    path = tmp_path_factory.mktemp("graph") / "x.g2o"
    bundle.save(graph, path)
    return as_factors(graph), path


def close(ours, theirs):
    least = 1e-9 * np.abs(theirs).max(initial=1)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=least)


def test_diagnosis_and_inspection(both):
    graph, path = both
    ours, theirs = bundle.diagnose(graph), bundle.diagnose(path)
    for name in ("nullity", "expected_nullity", "condition_number", "condition_number_unscaled",
                 "eigenvalues", "edge_redundancy", "edge_test", "noise_scale"):  # fmt: skip
        close(getattr(ours, name), getattr(theirs, name))
    assert ours.held_pose_ids == tuple(f"x{key}" for key in theirs.held_pose_ids)
    assert [f.kind for f in ours.findings] == [f.kind for f in theirs.findings]
    ours, theirs = bundle.inspect(graph), bundle.inspect(path)
    for one, other in zip(ours.costs, theirs.costs, strict=True):
        assert dataclasses.asdict(one) == dataclasses.asdict(other)


@pytest.mark.parametrize("gauge", ["first", "inner"])
def test_covariances(both, gauge):
    graph, path = both
    ours, theirs = (bundle.covariance(one, gauge=gauge) for one in (graph, path))
    units = np.array([np.diag(theirs.pose(k)) for k in theirs.pose_ids.tolist()]).max(axis=0)
    scale = np.sqrt(np.outer(units, units))
    for k in theirs.pose_ids.tolist():
        np.testing.assert_allclose(
            ours.variable(f"x{k}") / scale, theirs.pose(k) / scale, rtol=1e-9, atol=1e-9
        )
    close(ours.dof, theirs.dof)
    close(ours.sigma0, theirs.sigma0)


@pytest.mark.parametrize("pair", [(0, 2), (1, 5)])
def test_relative_covariances_and_refusals(both, pair):
    graph, path = both
    keys = tuple(f"x{key}" for key in pair)
    try:
        theirs = bundle.covariance(path, relative=[pair]).relative(*pair)
    except bundle.InputError as refused:
        with pytest.raises(bundle.InputError, match=r"^relative: ") as other:
            bundle.covariance(graph, relative=[keys])
        assert str(refused).startswith("relative: ") and keys[0] in str(other.value)
    else:
        ours = bundle.covariance(graph, relative=[keys]).relative(*keys)
        units = np.sqrt(np.diag(theirs))
        np.testing.assert_allclose(
            ours / np.outer(units, units), theirs / np.outer(units, units), rtol=1e-9, atol=1e-9
        )


def test_chi2_and_pages(both):
    graph, path = both
    ours, theirs = bundle.chi2_kinds(graph)[-1], bundle.chi2_kinds(path)[-1]
    close([ours.chi2, ours.degrees, ours.low, ours.high],
          [theirs.chi2, theirs.degrees, theirs.low, theirs.high])  # fmt: skip
    assert ours.verdict == theirs.verdict and ours.count == theirs.count
    ours, theirs = facts_of_factor_graph(graph, None), facts_of_pose_graph(bundle.load(path))
    for name in ("positions", "rotations", "ends", "chi2", "sizes"):
        close(getattr(ours, name), getattr(theirs, name))
