"""TORO's files: another order of information in the plane, angles in place of quaternions."""

import bz2
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.graphs import write

UPPER_6 = " ".join(["1 0 0 0 0 0", "1 0 0 0 0", "1 0 0 0", "1 0 0", "1 0", "1"])


def test_the_plane_has_the_information_of_the_angle_fourth(tmp_path):
    path = write(
        tmp_path / "a.graph",
        "# a comment",
        "VERTEX2 0 0 0 0",
        "VERTEX2 1 1 -2 6.5",
        "EDGE2 0 1 1 2 3  11 12 22 33 13 23",
    )
    graph = bundle.load(path)
    assert isinstance(graph, bundle.PoseGraph) and graph.dimension == 2
    assert graph.poses.tolist() == [[0, 0, 0], [1, -2, 6.5]]
    assert graph.measurements.tolist() == [[1, 2, 3]] and graph.edge_lines.tolist() == [4]
    assert graph.information.tolist() == [[[11, 12, 13], [12, 22, 23], [13, 23, 33]]]


def test_space_has_roll_pitch_and_yaw(tmp_path):
    upper = [10 * (r + 1) + c + 1 for r in range(6) for c in range(r, 6)]
    path = write(
        tmp_path / "a.graph",
        "VERTEX3 0 0 0 0 0 0 0",
        "VERTEX3 1 1 2 3 0.4 -0.5 2.6",
        f"EDGE3 0 1 4 5 6 -3 0.2 0.1 {' '.join(map(str, upper))}",
    )
    graph = bundle.load(path)
    for found, xyz, angles in (
        (graph.poses[0], (0, 0, 0), (0, 0, 0)),
        (graph.poses[1], (1, 2, 3), (2.6, -0.5, 0.4)),
        (graph.measurements[0], (4, 5, 6), (0.1, 0.2, -3)),
    ):
        assert found[4:].tolist() == list(xyz)
        expected = Rotation.from_euler("ZYX", angles).as_matrix()
        np.testing.assert_allclose(graphs.matrix(found)[:3, :3], expected, atol=1e-15)
    first = [[44, 45, 46, 14, 24, 34], [45, 55, 56, 15, 25, 35], [46, 56, 66, 16, 26, 36]]
    second = [[14, 15, 16, 11, 12, 13], [24, 25, 26, 12, 22, 23], [34, 35, 36, 13, 23, 33]]
    assert graph.information[0].tolist() == first + second


def test_a_file_of_edges_compressed_and_what_is_written(tmp_path):
    lines = "EDGE2 3 4 1 0 0.1 1 0 1 1 0 0\nEDGE2 4 5 1 0 0.1 2 0 2 2 0 0\n"
    (tmp_path / "a.txt").write_bytes(bz2.compress(lines.encode()))
    graph = bundle.load(tmp_path / "a.txt")
    assert graph.ids.tolist() == [3, 4, 5] and not graph.has_poses
    bundle.save(graph, tmp_path / "b.g2o")
    assert (tmp_path / "b.g2o").read_text().startswith("VERTEX_SE2 3 ")
    again = bundle.load(tmp_path / "b.g2o")
    np.testing.assert_array_equal(again.information, graph.information)
    np.testing.assert_array_equal(again.poses, graph.poses)


def test_what_public_files_hold_beside_poses_is_noted(tmp_path):
    path = write(
        tmp_path / "a.graph",
        "VERTEX 0 0 0 0",
        "ROBOTLASER1 0 -1.57 3.14 0.017 30 0.1 0 3 1.5 1.6 1.7 0 0 0 0 0 0 0 0 0 0 0 1.0 host 1.0",
        "VERTEX2 1 1 0 0",
        "EDGE 0 1 1 0 0.1",
        "EDGE2 0 1 1 0 0.2  4 1 5 6 0 0",
        "EQUIV 0 1",
        "EQUIV 1 0",
    )
    graph = bundle.load(path)
    assert graph.num_poses == 2 and graph.format == "toro"
    assert graph.information.tolist() == [np.eye(3).tolist(), [[4, 1, 0], [1, 5, 0], [0, 0, 6]]]
    assert graph.edge_lines.tolist() == [4, 5]
    plain, equal, packets = graph.notes
    assert plain.startswith("1 edge ") and equal.startswith("2 lines EQUIV")
    assert packets.startswith("1 packet ")
    angles = "EDGE3 0 1 4 5 6 0.1 0.2 0.3"
    space = bundle.load(write(tmp_path / "b.graph", angles, "FLASER 2 1 1"))
    np.testing.assert_array_equal(space.information, np.eye(6)[None])
    assert bundle.load(write(tmp_path / "c.g2o", *G2O_LINES)).notes == ()


