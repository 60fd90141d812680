"""The exact eliminator and the core's counts, against a full array of flags and each other."""

import numpy as np
import pytest

from bundle import InputError, inspect_graph
from bundle.planning.inspection.graph_inspection import GRAPH_ORDERINGS
from tests.planning.inspection.graphs import (
    adjacency,
    chain,
    cycle,
    eliminate_in_full,
    random_graph,
    star,
)

CASES = [(1 + 3 * (seed % 12), seed % 40, seed) for seed in range(40)]


def inspect_random(num_variables, num_edges, seed, ordering, **changes):
    edges = random_graph(num_variables, num_edges, seed) if num_variables > 1 else []
    landmarks = range(0, num_variables, 3)
    return inspect_graph(edges, num_variables, ordering, landmarks=landmarks, **changes)


@pytest.mark.parametrize("ordering", GRAPH_ORDERINGS)
def test_counts_are_those_of_a_full_elimination(ordering):
    for case in CASES:
        graph = inspect_random(*case, ordering)
        matrix = adjacency(graph.num_variables, graph.edges)
        factor = eliminate_in_full(matrix, graph.order)
        counts = factor.sum(0) - 1
        assert sorted(graph.order) == list(range(graph.num_variables))
        assert graph.column_counts == graph.scalar_column_counts == tuple(counts)
        assert graph.fill == factor.sum() - graph.num_variables - len(graph.edges)
        assert graph.flops == (counts**2 + 3 * counts).sum()
        assert graph.cholmod_flops == ((counts + 1) ** 2).sum()
        assert graph.nnz == matrix.sum()
        assert graph.nnz_factor == factor.sum()
        assert graph.tree_height == height_of(factor)


def height_of(factor):
    heights = np.ones(len(factor), int)
    for j in range(len(factor)):
        below = np.flatnonzero(factor[j + 1 :, j])
        if len(below):
            parent = j + 1 + below[0]
            heights[parent] = max(heights[parent], heights[j] + 1)
    return heights.max(initial=0)


@pytest.mark.parametrize("ordering", GRAPH_ORDERINGS)
def test_steps_add_up(ordering):
    for case in CASES:
        graph = inspect_random(*case, ordering, block_size=2)
        met = {variable: set() for variable in range(graph.num_variables)}
        for a, b in graph.edges:
            met[a].add(b)
            met[b].add(a)
        fill = flops = 0
        for step, variable, count in zip(
            graph.steps, graph.order, graph.column_counts, strict=True
        ):
            assert step.variable == variable
            assert step.neighbours == tuple(sorted(met.pop(variable)))
            assert len(step.neighbours) == count
            for a, b in step.fill:
                assert a < b
                assert b not in met[a]
                met[a].add(b)
                met[b].add(a)
            for neighbour in step.neighbours:  # all meet each other now
                met[neighbour].discard(variable)
                assert met[neighbour] >= {*step.neighbours} - {neighbour}
            c = np.array([2 * count + 1, 2 * count])
            assert step.flops == (c**2 + 3 * c).sum()
            fill, flops = fill + len(step.fill), flops + step.flops
            assert (step.total_fill, step.total_flops) == (fill, flops)
        assert (graph.fill, graph.flops) == (fill, flops)


def test_blocks_count_as_full():
    for case in CASES:
        rng = np.random.default_rng(case[-1])
        sizes = rng.integers(1, 6, case[0])
        graph = inspect_random(*case, "amd", block_size=sizes)
        blocks = adjacency(graph.num_variables, graph.edges)
        scalars = blocks.repeat(sizes, 0).repeat(sizes, 1)
        first = np.concatenate([[0], np.cumsum(sizes)])
        order = np.concatenate([np.arange(first[v], first[v + 1]) for v in graph.order])
        factor = eliminate_in_full(scalars, order)
        counts = factor.sum(0) - 1
        assert graph.num_columns == len(scalars)
        assert graph.scalar_column_counts == tuple(counts)
        assert graph.nnz == scalars.sum()
        assert graph.density == scalars.mean()
        assert graph.nnz_factor == factor.sum()
        assert graph.flops == (counts**2 + 3 * counts).sum()


def test_minimum_degree_is_greedy_and_breaks_ties_by_index():
    for case in CASES:
        graph = inspect_random(*case, "minimum_degree")
        left = adjacency(graph.num_variables, graph.edges)
        alive = np.ones(graph.num_variables, bool)
        for variable in graph.order:
            degree = np.where(alive, left.sum(0) - 1, graph.num_variables)
            assert variable == degree.argmin()  # argmin: the first of several
            neighbours = left[variable]
            left[np.ix_(neighbours, neighbours)] = True
            left[variable] = left[:, variable] = False
            alive[variable] = False


