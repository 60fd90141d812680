"""Tables of surveyed points and of marks: the same control points as the list of the same marks."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.georeference.gcp_list import given_control_points, read_gcp_list
from tests.georeference.blocks import block

POINTS = {"north": (481367.1, 5782936.4, 100.25), "7": (481396.0, 5782940.7, 99.5)}
MARKS = [
    ("a b.JPG", "north", 1820.5, 733.0),
    ("c.JPG", "7", 2210.0, 190.25),
    ("c.JPG", "north", 12.5, 14.0),
]


def listed(tmp_path, points=POINTS, marks=MARKS, system="EPSG:32632", extra=""):
    """Control points of the list with the same marks; in a list the first pixel's centre is 0."""
    path = tmp_path / "gcp_list.txt"
    lines = [
        " ".join(
            [*map(repr, points[name]), repr(x - 0.5), repr(y - 0.5), f'"{image}"', name, extra]
        )
        for image, name, x, y in marks
    ]
    path.write_text("\n".join([system, *lines]))
    return {point.name: point for point in read_gcp_list(path)}


def tables(tmp_path, points, marks):
    """Control points of tables by name, with notes."""
    for name, lines in (("points.csv", points), ("marks.csv", marks)):
        (tmp_path / name).write_text("\n".join(lines))
    found, notes = given_control_points(f"{tmp_path}/points.csv,{tmp_path}/marks.csv", None)
    return {point.name: point for point in found}, notes


def point_lines(separator=",", comma=".", head="label,easting,northing,height"):
    rows = [[name, *map(repr, place)] for name, place in POINTS.items()]
    rows = [[name, *(word.replace(".", comma) for word in words)] for name, *words in rows]
    return ["EPSG:32632", head.replace(",", separator), *map(separator.join, rows)]


def mark_lines(order=(0, 1, 2, 3), separator=",", comma=".", head=None):
    rows = [[image, name, *(repr(x).replace(".", comma) for x in xy)] for image, name, *xy in MARKS]
    lines = [separator.join(row[column] for column in order) for row in rows]
    return lines if head is None else [head.replace(",", separator), *lines]


def unordered(points):
    return {
        name: dataclasses.replace(point, measurements=tuple(sorted(point.measurements)))
        for name, point in points.items()
    }


@pytest.mark.parametrize(
    ("order", "head"),
    [
        ((0, 1, 2, 3), "Image,Point,px,py"),
        ((1, 0, 2, 3), "marker,camera,x,y"),
        ((3, 2, 1, 0), "Pixel Y,Pixel X (px),GCP label,image name"),
        ((0, 1, 2, 3), "image_name,gcp_name,image_u,image_v"),
        ((0, 1, 2, 3), None),
        ((1, 0, 2, 3), None),
        ((0, 2, 3, 1), None),
    ],
)
def test_marks_in_any_order_of_columns(tmp_path, order, head):
    found, notes = tables(tmp_path, point_lines(), mark_lines(order, head=head))
    assert found == listed(tmp_path)
    assert notes == ()


