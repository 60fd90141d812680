"""ODM's gcp_list.txt: what is read, and what is refused with file and line."""

import math
import pickle

import pytest

from bundle import GroundControlPoint, InputError
from bundle.georeference.gcp_list import given_control_points, read_gcp_list

HEAD = "EPSG:32632"
ROWS = [
    "481367.1 5782936.4 100.25 1820.5 733.0 a.jpg north",
    "481396.0 5782940.7 99.5 2210 190.25 a.jpg south",
    "481367.1 5782936.4 100.25 12.5 14 b.jpg north",
]


def read(tmp_path, *lines, encoding="utf-8", newline="\n"):
    path = tmp_path / "gcp_list.txt"
    path.write_bytes(newline.join(lines).encode(encoding))
    return read_gcp_list(path)


def test_targets_are_lines_of_equal_coordinates(tmp_path):
    north, south = read(tmp_path, HEAD, *ROWS)
    assert (north.name, south.name) == ("north", "south")
    assert north.position == (481367.1, 5782936.4, 100.25)
    # The centre of the first pixel is (0, 0) in the file, (0.5, 0.5) here.
    assert north.measurements == (("a.jpg", 1821.0, 733.5, None), ("b.jpg", 13.0, 14.5, None))
    assert north.role == south.role == "control"
    assert north.sigma is None and north.reference_system == HEAD


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("header", [HEAD, "WGS84 UTM 32N", "+proj=utm +zone=32 +datum=WGS84"])
def test_whatever_editor_wrote_it(tmp_path, encoding, newline, header):
    lines = ["# surveyed", header + "\t", "", *ROWS, "  # end", ""]
    lines[4] = lines[4].replace(" ", "\t ")
    found = read(tmp_path, *lines, encoding=encoding, newline=newline)
    plain = read(tmp_path, header, *ROWS)
    assert found == plain


def test_labels_may_be_missing_and_extras_are_ignored(tmp_path):
    lines = [row.rsplit(" ", 1)[0] for row in ROWS]
    lines[1] += " south and what else there is"
    first, second = read(tmp_path, HEAD, *lines)
    assert (first.name, second.name) == ("target 1", "south")
    assert len(first.measurements) == 2
    lines[2] += " north"  # one line with a label names the target
    lines[2] = lines[2].replace("100.25", "1.0025e2")  # the same number
    assert [point.name for point in read(tmp_path, HEAD, *lines)] == ["north", "south"]


def test_unknown_heights(tmp_path):
    rows = [row.replace("100.25", "NaN") for row in ROWS]
    north, south = read(tmp_path, HEAD, *rows)
    assert math.isnan(north.position[2]) and len(north.measurements) == 2
    assert south.position[2] == 99.5


def test_sigmas_and_check_points(tmp_path):
    north, south = read(
        tmp_path,
        HEAD,
        ROWS[0] + " sigma=0.02/0.05 pixel_sigma=0.3",
        ROWS[1] + " check sigma=0.1",
        ROWS[2],
    )
    assert north.sigma == (0.02, 0.05) and south.sigma == (0.1, 0.1)
    assert [entry.sigma for entry in north.measurements] == [0.3, None]
    assert (north.role, south.role) == ("control", "check")
    unnamed = read(tmp_path, HEAD, ROWS[0].replace("north", "check"))[0]
    assert (unnamed.name, unnamed.role) == ("target 1", "check")


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("481367.1 5782936.4 100.25 1820.5 733.0", ["5 words"]),
        (ROWS[0].replace("733.0", "left"), ["py", "left"]),
        (ROWS[0].replace("733.0", "nan"), ["py", "nan"]),
        (ROWS[0].replace("481367.1", "nan"), ["x", "nan"]),
        (ROWS[0].replace("481367.1", "inf"), ["x", "inf"]),
        (ROWS[0].replace("5782936.4", "5782936,4"), ["y", "5782936,4"]),
        (ROWS[0] + " sigm=0.1", ["sigm", "sigma"]),
        (ROWS[0] + " sigma=-1", ["sigma", "1e-09"]),
        (ROWS[0] + " sigma=1/2/3", ["sigma", "1/2/3"]),
        (ROWS[0] + " sigma=nan", ["sigma", "nan"]),
        (ROWS[0] + " pixel_sigma=0", ["pixel_sigma", "1e-09"]),
        (ROWS[1].replace("a.jpg", "b.jpg").replace("south", "west"), ["south", "west", "line 3"]),
        (ROWS[1].replace("99.5", "99.6"), ["south", "line 3"]),
        (ROWS[1], ["a.jpg"]),
        (ROWS[1].replace("a.jpg", "b.jpg") + " sigma=0.2", ["sigma", "0.2"]),
    ],
)
def test_errors_name_file_and_line(tmp_path, line, wanted):
    with pytest.raises(InputError) as caught:
        read(tmp_path, HEAD, "# comment", ROWS[1] + " sigma=0.1", line)
    text = str(caught.value)
    assert text.startswith(f"{tmp_path}/gcp_list.txt: line 4: ") and "\n" not in text
    assert all(word in text for word in wanted), text


