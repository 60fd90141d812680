"""Files of poses: formats, directions, and lines that violate them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.io.pose_files import load_poses, pose_format
from tests.judging.evaluation.worked_example import REFERENCE

POSES = REFERENCE.poses


def words(*values):
    return " ".join(repr(float(value)) for value in values)


def inverse(pose):
    turn = Rotation.from_quat(pose[:4]).inv()
    return np.r_[turn.as_quat(), -turn.as_matrix() @ pose[4:]]


def kitti(pose):
    return words(*np.column_stack([Rotation.from_quat(pose[:4]).as_matrix(), pose[4:]]).ravel())


LINES = {
    "tum": [f"{k / 10} {words(*p[4:], *p[:4])}" for k, p in enumerate(POSES)],
    "euroc": [
        ",".join([str(1403636579763555584 + k), *words(*p[4:], p[3], *p[:3]).split()])
        for k, p in enumerate(POSES)
    ],
    "kitti": [kitti(p) for p in POSES],
    "poses": [
        f"{name} {words(q[3], *q[:3], *q[4:])}"
        for name, q in zip(REFERENCE.names, map(inverse, POSES), strict=True)
    ],
}


@pytest.fixture
def write(tmp_path):
    def call(lines, name="file.txt", head=("# a comment", "")):
        path = tmp_path / name
        path.write_text("\n".join([*head, *lines, ""]))
        return path

    return call


@pytest.mark.parametrize("format", LINES)
def test_every_format_is_detected_and_read(write, format):
    path = write(LINES[format])
    assert pose_format(path) == format
    for found in (load_poses(path), load_poses(path, format), bundle.load_poses(path)):
        same = np.sign(np.sum(found.poses[:, :4] * POSES[:, :4], axis=1))
        assert found.poses[:, :4] * same[:, None] == pytest.approx(POSES[:, :4], abs=1e-15)
        assert found.poses[:, 4:] == pytest.approx(POSES[:, 4:], abs=1e-15)
    assert found.names == (REFERENCE.names if format == "poses" else ("",) * 4)
    if format == "euroc":
        assert found.timestamps_ns[0] == 1403636579763555584


def test_the_other_direction(write):
    lines = [
        f"{k} {words(p[3], *p[:3], *p[4:])}" for k, p in zip(REFERENCE.names, POSES, strict=True)
    ]
    found = load_poses(write(lines), direction="world-from-camera")
    assert found.poses == pytest.approx(POSES, abs=1e-15)
    assert load_poses(write(lines)).poses[:, 4:] != pytest.approx(POSES[:, 4:])


def test_rows_in_any_order_are_sorted_by_time(write):
    found = load_poses(write(LINES["tum"][::-1]))
    assert found.timestamps_ns.tolist() == [0, 10**8, 2 * 10**8, 3 * 10**8]
    assert found.poses[:, 4:] == pytest.approx(POSES[:, 4:])


def test_names_with_blanks_commas_and_numbers(write):
    numbers = "1 0 0 0 1 2 3"
    lines = [f"my photo 1.jpg {numbers}", f"a,b.jpg {numbers}", f'"c.jpg" {numbers}']
    assert load_poses(write(lines)).names == ("my photo 1.jpg", "a,b.jpg", "c.jpg")
    commas = [line.replace(" 1 0", ",1,0").replace(" ", ", ") for line in [f"x.jpg {numbers}"]]
    assert load_poses(write(commas)).names == ("x.jpg",)
    assert load_poses(write([f"{k} {numbers}" for k in (7, 8)]), "poses").names == ("7", "8")
    assert pose_format(write([f"7 {numbers}"])) == "tum"


@pytest.mark.parametrize(
    ("format", "line", "wanted"),
    [
        ("poses", "x.jpg 1 0 0 0 1 2", r"line 7: .*found 7 words"),
        ("poses", "x.jpg 1 0 0 0 1 2 3 4", r"line 7: expected 8 columns .*found 9"),
        ("poses", "x.jpg 1 0 0 0 1 2 y", r"line 7: tz: expected a number, found 'y'"),
        ("poses", "x.jpg 0 0 0 0 1 2 3", r"line 7: .*norm 0"),
        ("poses", "x.jpg 2 0 0 0 1 2 3", r"line 7: .*norm 2"),
        ("poses", "x.jpg 1 0 0 0 1 nan 3", r"line 7: expected finite"),
        ("poses", "i1.jpg 1 0 0 0 1 2 3", r"line 7: .*'i1.jpg' again \(first in line 4\)"),
        ("tum", "0.9 1 2 3 0 0 0", r"line 7: expected 8 columns"),
        ("tum", "0.9 1 2 3 0 0 0 0", r"line 7: .*norm 0"),
        ("tum", "0.1 1 2 3 0 0 0 1", r"line 7: a second pose"),
        ("tum", "1403636579763555584 1 2 3 0 0 0 1", r"line 7: .*nanoseconds\?"),
        ("tum", "0.9 inf 2 3 0 0 0 1", r"line 7: expected finite"),
        ("euroc", "1403636579763555599,1,2,3,0,0,0", r"line 7: expected 8 columns"),
        ("euroc", "1403636579.76,1,2,3,1,0,0,0", r"line 7: timestamp: expected an integer"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 1", r"line 7: expected 12 columns"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 -1 0", r"line 7: .*determinant -1"),
        ("kitti", "1 0 0 0 0 2 0 0 0 0 1 0", r"line 7: .*determinant 2"),
        ("kitti", "1 0 0 nan 0 1 0 0 0 0 1 0", r"line 7: expected a finite"),
    ],
)
def test_a_wrong_line_is_named(write, format, line, wanted):
    for given in (None, format):
        with pytest.raises(bundle.InputError, match=wanted) as raised:
            load_poses(write([*LINES[format], line]), given)
        assert "\n" not in str(raised.value) and "file.txt" in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"# only\n", b"1 2 3\n", b"a b c\n", bytes(range(256))])
def test_other_files_are_no_poses(tmp_path, content):
    path = tmp_path / "other"
    path.write_bytes(content)
    assert pose_format(path) is None
    with pytest.raises(bundle.InputError, match="line 1: expected poses"):
        load_poses(path)
    for format in LINES:
        with pytest.raises(bundle.InputError):
            load_poses(path, format)


def test_text_of_other_systems(tmp_path):
    text = "\r\n".join(LINES["tum"])
    for name, coding in (("a", "utf-8-sig"), ("b", "utf-16")):
        (tmp_path / name).write_text(text, encoding=coding)
        assert pose_format(tmp_path / name) == "tum"
        assert len(load_poses(tmp_path / name)) == 4


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"poses": np.zeros((2, 6))}, "shape"),
        ({"poses": np.zeros((2, 7))}, "norm 0"),
        ({"poses": np.full((2, 7), np.nan)}, "finite"),
        ({"poses": np.full((2, 7), 1e200)}, "up to 1e"),
        ({"names": ("a",)}, "names: expected 4, found 1"),
        ({"names": (1, 2, 3, 4)}, "names"),
        ({"timestamps_ns": [1, 2]}, "timestamps_ns"),
    ],
)
def test_tables_check_their_arrays(changes, wanted):
    with pytest.raises(bundle.InputError, match=wanted):
        bundle.PoseTable(**{"poses": POSES, **changes})
