"""g2o files: what is read, what is written, and what is refused."""

import bz2
import gzip

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.graphs import write
from tests.scenes import make_problem

UPPER = "1 0 0 1 0 1"
PLANE = ["VERTEX_SE2 0 0 0 0", "VERTEX_SE2 5 1 0 0.5", f"EDGE_SE2 0 5 1 0 0.4 {UPPER}"]
QUAT = "VERTEX_SE3:QUAT"


def same(one, other, *, names=("poses", "ids", "edges", "measurements", "information", "fixed")):
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_the_plane(tmp_path):
    path = write(
        tmp_path / "a.g2o",
        "# a comment",
        "",
        "VERTEX_SE2 7 1 -2 6.5",
        "VERTEX_SE2 3 +0.5 0.25 0",
        "FIX 3",
        "EDGE_SE2 7 3 1 2 3  11 12 13 22 23 33",
    )
    graph = bundle.load(path)
    assert isinstance(graph, bundle.PoseGraph) and graph.dimension == 2
    assert graph.ids.tolist() == [7, 3] and graph.fixed.tolist() == [False, True]
    assert graph.poses.tolist() == [[1, -2, 6.5], [0.5, 0.25, 0]]
    assert graph.edges.tolist() == [[0, 1]] and graph.measurements.tolist() == [[1, 2, 3]]
    assert graph.information.tolist() == [[[11, 12, 13], [12, 22, 23], [13, 23, 33]]]
    assert graph.edge_lines.tolist() == [6] and graph.is_closure.tolist() == [False]
    assert not graph.poses.flags.writeable


def test_space_has_the_translation_first_in_the_file_and_the_rotation_first_here(tmp_path):
    upper = [10 * (r + 1) + c + 1 for r in range(6) for c in range(r, 6)]
    path = write(
        tmp_path / "a.g2o",
        "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1",
        f"{QUAT} 0 0 0 0 0 0 0 1",
        f"{QUAT} 1 1 2 3 0.1 0.2 0.3 0.4",
        f"EDGE_SE3:QUAT 0 1 4 5 6 0.5 0.6 0.7 -0.8 {' '.join(map(str, upper))}",
    )
    graph = bundle.load(path)
    assert graph.poses[1].tolist() == [0.1, 0.2, 0.3, 0.4, 1, 2, 3]
    assert graph.measurements[0].tolist() == [0.5, 0.6, 0.7, -0.8, 4, 5, 6]
    first = [[44, 45, 46, 14, 24, 34], [45, 55, 56, 15, 25, 35], [46, 56, 66, 16, 26, 36]]
    second = [[14, 15, 16, 11, 12, 13], [24, 25, 26, 12, 22, 23], [34, 35, 36, 13, 23, 33]]
    assert graph.information[0].tolist() == first + second


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", ["a.g2o", "a.g2o.gz", "a.g2o.bz2"])
def test_what_is_written_reads_back_bit_by_bit(tmp_path, dimension, name):
    graph = graphs.loop(dimension, seed=4)
    graph = graph.replace(ids=np.arange(graph.num_poses) * 3 + 100, fixed=np.arange(12) == 4)
    assert bundle.save(graph, tmp_path / name) == ()
    same(bundle.load(tmp_path / name), graph)
    start = (tmp_path / name).read_bytes()[:3]
    magic = {"a.g2o": b"VER", "a.g2o.gz": b"\x1f\x8b\x08", "a.g2o.bz2": b"BZh"}
    assert start == magic[name]


def test_compression_is_told_from_the_content(tmp_path):
    text = "\n".join(PLANE).encode()  # and no end of the last line
    for k, content in enumerate((text, gzip.compress(text), bz2.compress(text))):
        path = tmp_path / f"plain{k}"
        path.write_bytes(content)
        assert bundle.load(path).ids.tolist() == [0, 5]


def test_lines_longer_than_a_block_of_the_file(tmp_path):
    path = write(tmp_path / "a.g2o", *PLANE[:2], f"EDGE_SE2 0 5 1 0 0.4 {' ' * 3_000_000}{UPPER}")
    assert bundle.load(path).edge_lines.tolist() == [3]


def test_many_lines_go_through_the_buffer(tmp_path):
    vertices = [f"VERTEX_SE2 {k} {k / 7!r} {-k / 3!r} 0.125" for k in range(60_000)]
    graph = bundle.load(write(tmp_path / "a.g2o", *vertices, f"EDGE_SE2 0 59999 1 0 0 {UPPER}"))
    assert graph.poses[:, 0].tolist() == [k / 7 for k in range(60_000)]
    assert graph.edges.tolist() == [[0, 59999]] and graph.edge_lines.tolist() == [60_001]