def test_places_that_are_none(tmp_path):
    with pytest.raises(InputError, match=r"gcp_list.txt: line 3: .*EPSG:4326"):
        read(tmp_path, "EPSG:4326", "9 47 1 2 3 a.jpg", "9 97 1 2 3 a.jpg")


@pytest.mark.parametrize("header", ["EPSG:1", "somewhere", "WGS84 UTM 99N", ROWS[0], "+proj=none"])
def test_an_unknown_system_is_refused(tmp_path, header):
    with pytest.raises(
        InputError, match=r"gcp_list.txt: line 1: coordinate reference.*x y z px py"
    ):
        read(tmp_path, header, *ROWS)


def test_no_list_at_all(tmp_path):
    with pytest.raises(InputError, match=r"gcp_list\.txt"):
        read(tmp_path, "")
    with pytest.raises(InputError, match="found 0"):
        read(tmp_path, HEAD)
    (tmp_path / "gcp_list.txt").write_bytes(b"\xff\xfe\x00\xd8junk\xff")
    with pytest.raises(InputError, match=r"gcp_list\.txt"):
        read_gcp_list(tmp_path / "gcp_list.txt")
    with pytest.raises(OSError, match=r"none\.txt"):
        read_gcp_list(tmp_path / "none.txt")


POINT = {"name": "a", "position": (1, 2, 3), "measurements": [("i.jpg", 1, 2)]}


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"name": ""}, "name"),
        ({"name": 3}, "name"),
        ({"position": (1, 2)}, "position"),
        ({"position": (1, math.nan, 3)}, "position"),
        ({"position": "here"}, "position"),
        ({"measurements": [("i.jpg", 1)]}, "measurements"),
        ({"measurements": [("i.jpg", 1, 2), ("i.jpg", 3, 4)]}, "i.jpg"),
        ({"measurements": [("i.jpg", 1, math.inf)]}, "pixel"),
        ({"measurements": [("i.jpg", 1, 2, 0)]}, "sigma"),
        ({"sigma": (1, 2, 3)}, "sigma"),
        ({"sigma": 0}, "sigma"),
        ({"role": "checks"}, "role"),
        ({"reference_system": 4326}, "reference_system"),
    ],
)
def test_control_points_from_python_are_checked(change, wanted):
    with pytest.raises(InputError, match=wanted) as caught:
        GroundControlPoint(**{**POINT, **change})
    assert "name" in change or "control point a: " in str(caught.value)


def test_control_points_pickle():
    point = GroundControlPoint(**POINT, sigma=0.1, reference_system=HEAD)
    assert pickle.loads(pickle.dumps(point)) == point
    assert point.sigma == (0.1, 0.1) and point.position == (1.0, 2.0, 3.0)


def test_names_of_images_have_blanks_between_tabs(tmp_path):
    fields = ROWS[0].split(" ")
    for name in ("my photo.jpg", "'my photo.jpg'"):
        (target,) = read(tmp_path, HEAD, "\t".join([*fields[:5], name, "north"]))
        assert (target.name, target.measurements[0].image) == ("north", "my photo.jpg")


@pytest.mark.parametrize("given", [[("a", (1, 2, 3))], [GroundControlPoint(**POINT), None], 7])
def test_other_objects_are_no_control_points(given):
    with pytest.raises(InputError, match="gcps: expected"):
        given_control_points(given, None)