@pytest.mark.parametrize(("separator", "comma"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
@pytest.mark.parametrize("seed", range(3))
def test_separators_decimal_commas_and_the_order_of_lines(tmp_path, separator, comma, seed):
    rng = np.random.default_rng(seed)
    points = point_lines(separator, comma)
    head, *marks = mark_lines(separator=separator, comma=comma, head="image,point,px,py")
    points[2:] = rng.permutation(points[2:])
    found, _ = tables(tmp_path, points, [head, "", *rng.permutation(marks)])
    assert unordered(found) == unordered(listed(tmp_path))


def test_german_titles(tmp_path):
    points = point_lines(";", ",", "Punktnummer,Rechtswert,Hochwert,Höhe")
    assert tables(tmp_path, points, mark_lines())[0] == listed(tmp_path)


def test_accuracies_are_sigmas(tmp_path):
    points = point_lines(head="label,easting,northing,height,h acc,v acc")
    points[2:] = [line + ",0.02,0.05" for line in points[2:]]
    found, _ = tables(tmp_path, points, mark_lines())
    assert found == listed(tmp_path, extra="sigma=0.02/0.05")
    points[1] = "label,easting,northing,height,accuracy,error"
    found, notes = tables(tmp_path, points, mark_lines())
    assert found == listed(tmp_path, extra="sigma=0.02")
    assert [note for note in notes if "without a use: error" in note]


XML = """<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0"><chunk label="flight">
<cameras><camera id="4" label="a b"/><group><camera id="9" label="c.JPG"/></group></cameras>
<markers><marker id="0" label="tie"/>
<marker id="3" label="north"><reference x="481367.1" y="5782936.4" z="100.25" {north}/></marker>
<group><marker id="1" label="7"><reference x="481396.0" y="5782940.7" z="99.5" {seven}/></marker>
</group></markers>
<frames><frame id="0"><markers>
<marker marker_id="0"><location camera_id="4" pinned="true" x="1" y="2"/></marker>
<marker marker_id="3"><location camera_id="4" pinned="true" x="1820.5" y="733"/>
<location camera_id="9" pinned="false" x="12.5" y="14"/>
<location camera_id="7" pinned="false" valid="false"/></marker>
<marker marker_id="1"><location camera_id="9" valid="1" x="2210" y="190.25"/></marker>
</markers></frame></frames>
<reference>{system}</reference></chunk></document>"""
UTM = 'PROJCS["UTM 32N",AUTHORITY["EPSG","32632"]]'


def markers(tmp_path, north="", seven="", system=UTM, change=("", "")):
    """Control points of Metashape's XML by name; its cameras have labels with or without suffix."""
    text = XML.format(north=north, seven=seven, system=system)
    (tmp_path / "markers.xml").write_text(text.replace(*change))
    found, notes = given_control_points(tmp_path / "markers.xml", None)
    assert notes == ()
    return {point.name: point for point in found}


def test_metashapes_markers_are_those_of_the_list(tmp_path):
    marks = [(image.replace(" b.JPG", " b"), *rest) for image, *rest in MARKS]
    found = markers(tmp_path)
    assert unordered(found) == unordered(listed(tmp_path, marks=marks))
    assert markers(tmp_path, system=f"\n{UTM}\n") == found
    sigmas = markers(tmp_path, 'sxyz="0.02"', 'sxy="0.02" sz="0.05" enabled="false"')
    assert sigmas["north"].sigma == (0.02, 0.02) and sigmas["7"].sigma == (0.02, 0.05)
    assert (sigmas["north"].role, sigmas["7"].role) == ("control", "check")
    for word, role in (("true", "control"), ("1", "control"), ("0", "check")):
        assert markers(tmp_path, f'enabled="{word}"')["north"].role == role
    lost = markers(tmp_path, change=('label="a b"', 'label=""'))
    assert [mark.image for mark in lost["north"].measurements] == ["camera 4", "c.JPG"]
    flat = markers(tmp_path, change=('z="100.25"', ""), system='LOCAL_CS["Local (m)"]')
    assert np.isnan(flat["north"].position[2]) and flat["7"].reference_system is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("</chunk>", ""), "markers.xml: expected XML, found mismatched tag"),
        (("reference x=", "reference u="), "expected markers with coordinates"),
        (("chunk", "project"), "expected markers with coordinates"),
        (('x="481367.1"', 'x="east"'), "marker north: x: expected a number or nan, found 'east'"),
        (('label="7"', 'label="north"'), "marker north: expected one marker of each label"),
        (('x="12.5"', 'x=""'), "marker north: px: expected a number, found ''"),
        (
            ('camera_id="9" pinned', 'camera_id="4" pinned'),
            "expected one mark of a point per image",
        ),
        ((',AUTHORITY["EPSG","32632"]', ""), "reference: coordinate reference system: expected"),
    ],
)
def test_wrong_markers_are_one_line(tmp_path, change, expected):
    with pytest.raises(InputError) as caught:
        markers(tmp_path, change=change)
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_degrees_of_wgs84_and_metashapes_comment(tmp_path):
    points = {"north": (9.1, 52.2, 100.25), "7": (9.2, 52.1, 99.5)}
    rows = [f"{name},{y},{x},{z}" for name, (x, y, z) in points.items()]
    found, _ = tables(tmp_path, ["name,lat,lon,alt", *rows], mark_lines())
    assert found == listed(tmp_path, points, system="EPSG:4326")
    comment = '# CoordinateSystem: PROJCS["UTM 32N",AUTHORITY["EPSG","32632"]]'
    lines = [comment, "#Label,X/Easting,Y/Northing,Z/Altitude", *point_lines()[2:], "# Total,,,"]
    assert tables(tmp_path, lines, mark_lines())[0] == listed(tmp_path)


def test_feet_of_titles_are_converted_with_a_note(tmp_path):
    lines = point_lines(head="label,easting (ft),northing (ft),height (ft)")
    feet = [[name, *(repr(value / 0.3048) for value in place)] for name, place in POINTS.items()]
    found, notes = tables(tmp_path, [*lines[:2], *map(",".join, feet)], mark_lines())
    for name, place in POINTS.items():
        np.testing.assert_allclose(found[name].position, place, rtol=1e-15)
    assert "converted from the units" in notes[0]
    # A system in feet keeps its unit without one in titles, as in the list.
    places = dict.fromkeys(POINTS, (3100000.5, 10000000.25, 3.0))
    places["7"] = (3100100.5, 10000000.25, 4.0)
    rows = [",".join([name, *map(repr, place)]) for name, place in places.items()]
    found, notes = tables(tmp_path, ["EPSG:2277", "label,x,y,z", *rows], mark_lines())
    assert found == listed(tmp_path, places, system="EPSG:2277") and notes == ()