def test_a_file_without_vertices_starts_with_its_odometry(tmp_path):
    path = write(
        tmp_path / "a.g2o",
        f"EDGE_SE2 2 4 9 9 9 {UPPER}",
        f"EDGE_SE2 2 3 1 0 {np.pi / 2!r} {UPPER}",
        f"EDGE_SE2 4 3 -1 0 0 {UPPER}",
    )
    graph = bundle.load(path)
    assert graph.ids.tolist() == [2, 3, 4] and not graph.has_poses
    np.testing.assert_allclose(graph.poses, [[0, 0, 0], [1, 0, np.pi / 2], [1, 1, np.pi / 2]])
    broken = write(tmp_path / "b.g2o", f"EDGE_SE2 2 4 1 0 0.5 {UPPER}")
    np.testing.assert_allclose(bundle.load(broken).poses, [[0, 0, 0], [1, 0, 0.5]])


BAD = {
    "unknown vertex": ([*PLANE, f"EDGE_SE2 0 6 1 0 0 {UPPER}"], 4, "vertex 6"),
    "fixed unknown": ([*PLANE, "FIX 9"], 4, "vertex 9"),
    "duplicate": ([*PLANE, "VERTEX_SE2 0 1 1 1"], 4, "vertex 0 of line 1"),
    "self edge": ([*PLANE, f"EDGE_SE2 5 5 1 0 0 {UPPER}"], 4, "itself"),
    "too few": (["VERTEX_SE2 0 0 0"], 1, "the end of the line"),
    "too many": (["VERTEX_SE2 0 0 0 0 1"], 1, "'1'"),
    "few information": ([*PLANE[:2], "EDGE_SE2 0 5 1 0 0 1 0 0 1 0"], 3, "row 3, column 3"),
    "more information": ([*PLANE[:2], f"EDGE_SE2 0 5 1 0 0 {UPPER} 7"], 3, "'7'"),
    "nan": (["VERTEX_SE2 0 nan 0 0"], 1, "'nan'"),
    "infinite": ([*PLANE[:2], "EDGE_SE2 0 5 1 0 0 inf 0 0 1 0 1"], 3, "'inf'"),
    "no number": (["VERTEX_SE2 0 1,5 0 0"], 1, "'1,5'"),
    "half an id": (["VERTEX_SE2 0.5 0 0 0"], 1, "'0.5'"),
    "negative id": (["VERTEX_SE2 -1 0 0 0"], 1, "'-1'"),
    "huge id": (["VERTEX_SE2 99999999999999999999 0 0 0"], 1, "'99999999999999999999'"),
    "zero quaternion": ([f"{QUAT} 0 1 2 3 0 0 0 0"], 1, "norm 0"),
    "mixed": ([*PLANE, f"{QUAT} 9 0 0 0 0 0 0 1"], 4, f"'{QUAT}'"),
    "landmark": ([*PLANE, "VERTEX_XY 9 0 0"], 4, "'VERTEX_XY'"),
    "fix nothing": ([*PLANE, "FIX"], 4, "the end of the line"),
    "only a comment": (["# FIX nothing"], 1, "the end of the file"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_their_line(tmp_path, name):
    lines, line, found = BAD[name]
    path = write(tmp_path / "bad.g2o", *lines)
    with pytest.raises(bundle.InputError) as caught:
        bundle.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: expected ") and found in message
    assert "\n" not in message


def test_files_that_are_empty_cut_or_not_there(tmp_path):
    with pytest.raises(bundle.InputError, match=r"empty\.g2o:1: expected vertices and edges"):
        bundle.load(write(tmp_path / "empty.g2o", ""))
    (tmp_path / "cut.g2o").write_bytes(bz2.compress("\n".join(PLANE).encode())[:-9])
    with pytest.raises(bundle.InputError, match="bzip2 data at byte"):
        bundle.load(tmp_path / "cut.g2o")
    with pytest.raises(OSError, match="none"):
        bundle.load(tmp_path / "none.g2o")


def test_a_reconstruction_is_asked_for_and_a_graph_is_found(tmp_path):
    path = write(tmp_path / "graph.txt", *PLANE)
    with pytest.raises(bundle.InputError, match="expected a reconstruction, found a pose graph"):
        bundle.describe(str(path))
    with pytest.raises(bundle.InputError, match=r"^format: expected none for a pose graph"):
        bundle.save(bundle.load(path), tmp_path / "x.g2o", "bal")
    assert not (tmp_path / "x.g2o").exists()


@pytest.mark.parametrize("name", ["tinyGrid3D", "intel", "CSAIL", "MIT"])
def test_real_files_keep_their_numbers(bundle_data, tmp_path, name):
    source = bundle_data / "g2o" / f"{name}.g2o.bz2"
    graph = bundle.load(source)
    bundle.save(graph, tmp_path / "again.g2o")
    same(bundle.load(tmp_path / "again.g2o"), graph)

    def numbers(text):
        rows = [line.split() for line in text.splitlines()]
        return [(row[0], *map(float, row[1:])) for row in rows if row]

    given = numbers(bz2.decompress(source.read_bytes()).decode())
    again = numbers((tmp_path / "again.g2o").read_text())
    if not graph.has_poses:
        again = [row for row in again if row[0].startswith("EDGE")]
    assert again == given


def test_a_folder_with_the_name_of_a_graph_is_a_model(tmp_path):
    problem = make_problem()
    bundle.save(problem, tmp_path / "model.g2o", "colmap")
    assert bundle.load(tmp_path / "model.g2o").num_images == problem.num_images
