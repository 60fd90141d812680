"""Counts of pose graphs: the table of exact nonzeros, a dense symbolic oracle, the command."""

import json

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs import graphs


def chain(num_poses, num_closures, dimension=3):
    """A chain with closures between random pairs, each once; nothing but its pattern counts."""
    rng = np.random.default_rng(num_poses)
    edges = [(k, k + 1) for k in range(num_poses - 1)]
    seen = set(edges)
    while len(edges) < num_poses - 1 + num_closures:
        pair = tuple(sorted(rng.choice(num_poses, 2, replace=False).tolist()))
        if pair not in seen:
            seen.add(pair)
            edges.append(pair)
    pose = [0, 0, 0, 1, 0, 0, 0] if dimension == 3 else [0, 0, 0]
    d = 6 if dimension == 3 else 3
    return bundle.PoseGraph(
        poses=np.tile(np.array(pose, float), (num_poses, 1)),
        edges=np.array(edges),
        measurements=np.tile(np.array(pose, float), (len(edges), 1)),
        information=np.tile(np.eye(d), (len(edges), 1, 1)),
    )


@pytest.mark.parametrize(
    ("num_poses", "num_closures", "nnz", "percent"),
    [(3, 0, 252, 77.8), (8, 2, 936, 40.6), (200, 30, 23_688, 1.645), (5000, 800, 597_528, 0.0664)],
)
def test_nonzeros_are_36_a_block(num_poses, num_closures, nnz, percent):
    found = bundle.inspect(chain(num_poses, num_closures))
    assert found.nnz == nnz == 36 * (num_poses + 2 * (num_poses - 1) + 2 * num_closures)
    np.testing.assert_allclose(100 * found.density, percent, rtol=1e-3)
    assert found.num_free_poses == num_poses - 1


def test_the_plane_has_9_a_block_and_a_chain_has_no_fill():
    for dimension, block in ((2, 9), (3, 36)):
        found = bundle.inspect(chain(20, 0, dimension))
        assert found.nnz == block * (20 + 2 * 19) and found.nnz_free == block * (19 + 2 * 18)
        natural = found.costs[0]
        d = found.block_size
        assert natural.ordering == "natural" and natural.fill == 0
        assert natural.nnz_factor == 19 * d * (d + 1) // 2 + 18 * d * d
        below = [c for k in range(19) for c in range(d * (k < 18), d * (k < 18) + d)]
        assert natural.flops == sum(c * c + 3 * c for c in below)


def test_counts_are_those_of_a_dense_factorisation():
    graph = chain(14, 9, 2)
    found = bundle.inspect(graph)
    matrix = np.zeros((42, 42))
    for i, j in graph.edges:
        for a in (i, j):
            for b in (i, j):
                matrix[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += 1 if a != b else 50
    matrix += 50 * np.eye(42)
    factor = np.linalg.cholesky(matrix[3:, 3:])
    assert found.costs[0].nnz_factor == int((np.abs(factor) > 1e-14).sum())
    taken = [cost for cost in found.costs if cost.is_taken]
    assert {cost.ordering for cost in taken} == {"natural", "amd", "metis"}
    dense = found.costs[-1]
    assert dense.ordering == "dense" and dense.nnz_factor == 39 * 40 // 2
    assert dense.fill == 13 * 12 // 2 - len([e for e in graph.edges if 0 not in e])
    for cost in taken:
        assert cost.memory_in_bytes == 8 * cost.nnz_factor and cost.tree_height <= 13


def test_a_solve_has_the_factor_that_was_counted():
    graph = graphs.loop(3, num_poses=40, num_closures=25)
    found = bundle.inspect(graph)
    for cost in (cost for cost in found.costs if cost.is_taken):
        summary = bundle.solve(graph, ordering=cost.ordering, max_num_iterations=1).summary
        assert summary.num_factor_nonzeros == cost.nnz_factor
    assert bundle.solve(graph, max_num_iterations=1).summary.factor_ordering == found.auto_ordering
    assert found.auto_ordering in found.recommendation


def test_repeated_edges_and_held_poses():
    graph = chain(6, 0)
    twice = graph.replace(
        edges=np.concatenate([graph.edges, graph.edges[:, ::-1]]),
        measurements=np.tile(graph.measurements, (2, 1)),
        information=np.tile(graph.information, (2, 1, 1)),
        edge_lines=None,
    )
    assert bundle.inspect(twice).nnz == bundle.inspect(graph).nnz
    with pytest.raises(bundle.InputError, match=r"^graph: expected a free pose"):
        bundle.inspect(graph.replace(fixed=np.ones(6, bool)))
    with pytest.raises(bundle.InputError, match=r"^loss: "):
        bundle.inspect(graph, loss="huber")


def test_the_command(tmp_path, capsys):
    from bundle.cli.main import main

    bundle.save(chain(8, 2), tmp_path / "x.g2o")
    assert main(["inspect", str(tmp_path / "x.g2o"), "--quiet", "--verbose"]) == 0
    said = capsys.readouterr().out
    assert "936" in said and "amd" in said and "metis" in said
    assert main(["inspect", str(tmp_path / "x.g2o"), "--quiet", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["command"] == "inspect" and found["nnz"] == 936 and len(found["costs"]) == 6
    for flags in (["--ordering", "amd"], ["--gauge", "none"]):
        assert main(["inspect", str(tmp_path / "x.g2o"), *flags]) == 2
        assert capsys.readouterr().err.splitlines()[-1].startswith(f"error: {flags[0]}: ")
    assert not (tmp_path / "x.html").exists()


def test_a_pose_graph_is_counted_as_the_factor_graph_that_it_is():
    found = bundle.inspect(chain(6, 2, dimension=2))
    assert (found.num_variables, found.num_factors, found.num_edges) == (6, 7, 7)
    assert found.manifolds == {"se2": 6} and found.kinds == {"BetweenFactor": 7}
    assert (found.num_columns, found.num_free_variables, found.largest_clique) == (15, 5, 2)
    assert bundle.inspect(chain(2, 0)).largest_clique == 1