def test_the_notes_reach_the_reports(tmp_path, capsys):
    from bundle.cli.main import main

    path = write(tmp_path / "a.graph", "EDGE2 0 1 1 0 0.1", "EDGE2 1 2 1 0 0.1", "EQUIV 0 1")
    for words in (["info"], ["refine", "-o", str(tmp_path / "b.g2o")]):
        report = tmp_path / "r.json"
        assert main([*words, str(path), "--json", str(report), "--quiet"]) == 0
        assert "2 edges without information" in " ".join(capsys.readouterr().out.split())
        assert len(json.loads(report.read_text())["input"]["notes"]) == 2


TORO_ORDER = "EDGE{} 0 1 1 0 0  4 0.5 3 2 0 0"
G2O_ORDER = "EDGE{} 0 1 1 0 0  4 0.5 0 3 0 2"
G2O_LINES = ["VERTEX_SE2 0 0 0 0", "VERTEX_SE2 1 1 0 0", G2O_ORDER.format("_SE2")]


@pytest.mark.parametrize(
    ("line", "hint"),
    [(G2O_ORDER.format(2), "EDGE_SE2"), (TORO_ORDER.format("_SE2"), "EDGE2")],
)
def test_information_in_the_order_of_the_other_format_is_named(tmp_path, line, hint):
    graph = bundle.load(write(tmp_path / "a.graph", line))
    with pytest.raises(bundle.InputError, match=f"order .*{hint}") as caught:
        bundle.solve(graph)
    assert "isotropic" not in str(caught.value)
    fits = bundle.load(write(tmp_path / "b.graph", line.replace(line.split()[0], hint)))
    bundle.solve(fits)
    np.testing.assert_array_equal(fits.information, [[[4, 0.5, 0], [0.5, 3, 0], [0, 0, 2]]])
    bad = bundle.load(write(tmp_path / "c.graph", line, "EDGE" + line[4:-1] + "-9"))
    with pytest.raises(bundle.InputError, match="isotropic"):
        bundle.solve(bad)  # in neither order


@pytest.mark.parametrize(
    ("lines", "place", "words"),
    [
        (["VERTEX2 0 0 0 0", "VERTEX_SE2 1 0 0 0"], 2, "poses and edges of one kind"),
        (["VERTEX3 0 0 0 0 0 0"], 1, "yaw of vertex 0"),
        (["VERTEX3 0 0 0 0 0 0 0 1"], 1, "the end of the line after 7 numbers"),
        (["VERTEX2 0 0 0 0", "EDGE2 0 1 1 0 0 1 0 1 1 0"], 2, "the information of edge 0 1"),
        (["VERTEX3 0 0 0 0 0 0 nan"], 1, "yaw of vertex 0"),
        (["EDGE3 0 1 0 0 0 0 0 0 " + UPPER_6 + " 7"], 1, "the end of the line after 29 numbers"),
        (["VERTEX2 0 0 0 0", "EQUIV 0"], 2, "the id of the second vertex"),
        (["VERTEX2 0 0 0 0", "EQUIV 0 1 2"], 2, "the end of the line after 2 numbers"),
        (["VERTEX_SE2 0 0 0 0", "EDGE_SE2 0 1 1 0 0"], 2, "the information of edge 0 1 in row 1"),
        (["VERTEX_SE2 0 0 0 0", "LANDMARK 0 1"], 2, "VERTEX2, EDGE2"),
    ],
)
def test_bad_files_are_one_line_with_the_place(tmp_path, lines, place, words):
    path = write(tmp_path / "a.graph", *lines)
    with pytest.raises(bundle.InputError) as caught:
        bundle.load(path)
    assert str(caught.value).startswith(f"{path}:{place}: expected ")
    assert words in str(caught.value)


def test_the_commands_tell_them_by_content(tmp_path, capsys):
    from bundle.cli.main import main

    path = write(
        tmp_path / "a.txt", "VERTEX2 0 0 0 0", "VERTEX2 1 1 0 0", "EDGE2 0 1 2 0 0 1 0 1 1 0 0"
    )
    assert main(["refine", str(path), "-o", str(tmp_path / "b.g2o"), "--quiet", "--verbose"]) == 0
    np.testing.assert_allclose(bundle.load(tmp_path / "b.g2o").poses[1], [2, 0, 0], atol=1e-12)
    said = capsys.readouterr().out
    assert "2 poses, 1 edge" in said and "on the only edge" in said
    for source in (path, str(path), bundle.load(path)):
        solved = bundle.solve(source, num_threads=1)
        assert isinstance(solved, bundle.PoseGraphResult)
        np.testing.assert_allclose(solved.problem.poses[1], [2, 0, 0])
