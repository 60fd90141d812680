"""Normal equations with named blocks: both kinds of graphs, and a toy that states its blocks."""

import numpy as np
import pytest

import bundle
from bundle.analysis.factor_equations import FactorEquations
from bundle.analysis.normal_equations import POSES, PoseEquations, SelectedInverse, TermTests
from bundle.analysis.uncertainty.graph_covariance import selected_covariance
from bundle.graphs.pose_graphs.edge_weights import weighted_graph
from tests.graphs.pose_graphs import graphs


def both(graph):
    yield PoseEquations(weighted_graph(graph, None, {"num_threads": 1}, "covariance"))
    factors = bundle.FactorGraph()
    for key, pose in enumerate(graph.poses):
        manifold = "se2" if graph.dimension == 2 else "se3"
        factors.add_variable(key, pose, manifold, fixed=bool(graph.fixed[key]))
    for (a, b), z, omega in zip(
        graph.edges.tolist(), graph.measurements, graph.information, strict=True
    ):
        if omega.any(axis=1).all():
            factors.add_factor(bundle.BetweenFactor(a, b, z, omega))
        else:  # a factor has full information: the position alone
            factors.add_factor(bundle.FunctionFactor([a, b], position))
    yield FactorEquations(factors, 1)


def position(values):
    """Difference of the positions of two poses that look along x."""
    by_first, by_second = -np.eye(2, 3), np.eye(2, 3)
    return values[1][:2] - values[0][:2] - [1.0, 0.0], [by_first, by_second]


@pytest.mark.parametrize("dimension", [2, 3])
def test_both_kinds_of_graphs_give_the_same_blocks(dimension):
    graph = graphs.loop(dimension, num_poses=9, num_closures=3)
    graph = graph.replace(fixed=np.arange(9) == 2)
    pairs = [(0, 5), (7, 1)]
    one, other = both(graph)
    theirs, ours = (each.selected_inverse(pairs=pairs, with_tests=True) for each in (one, other))
    np.testing.assert_allclose(ours.blocks, theirs.blocks, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(ours.across, theirs.across, rtol=1e-7, atol=1e-12)
    for name in ("redundancy", "test", "rank", "decrease"):
        np.testing.assert_allclose(
            getattr(ours.tests, name), getattr(theirs.tests, name), rtol=1e-6, atol=1e-9
        )
    np.testing.assert_allclose(ours.inflation, theirs.inflation, rtol=1e-6)
    np.testing.assert_allclose(other.squares, one.squares, rtol=1e-7)
    np.testing.assert_allclose(other.cost, one.cost, rtol=1e-7)
    assert (other.dof, other.num_gauge) == (one.dof, one.num_gauge)
    assert one.open_blocks() == other.open_blocks() == []
    assert one.separated(pairs) is other.separated(pairs) is None


def test_both_kinds_of_graphs_name_blocks_that_float():
    graph = bundle.PoseGraph(
        poses=np.array([[0.0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0]]),
        edges=np.array([[0, 1], [2, 3]], np.int32),
        measurements=np.tile([1.0, 0, 0], (2, 1)),
        information=np.tile(np.eye(3), (2, 1, 1)),
    )
    for equations in both(graph):
        assert equations.separated([(0, 1), (1, 2)]) == (1, 2)
        assert equations.num_gauge == 6 and equations.open_blocks() == []


def test_both_kinds_of_graphs_name_blocks_with_an_open_direction():
    graph = bundle.PoseGraph(
        poses=np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]),
        edges=np.array([[0, 1], [1, 2]], np.int32),
        measurements=np.tile([1.0, 0, 0], (2, 1)),
        information=np.array([np.eye(3), np.diag([1.0, 1, 0])]),
        fixed=np.arange(3) == 0,
    )
    for equations in both(graph):
        assert equations.open_blocks() == [2]


class Toy:
    """Two blocks of one number, whose variances are stated."""

    words, num_gauge, num_floating, cost = POSES, 0, 1, 2.0
    squares = np.array([1.0, 3.0])
    weighted_squares, dof, spectrum = 4.0, 1, None

    def __init__(self, **changes):
        self.inflation, self.decrease, self.undetermined, self.open = 1.0, 0.0, -1, []
        vars(self).update(changes)

    def name(self, block):
        return f"toy {block}"

    def open_blocks(self):
        return self.open

    def separated(self, pairs):
        return (0, 1) if (0, 1) in pairs and self.num_gauge else None

    def selected_inverse(self, is_inner=False, *_):
        blocks = np.array([[[2.0]], [[8.0]]]) * (0.5 if is_inner else 1.0)
        tests = TermTests(np.zeros(0), np.zeros(0), np.zeros(0, np.int64), self.decrease)
        return SelectedInverse(blocks, (), (), self.undetermined, self.inflation, tests)


def notes(**changes):
    return selected_covariance(Toy(**changes), [], "first", "unit")[2]["notes"]


def test_a_toy_has_its_covariance():
    found, factor, facts = selected_covariance(Toy(), [], "inner", "sigma0")
    np.testing.assert_array_equal(found.blocks[1], [[4.0]])
    assert (factor, facts["sigma0"], facts["dof"], facts["notes"]) == (4.0, 2.0, 1, ())
    assert selected_covariance(Toy(), [], "first", "unit")[1] == 1.0


def test_notes_begin_at_their_thresholds():
    assert notes(inflation=0.99e10) == () != notes(inflation=1.01e10)
    assert notes(decrease=2.0e-4) == () != notes(decrease=2.1e-4)  # 1e-4 of the cost 2
    assert "about 6 digits" in notes(inflation=1.1e10)[0]  # 16 - 10
    assert "by about 2 %" in notes(decrease=0.04)[0]  # of the cost 2
    assert notes(num_floating=1) == () != notes(num_floating=2)


@pytest.mark.parametrize(
    ("changes", "pairs", "scale", "message"),
    [
        ({"open": [1]}, [], "unit", "found pose toy 1 with an undetermined direction"),
        ({"undetermined": 0}, [], "unit", "found pose toy 0 with an undetermined direction"),
        ({"num_gauge": 1}, [(0, 1)], "unit", "found toy 0 and toy 1"),
        ({"inflation": np.inf}, [], "unit", "variances that are only rounding errors"),
        ({"dof": 0}, [], "sigma0", "estimate sigma0 from, found 0"),
    ],
)
def test_a_toy_is_refused(changes, pairs, scale, message):
    with pytest.raises(bundle.InputError, match=message):
        selected_covariance(Toy(**changes), pairs, "first", scale)