def test_unknown_heights_and_a_local_frame(tmp_path):
    points = point_lines()
    points[0], points[2] = "LOCAL", points[2].replace("100.25", "")
    found, _ = tables(tmp_path, points, mark_lines())
    assert np.isnan(found["north"].position[2]) and found["7"].reference_system is None


def test_points_without_marks_are_left_out_with_a_note(tmp_path):
    found, notes = tables(tmp_path, [*point_lines(), "west,481300,5782900,100"], mark_lines())
    assert found == listed(tmp_path)
    assert notes == (f"1 point of {tmp_path}/points.csv without marks: west.",)


@pytest.mark.parametrize(
    ("file", "line", "text", "wanted"),
    [
        ("marks.csv", 2, "c.JPG,norht,1,2", ["points.csv has no point 'norht'", "mean north?"]),
        ("marks.csv", 2, "c.JPG,west,1,2", ["has no point 'west'", "north, 7"]),
        ("marks.csv", 3, "c.JPG,7,1,2", ["second one of '7' in 'c.JPG'"]),
        ("marks.csv", 2, "d.JPG,north,left,2", ["px", "left"]),
        ("marks.csv", 2, "d.JPG,north,1,nan", ["py", "nan"]),
        ("marks.csv", 2, "d.JPG,north,1", ["image, point, px, py", "3 words"]),
        ("points.csv", 4, "north,481300,5782900,100", ["one line for each label", "line 3"]),
        ("points.csv", 3, "west,481300,,100", ["northing", "nan"]),
        ("points.csv", 3, "west,481300", ["4 fields", "found 2"]),
        ("points.csv", 3, "north,1e9,1e9,3", ["area of EPSG:32632"]),
        ("points.csv", 2, "label,a,b,c", ["columns label, longitude and", "label, a, b"]),
        ("points.csv", 1, "EPSG:1", ["EPSG:1"]),
    ],
)
def test_errors_name_file_and_line(tmp_path, file, line, text, wanted):
    lines = {"points.csv": point_lines(), "marks.csv": mark_lines()}
    lines[file][line - 1] = text
    with pytest.raises(InputError) as caught:
        tables(tmp_path, lines["points.csv"], lines["marks.csv"])
    message = str(caught.value)
    line = 2 if line == 1 else line  # the place of a system is that of the titles
    assert message.startswith(f"{tmp_path}/{file}: line {line}: ") and "\n" not in message
    assert all(word in message for word in wanted), message


def test_a_point_needs_a_name(tmp_path):
    with pytest.raises(InputError, match=r"points.csv: line 5: name: expected text"):
        tables(tmp_path, [*point_lines(), ",481300,5782900,100"], mark_lines())


def test_titles_of_marks_are_listed_if_one_is_missing(tmp_path):
    with pytest.raises(
        InputError, match=r"marks.csv: line 1: .*image, point, px, py, found photo, a"
    ):
        tables(tmp_path, point_lines(), mark_lines(head="photo,a,x,y"))


def test_coordinates_without_a_system(tmp_path):
    with pytest.raises(
        InputError, match=r"points.csv: line 1: .*below a line with their reference"
    ):
        tables(tmp_path, point_lines()[1:], mark_lines())


def test_a_table_alone_needs_the_other_one(tmp_path):
    for lines in (point_lines(), point_lines()[1:], mark_lines(head="image,point,px,py")):
        (tmp_path / "points.csv").write_text("\n".join(lines))
        with pytest.raises(InputError, match="give both: POINTS,MARKS"):
            read_gcp_list(tmp_path / "points.csv")


def test_alignment_is_that_of_the_list(tmp_path):
    flight = block(survey_noise=0.01, pixel_noise=0.2)
    points = {one.name: tuple(float(v) for v in one.position) for one in flight.gcps}
    marks = [  # sixty-fourths, so that half a pixel is exact
        (m.image, one.name, round(m.x * 64) / 64, round(m.y * 64) / 64)
        for one in flight.gcps
        for m in one.measurements
    ]
    listed(tmp_path, points, marks, "LOCAL")
    rows = [",".join([name, *map(repr, place)]) for name, place in points.items()]
    lines = [",".join(map(str, mark)) for mark in marks]
    tables(tmp_path, ["LOCAL", "label,x,y,z", *rows, "far,900,900,0"], lines)
    one = bundle.align(flight.problem, gcps=tmp_path / "gcp_list.txt")
    two = bundle.align(flight.problem, gcps=f"{tmp_path}/points.csv,{tmp_path}/marks.csv")
    assert np.array_equal(one.problem.cam_from_world, two.problem.cam_from_world)
    assert one.control_points == two.control_points
    assert [note for note in two.notes if note not in one.notes] == [
        f"1 point of {tmp_path}/points.csv without marks: far."
    ]
