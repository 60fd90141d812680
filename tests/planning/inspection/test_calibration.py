"""Numbers that are known from paper, from lectures and from the literature."""

import numpy as np
import pytest
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu

from bundle import inspect_graph
from bundle.planning.inspection.peak_memory import count_schur
from tests.planning.inspection.graphs import chain, cycle, random_closures, revisited_aisles, star


@pytest.mark.parametrize(
    ("edges", "counts", "fill", "flops"),
    [
        (cycle(6), (2, 2, 2, 2, 1, 0), 3, 44),
        (chain(6), (1, 1, 1, 1, 1, 0), 0, 20),
        (star(6, hub=6), (1, 1, 1, 1, 1, 1, 0), 0, 24),  # leaves first
        (star(6, hub=0), (6, 5, 4, 3, 2, 1, 0), 15, 154),  # the hub first
    ],
    ids=["cycle", "chain", "leaves-first", "hub-first"],
)
def test_small_graphs_in_natural_order(edges, counts, fill, flops):
    graph = inspect_graph(edges)
    assert graph.column_counts == counts
    assert (graph.fill, graph.flops) == (fill, flops)
    assert [len(step.neighbours) for step in graph.steps] == list(counts)
    assert (graph.steps[-1].total_fill, graph.steps[-1].total_flops) == (fill, flops)


def test_the_middle_of_a_chain_first():
    graph = inspect_graph(chain(3), ordering=[1, 0, 2])
    assert graph.fill == 1
    assert graph.steps[0].fill == ((0, 2),)


@pytest.mark.parametrize(
    ("closure", "fill", "flops"), [([], 0, 60), ([(3, 11)], 6, 102), ([(0, 15)], 13, 144)]
)
def test_sixteen_poses(closure, fill, flops):
    """Alone, with a closure that makes a cycle of nine poses, and closed end to end."""
    graph = inspect_graph(chain(16) + closure)
    assert (graph.fill, graph.flops) == (fill, flops)


@pytest.mark.parametrize(
    ("poses", "loops", "nnz"), [(3, 0, 252), (8, 2, 936), (200, 30, 23_688), (5000, 800, 597_528)]
)
def test_pose_graphs_of_six_degrees_of_freedom(poses, loops, nnz):
    graph = inspect_graph(random_closures(poses, loops, seed=0), block_size=6)
    assert graph.nnz == nnz == 36 * (poses + 2 * (poses - 1) + 2 * loops)
    assert graph.num_columns == 6 * poses


def test_density_of_a_large_pose_graph():
    graph = inspect_graph(random_closures(5000, 800, seed=0), block_size=6)
    assert graph.num_columns**2 == 9e8
    assert 100 * graph.density == pytest.approx(0.0664, abs=5e-5)


@pytest.mark.parametrize("poses", [1, 2, 4, 7])
def test_a_landmark_joins_its_poses(poses):
    edges = star(poses, hub=poses)
    graph = inspect_graph(edges, ordering="landmarks_first", landmarks=[poses])
    assert graph.order[0] == poses
    assert len(graph.steps[0].fill) == graph.fill == poses * (poses - 1) // 2
    # Of four: 13 nonzeros with the landmark, 16 of the poses alone when it is gone.
    left = inspect_graph(graph.steps[0].fill, poses)
    assert graph.nnz == 1 + 3 * poses
    assert left.nnz == poses**2