def test_orders_by_index():
    edges = cycle(5)
    assert inspect_graph(edges).order == (0, 1, 2, 3, 4)
    assert inspect_graph(edges, ordering="reverse").order == (4, 3, 2, 1, 0)
    graph = inspect_graph(edges, ordering="landmarks-first", landmarks=[3, 1, 3])
    assert graph.order == (1, 3, 0, 2, 4)
    assert graph.landmarks == (1, 3)
    assert graph.ordering == "landmarks_first"
    assert inspect_graph(edges, ordering=np.array([2, 0, 1, 4, 3])).order == (2, 0, 1, 4, 3)


@pytest.mark.parametrize("ordering", ["minimum_degree", "amd", "colamd"])
def test_minimum_degree_fills_no_star(ordering):
    assert inspect_graph(star(30, hub=0), ordering=ordering).fill == 0


@pytest.mark.parametrize("ordering", GRAPH_ORDERINGS[:2] + GRAPH_ORDERINGS[3:])
def test_graphs_without_edges(ordering):
    for num_variables in (0, 1, 5):
        graph = inspect_graph([], num_variables, ordering)
        assert sorted(graph.order) == list(range(num_variables))
        assert (graph.nnz, graph.nnz_factor, graph.flops) == (num_variables, num_variables, 0)
        assert graph.tree_height == min(1, num_variables)
    assert inspect_graph(np.zeros((0, 2), int)).num_variables == 0


def test_an_edge_is_one_edge_however_often_it_is_named():
    graph = inspect_graph([(0, 1), (1, 0), (2, 1), (0, 1)])
    assert graph.edges == ((0, 1), (1, 2))
    assert inspect_graph(iter([(0, 1), (1, 2)])).edges == graph.edges
    assert inspect_graph(np.array([[0, 1], [1, 2]], np.uint8)).edges == graph.edges


def test_parts_of_a_graph_do_not_meet():
    apart = inspect_graph([*cycle(6), *((a + 6, b + 6) for a, b in cycle(6))])
    assert apart.flops == 2 * 44
    assert apart.tree_height == 6


def test_names():
    graph = inspect_graph(chain(3), names=["x0", "x1", "x2"])
    assert graph.names == ("x0", "x1", "x2")
    assert inspect_graph(chain(2)).names == ("0", "1")
    assert inspect_graph([], names="ab").num_variables == 2


def test_steps_are_recorded_where_that_is_quick():
    full = random_graph(400, 40_000, 0)
    assert inspect_graph(full).steps == ()
    assert len(inspect_graph(chain(400)).steps) == 400
    assert inspect_graph(chain(4), record_steps=False).steps == ()
    assert len(inspect_graph(full[:200], record_steps=True).steps) > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"edges": [(0, 1), (2, 2)]}, "edge 1: expected two variables, found 2 twice"),
        (
            {"edges": [(0, 3)], "num_variables": 3},
            "edges: expected variables 0 to 2, found 3",
        ),
        ({"edges": [(0, -1)]}, "edges: expected variables 0 to 0, found -1"),
        (
            {"edges": [(0, 1)], "num_variables": 0},
            "edges: expected no variables, found 0",
        ),
        ({"edges": [(0, 1, 2)]}, "edges: expected shape (num_edges, 2), found (1, 3)"),
        ({"edges": [(0, 1), (1,)]}, "edges: expected an array of integers"),
        ({"edges": 3}, "edges: expected an array of integers, found 3"),
        ({"edges": [(0, 1.5)]}, "edges: expected integers, found float64"),
        ({"edges": [("a", "b")]}, "edges: expected integers, found 'a'"),
        ({"edges": [], "num_variables": -1}, "num_variables: expected 0 to 2147483646, found -1"),
        ({"edges": [(0, 2**31)]}, "num_variables: expected 0 to 2147483646, found 2147483649"),
        ({"edges": [], "num_variables": 2.0}, "num_variables: expected an integer, found 2.0"),
        (
            {"names": ["a"], "num_variables": 6},
            "names: expected 6 names, one per variable, found 1",
        ),
        ({"ordering": "camd"}, "ordering: expected one of natural, reverse, landmarks_first"),
        ({"ordering": [0, 1]}, "order: expected 6 entries, found 2"),
        (
            {"ordering": [0, 1, 2, 3, 4, 4]},
            "order: expected each of the blocks 0 to 5 once, found 4 twice",
        ),
        ({"ordering": [0, 1, 2, 3, 4, 6]}, "ordering: expected variables 0 to 5, found 6"),
        (
            {"ordering": "landmarks_first"},
            "ordering landmarks_first: expected at least one landmark, found 0",
        ),
        ({"landmarks": [6]}, "landmarks: expected variables 0 to 5, found 6"),
        ({"block_size": 0}, "block_size: expected 1 to 2147483647, found 0"),
        ({"block_size": 6.5}, "block_size: expected"),
        (
            {"block_size": [6, 6]},
            "block_size: expected one size, or 6 sizes, one per variable, found (2,)",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(InputError) as refused:
        inspect_graph(**{"edges": cycle(6), **arguments})
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)
