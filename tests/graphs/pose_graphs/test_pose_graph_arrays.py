"""The container: shapes and values that contradict each other, copies, pickles."""

import pickle

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs import graphs

BAD = {
    "poses": (np.zeros((12, 4)), r"^poses: expected shape"),
    "edges": (np.zeros((17, 3), int), r"^edges: expected shape"),
    "measurements": (np.zeros((17, 7)), r"^measurements: expected shape"),
    "information": (np.zeros((17, 6, 6)), r"^information: expected shape"),
    "ids": (np.zeros(12, int), r"^ids: expected unique ids, found 0"),
    "fixed": (np.zeros(12), r"^fixed: expected flags"),
    "edge_lines": (np.zeros(3, int), r"^edge_lines: expected shape"),
}


@pytest.mark.parametrize("name", BAD)
def test_arrays_that_do_not_fit_are_refused(name):
    value, message = BAD[name]
    with pytest.raises(bundle.InputError, match=message):
        graphs.loop(2).replace(**{name: value})


def changed(graph, name, place, value):
    array = getattr(graph, name).copy()
    array[place] = value
    return graph.replace(**{name: array})


@pytest.mark.parametrize(
    ("dimension", "name", "place", "value", "message"),
    [
        (2, "poses", (3, 1), np.nan, r"^poses\[3\]: expected finite"),
        (2, "measurements", (2, 0), np.inf, r"^measurements\[2\]: expected finite"),
        (3, "poses", (5, slice(0, 4)), 0, r"^poses\[5\]: expected a quaternion"),
        (3, "measurements", (1, slice(0, 4)), 0, r"^measurements\[1\]: expected a quaternion"),
        (2, "edges", (4, 1), 12, r"^edges\[4\]: expected indices of poses from 0 to 11"),
        (2, "edges", (4, 1), -1, r"^edges\[4\]: expected indices"),
        (2, "edges", (4, 1), 4, r"^edges\[4\]: expected two different poses"),
        (2, "ids", 0, -3, r"^ids: expected whole numbers from 0, found -3"),
    ],
)
def test_values_that_are_none_are_refused(dimension, name, place, value, message):
    with pytest.raises(bundle.InputError, match=message):
        changed(graphs.loop(dimension), name, place, value)


def test_it_pickles_shows_itself_and_stays_read_only():
    graph = graphs.loop(3)
    again = pickle.loads(pickle.dumps(graph))
    np.testing.assert_array_equal(again.poses, graph.poses)
    for found in (graph, again):
        assert "12 poses" in repr(found) and "6 closures" in repr(found)
        for name in ("poses", "edges", "measurements", "information", "ids", "fixed"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(found, name)[0] = 1
    result = bundle.solve(graph)
    assert pickle.loads(pickle.dumps(result)).summary == result.summary
    assert "PoseGraphResult: Converged" in repr(result)


def test_an_edge_is_named_by_its_file_and_line():
    graph = graphs.loop(2).replace(path="x.g2o", edge_lines=np.arange(17) + 13)
    assert graph.edge_name(2) == "x.g2o:15: edge 2 3"
    assert graphs.loop(2).edge_name(2) == "edge 2 3"