def test_three_cameras_and_four_points():
    """Points seen by cameras {1, 2}, {1, 2, 3}, {2, 3} and {1, 3}."""
    tracks = [(0, 1), (0, 1, 2), (1, 2), (0, 2)]
    edges = [(camera, 3 + point) for point, track in enumerate(tracks) for camera in track]
    graph = inspect_graph(
        edges, ordering="landmarks_first", landmarks=range(3, 7), block_size=[6] * 3 + [3] * 4
    )
    reduced = {edge for step in graph.steps[:4] for edge in step.fill}
    assert reduced == {(0, 1), (0, 2), (1, 2)}
    assert inspect_graph(reduced, 3, block_size=6).nnz == 18 * 18  # S is full

    # Of 4 points, three are seen by 2 cameras and one by 3.
    pairs, triple, cameras = count_schur(3, 3, 2), count_schur(3, 1, 3), 3
    assert pairs.num_block_products + triple.num_block_products == 21
    assert (pairs.points + triple.points, pairs.products + triple.products) == (108, 3402)
    assert pairs.reduced == triple.reduced == (6 * cameras) ** 3 / 3 == 1944
    assert count_schur(3, 4, 2).num_unknowns == 30
    assert count_schur(3, 4, 2).dense == 9000


def test_hundred_cameras_and_twenty_thousand_points():
    counts = count_schur(100, 20_000, 4)
    assert counts.num_unknowns == 60_600
    assert counts.dense == pytest.approx(7.4e13, rel=5e-3)
    assert counts.points == 5.4e5
    assert counts.products == pytest.approx(5.2e7, rel=5e-3)
    assert counts.reduced == 7.2e7
    assert counts.schur == pytest.approx(1.2e8, rel=5e-2)


def test_squares_of_dense_column_counts():
    """Leading term of the flops for n = 100 columns with c entries below the diagonal."""
    edges = [(i, j) for i in range(100) for j in range(i)]
    graph = inspect_graph(edges)
    assert sum(c * c for c in graph.column_counts) == 328_350
    assert graph.flops == 328_350 + 3 * 4950
    assert graph.cholmod_flops == 338_350  # the same squares with the diagonal


LARGE = {
    "random": (random_closures(5000, 800, seed=1), 10, 20),
    "aisles, five rounds": (revisited_aisles(5000, 800, lap=1000, seed=1), 30, 500),
    "aisles, twice": (revisited_aisles(5000, 800, lap=2500, seed=1), 30, 500),
}


@pytest.mark.parametrize("block_size", [1, 6])
@pytest.mark.parametrize("name", LARGE)
def test_order_decides_what_a_large_pose_graph_costs(name, block_size):
    edges, less_nonzeros, less_flops = LARGE[name]
    natural, amd = (
        inspect_graph(edges, ordering=ordering, block_size=block_size, record_steps=False)
        for ordering in ("natural", "amd")
    )
    assert natural.nnz_factor > less_nonzeros * amd.nnz_factor
    assert natural.flops > less_flops * amd.flops


@pytest.mark.parametrize("name", LARGE)
def test_a_large_pose_graph_has_one_solution_in_any_order(name):
    """SuperLU factorises in the given order, into as many nonzeros as predicted.

    Loops weigh less than the chain, as what reaches far along it would otherwise round to zero,
    which SuperLU does not count.
    """
    edges = np.array(LARGE[name][0])
    rng = np.random.default_rng(2)
    weight = rng.uniform(0.5, 2, len(edges)) * np.where(np.diff(edges)[:, 0] == 1, 1, 1e-2)
    graph = coo_array((-weight, edges.T), (5000, 5000))
    degree = np.bincount(edges.ravel(), np.repeat(weight, 2), 5000)
    matrix = (graph + graph.T + diags_array(degree + 1e-4)).tocsc()
    b = rng.standard_normal(5000)
    solutions = []
    for ordering in ("natural", "reverse", "amd", "colamd", "metis", "nesdis"):
        counted = inspect_graph(edges, ordering=ordering, record_steps=False)
        order = np.array(counted.order)
        factor = splu(
            matrix[order][:, order],
            permc_spec="NATURAL",
            diag_pivot_thresh=0,
            options={"SymmetricMode": True},
        )
        assert np.array_equal(factor.perm_r, np.arange(5000))
        assert factor.L.nnz == counted.nnz_factor
        x = np.empty(5000)
        x[order] = factor.solve(b[order])
        solutions.append(x)
    for x in solutions[1:]:
        assert np.abs(x - solutions[0]).max() <= 1e-9 * np.abs(solutions[0]).max()
