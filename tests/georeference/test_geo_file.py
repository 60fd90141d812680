"""geo.txt and tables in every form that programs and editors give them, and bad lines."""

import numpy as np
import pytest

from bundle import InputError, align
from bundle.georeference.gps_positions import GpsPositions, read_geo_file, with_fix
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.survey_priors import gps_priors
from tests.georeference.flights import flight

FILE = """EPSG:4326
# a comment
a.jpg 9.30 48.10 420.5
b.jpg 9.31 48.11

c.jpg 9.32 48.12 nan 1 2 3
  d.jpg 9.33 48.13 421 1 2 3 0.02 0.05
sub/e.jpg 9.34 48.14 422 nan nan nan 0.03 nan and more words
"""
GEODETIC = [
    [48.10, 9.30, 420.5],
    [48.11, 9.31, np.nan],
    [48.12, 9.32, np.nan],
    [48.13, 9.33, 421],
    [48.14, 9.34, 422],
]
ACCURACY = [[np.nan] * 2] * 3 + [[0.02, 0.05], [0.03, np.nan]]


def variants():
    text = FILE.encode()
    yield "plain", text
    yield "byte order mark", b"\xef\xbb\xbf" + text
    yield "two of them", b"\xef\xbb\xbf\xef\xbb\xbf" + text
    yield "CRLF", text.replace(b"\n", b"\r\n")
    yield "tabs", text.replace(b" 48", b"\t48").replace(b".jpg ", b".jpg\t\t")
    yield "UTF-16", FILE.encode("utf-16")
    yield "no newline at the end", text.rstrip()
    yield "comments and blanks first", b"\n  # written by hand\n\n" + text
    yield "trailing blanks", text.replace(b"\n", b"  \t\n")


@pytest.mark.parametrize(("name", "content"), list(variants()), ids=[n for n, _ in variants()])
def test_one_file_in_many_forms(tmp_path, name, content):
    path = tmp_path / "geo.txt"
    path.write_bytes(content)
    found = read_geo_file(path)
    assert found.names == ("a.jpg", "b.jpg", "c.jpg", "d.jpg", "sub/e.jpg"), name
    np.testing.assert_allclose(found.geodetic, GEODETIC, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.accuracy, ACCURACY)
    assert found.reference_system == "EPSG:4326"
    assert found.source == str(path)
    assert found.notes == ()
    assert "5 images" in repr(found)


def test_projected_coordinates(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text("WGS84 UTM 32N\na.jpg 500000 5400000 7\n")
    found = read_geo_file(path)
    assert found.geodetic[0].tolist() == pytest.approx([48.7530130, 9.0, 7.0], abs=1e-7)
    path.write_text("'+proj=utm +zone=32 +datum=WGS84'\na.jpg 500000 5400000 7\n")
    np.testing.assert_allclose(read_geo_file(path).geodetic, found.geodetic, atol=1e-12)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_numbers_that_belong_to_nothing_are_told(tmp_path, count):
    # Accuracies right after the height are a common mistake; they come after three angles.
    numbers = " 0.02" * count if count < 5 else " 1 2 3 0.02"
    path = tmp_path / "geo.txt"
    path.write_text(f"EPSG:4326\na.jpg 9 48 420{numbers}\n")
    found = read_geo_file(path)
    assert np.isnan(found.accuracy).all()
    assert len(found.notes) == (count != 3)
    assert all("ignored" in note for note in found.notes)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["a line with the coordinate reference system, found 0"]),
        (b"\n# only a comment\n", ["a line with the coordinate reference system"]),
        (b"EPSG:4326\n", ["expected images after the first line"]),
        (b"a.jpg 9 48 420\n", ["line 1", "coordinate reference system", "a.jpg"]),
        (b"# c\nEPSG:77777777\na.jpg 9 48\n", ["line 2", "EPSG:77777777"]),
        (b"EPSG:4326\na.jpg 9\n", ["line 2", "image x y", "a.jpg 9"]),
        (b"EPSG:4326\nmy photo.jpg 9 48 420\n", ["line 2", "x: expected a number", "photo.jpg"]),
        (b"EPSG:4326\n\na.jpg nan 48 420\n", ["line 3", "x: expected a number", "nan"]),
        (b"EPSG:4326\na.jpg 9 48 inf\n", ["line 2", "z: expected a number or nan", "inf"]),
        (b"EPSG:4326\na.jpg 9 48 420m\n", ["line 2", "z:", "420m"]),
        (b"EPSG:4326\na.jpg 9 48 420 n e s\n", ["line 2", "yaw:", "'n'"]),
        (b"EPSG:4326\na.jpg 9 48 1 0 0 0 0 1\n", ["line 2", "horizontal accuracy", "found 0"]),
        (b"EPSG:4326\na.jpg 9 48 1 0 0 0 1 -1\n", ["line 2", "vertical accuracy", "found -1"]),
        (b"EPSG:4326\na.jpg 9 48\nb.jpg 9 48\na.jpg 9 49\n", ["line 4", "'a.jpg' again", "line 2"]),
        (b"EPSG:4326\na.jpg 9 48\n# c\nb.jpg 48 99\n", ["line 4", "within the area", "48 99"]),
        (b"EPSG:4326\na.jpg 9,3 48,1 420\n", ["line 2", "x: expected a number", "9,3"]),
        (b"\xff\xd8\xff\xe0\x00\x10JFIF", ["expected text in UTF-8"]),
        (b"\xff\xfeE", ["expected text in UTF-8"]),
        (b"EPSG:4326\na.jpg 9 48 4\x0020\n", ["line 2", "z:"]),
    ],
)
def test_bad_files_are_one_line(tmp_path, content, words):
    path = tmp_path / "geo.txt"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_geo_file(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable()
    assert all(word in message for word in words), message


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        read_geo_file(tmp_path / "geo.txt")
    with pytest.raises(OSError, match="directory"):
        read_geo_file(tmp_path)


def test_zero_and_zero_is_no_fix(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:4326\na.jpg 9 48 1\nb.jpg 0 0 0\nc.jpg 0.0 -0 nan\nd.jpg 0 48 3\n")
    found = read_geo_file(path)
    assert found.names == ("a.jpg", "d.jpg")
    assert found.geodetic.tolist() == [[48, 9, 1], [48, 0, 3]]
    assert len(found.accuracy) == 2
    assert [note for note in found.notes if "b.jpg, c.jpg" in note]
    # Of a map it is a place where the area of the map has it, and none where it has not.
    path.write_text("EPSG:32632\na.jpg 500000 5400000 7\nb.jpg 0 0 0\n")
    assert read_geo_file(path).names == ("a.jpg",)
    path.write_text("+proj=tmerc +lat_0=48 +lon_0=9 +datum=WGS84\na.jpg 50 40 7\nb.jpg 0 0 0\n")
    assert read_geo_file(path).names == ("a.jpg", "b.jpg")


def test_positions_given_at_zero_and_zero_do_not_count():
    problem = flight([]).problem
    places = LocalFrame(46.8, -91.9, 200).to_geodetic(problem.projection_centers)
    places[3] = [0, 0, 12]
    unknown = np.full((16, 2), np.nan)
    given = GpsPositions(problem.image_names, places, unknown, "EPSG:4326", "x")
    known = gps_priors(problem, given)
    assert len(known.priors) == 15
    assert any("0 0" in note for note in known.notes)
    aligned = align(problem, gps=given)
    assert len(aligned.positions) == 15
    assert aligned.similarity.scale == pytest.approx(1, abs=1e-3)


def test_a_zero_alone_is_a_place():
    places = np.array([[48.0, 0, 1], [0, 9, 1], [0, 0, 1]])
    given = GpsPositions(tuple("abc"), places, np.ones((3, 2)), "EPSG:4326", "x")
    assert with_fix(given).names == ("a", "b")
    assert with_fix(with_fix(given)).notes == with_fix(given).notes


def test_names_with_blanks(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text(
        'WGS84\n"my photo 1.jpg" 9 48 1\n\'b c.jpg\' 9\t48 2\n"d.jpg" 9 48\n'
        'my photo 2.jpg\t9.5\t48.5\t3\n "e f.jpg"\t9\t48\t4\no\'neill.jpg 9 48 5\ng.jpg 9\t48\t6\n'
    )
    found = read_geo_file(path)
    assert found.names == (
        "my photo 1.jpg", "b c.jpg", "d.jpg", "my photo 2.jpg", "e f.jpg", "o'neill.jpg", "g.jpg",
    )  # fmt: skip
    np.testing.assert_array_equal(found.geodetic[:, 2], [1, 2, np.nan, 3, 4, 5, 6])
    path.write_text("EPSG:4326\nmy photo.jpg 9 48 420\n")
    with pytest.raises(InputError, match="in quotes"):
        read_geo_file(path)


@pytest.mark.parametrize("header", ["WGS84", "WGS 84", "wgs84", "'WGS84'"])
def test_wgs84_alone_is_longitude_and_latitude(tmp_path, header):
    path = tmp_path / "geo.txt"
    path.write_text(f"{header}\na.jpg 9 48 1\n")
    assert read_geo_file(path).geodetic.tolist() == [[48, 9, 1]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("EPSG:4326\na 46.84 -91.99 9\nb 46.85 -91.98 9\n", ["line 2", "columns 1 and 2 fit when"]),
        ("EPSG:32633\na -91.99 46.84 9\nb -91.98 46.85 9\n", ["line 2", "degrees", "EPSG:4326"]),
        ("EPSG:32632\na 5400000 500000 9\nb 5400050 500000 9\n", ["columns 1 and 2 fit when"]),
        ("EPSG:32736\na 706784 411645 9\nb 706777 411650 9\n", ["EPSG:32636", "northern"]),
        ("EPSG:32636\na 706784 9588355 9\nb 706777 9588350 9\n", ["EPSG:32736", "southern"]),
        ("WGS84 UTM 36S\na 706784 411645 9\nb 706777 411650 9\n", ["EPSG:32636"]),
        ("+proj=utm +zone=36 +south +datum=WGS84\na 706784 411645 9\n", ["EPSG:32636"]),
        (
            "EPSG:2193\na -2500000 5400000 9\n",
            ["line 2", "area of EPSG:2193", "166.37 to 178.63 E"],
        ),
    ],
)
def test_coordinates_out_of_the_area_of_their_system(tmp_path, content, words):
    path = tmp_path / "geo.txt"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_geo_file(path)
    assert all(word in str(caught.value) for word in words), caught.value


def test_coordinates_that_an_authority_means_so_are_noted(tmp_path):
    path = tmp_path / "geo.txt"
    # Norway has one zone for all of it; 8 degrees of longitude are seven beyond its edge.
    path.write_text("EPSG:25833\na.jpg -98750 6750000 9\nb.jpg -98700 6750000 9\n")
    found = read_geo_file(path)
    assert found.geodetic[0, 1] < 6
    assert any("2 positions of 2 outside" in note for note in found.notes)
    # Half a degree beyond the edge of a zone is nothing to tell of; one slip among many is a note.
    path.write_text("EPSG:32632\na.jpg 760000 5400000 9\nb.jpg 760010 5400000 9\n")
    assert read_geo_file(path).notes == ()
    path.write_text(
        "EPSG:32632\na.jpg 500000 5400000 9\nb.jpg 500010 5400000 9\nc.jpg 2500000 5400000 9\n"
    )
    assert any("1 position of 3" in note for note in read_geo_file(path).notes)
    # Some lines in the zone of the other hemisphere are slips; most of them are a wrong header.
    north, south = ("{} 706784 411645 9\n", "{} 706784 9588355 9\n")
    path.write_text("EPSG:32636\n" + "".join((north * 3 + south * 2).format(*"abcde")))
    assert any("2 positions of 5" in note for note in read_geo_file(path).notes)
    path.write_text("EPSG:32636\n" + "".join((north * 2 + south * 3).format(*"abcde")))
    with pytest.raises(InputError, match=r"line 4: .* they fit EPSG:32736"):
        read_geo_file(path)


POSITIONS = [[48.1, 9.3, 420.5], [48.11, 9.31, np.nan]]
WKT = """# CoordinateSystem: PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["World Geodetic
 System 1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG",
"6326"]],AUTHORITY["EPSG","4326"]],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AUTHORITY["EPSG",
"32632"]]""".replace("\n", "")
TABLES = {
    "Metashape": "# CoordinateSystem: LOCAL_CS\n#Label,X/Longitude,Y/Latitude,Z/Altitude\n"
    "a.jpg,9.3,48.1,420.5\nb.jpg,9.31,48.11,\nc.jpg,,,\n",
    "Pix4D": "#imagename,latitude [decimal degrees],longitude [decimal degrees],altitude [meter]\n"
    "a.jpg,48.1,9.3,420.5\nb.jpg,48.11,9.31,nan\n",
    "exiftool": "SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n"
    "a.jpg,48.1,9.3,420.5\nb.jpg,48.11,9.31,\n",
    "decimal commas": "LATITUDE; Longitude; Image; Height (m)\n48,1;9,3;a.jpg;420,5\n\n"
    "48,11;9,31;b.jpg;\n",
    "tabs": "filename\tlat\tlon\talt (m)\r\n"
    "a.jpg\t48.1\t9.3\t420.5\r\n# c\r\nb.jpg\t48.11\t9.31\tNaN\r\n",
    "quotes": 'image,longitude,latitude,altitude\n"a.jpg",9.3,48.1,"420.5"\n"b.jpg",9.31,48.11,\n',
    "byte order mark": "\ufeffimage,yaw,longitude,latitude,altitude\n"
    "a.jpg,,9.3,48.1,420.5\nb.jpg,7,9.31,48.11,\n",
    "spreadsheet": "name,lon,lat,elevation,,\na.jpg,9.3,48.1,420.5,,\n,,,,,\nb.jpg,9.31,48.11,,,\n",
    "index of pandas": ",image,lat,lon,alt\n0,a.jpg,48.1,9.3,420.5\n1,b.jpg,48.11,9.31,\n",
}


@pytest.mark.parametrize(("south", "west"), [("South", "West"), ("S", "W"), ("s", "w")])
def test_hemispheres_of_unsigned_degrees(tmp_path, south, west):
    path = tmp_path / "positions.csv"
    rows = f"""SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef
a.jpg,33.4,{south},70.6,{west}
b.jpg,-33.4,{south},-70.6,{west}
c.jpg,33.4,North,70.6,E
d.jpg,,{south},,{west}
e.jpg,33.4,{south},70.6,East
f.jpg,33.4,N,70.6,{west}
"""
    path.write_text(rows)
    found = read_geo_file(path)
    assert found.names == ("a.jpg", "b.jpg", "c.jpg", "e.jpg", "f.jpg") and found.notes == ()
    signs = np.array([[-1, -1], [-1, -1], [1, 1], [-1, 1], [1, -1]])
    np.testing.assert_array_equal(found.geodetic[:, :2], signs * [33.4, 70.6])


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_tables_with_named_columns(tmp_path, text):
    path = tmp_path / "positions.csv"
    path.write_bytes(text.encode())
    found = read_geo_file(path)
    assert found.names == ("a.jpg", "b.jpg")
    np.testing.assert_allclose(found.geodetic, POSITIONS, rtol=0, atol=1e-12)
    assert np.isnan(found.accuracy).all()
    assert (found.reference_system, found.notes) == ("EPSG:4326", ())


@pytest.mark.parametrize(
    ("titles", "values", "accuracy", "unused"),
    [
        ("horizontal accuracy (m),Vertical Accuracy [m]", "0.02,0.05", [0.02, 0.05], ""),
        ("Accuracy_X/Y/Z_(m),Accuracy_Yaw/Pitch/Roll_(deg)", "0.1,3", [0.1, 0.1], "_Yaw"),
        ("sigma", "0.3", [0.3, 0.3], ""),
        ("h-acc,v-acc", "0.02,", [0.02, np.nan], ""),
        ("sigma_h,sigma_v,Z_est,altitude", "0.02,0.04,7,8", [0.02, 0.04], "Z_est"),
        ("quality", "5", [np.nan, np.nan], "quality"),
    ],
)
def test_accuracies_and_unused_columns_of_a_table(tmp_path, titles, values, accuracy, unused):
    path = tmp_path / "positions.csv"
    path.write_text(f'image,latitude,longitude,{titles}\n"a b, c.jpg",48,9,{values}\n')
    found = read_geo_file(path)
    assert found.names == ("a b, c.jpg",)
    np.testing.assert_array_equal(found.accuracy, [accuracy])
    assert len(found.notes) == bool(unused)
    assert all(unused in note and "v-acc" not in note for note in found.notes)


FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937  # of the definitions of 1959 and 1893


@pytest.mark.parametrize(
    ("titles", "metres"),
    [
        ("Altitude (ft),Accuracy [cm]", [FOOT, 0.01, 0.01]),
        ("alt_ft,h-acc (mm)", [FOOT, 0.001, np.nan]),
        ("Height [US survey feet],v-acc", [SURVEY_FOOT, np.nan, 1]),
        ("elevation ftUS,sigma", [SURVEY_FOOT, 1, 1]),
        ("altitude_m,accuracy (m)", [1, 1, 1]),
        ("height (foot MSL),h-acc_m", [FOOT, 1, np.nan]),
    ],
)
def test_units_of_titles(tmp_path, titles, metres):
    path = tmp_path / "positions.csv"
    path.write_text(f"image,latitude (deg),lon_deg,{titles}\na.jpg,48,9,650,2\n")
    found = read_geo_file(path)
    assert found.geodetic[0].tolist() == pytest.approx([48, 9, 650 * metres[0]], rel=1e-15)
    np.testing.assert_allclose(found.accuracy[0], 2 * np.array(metres[1:]), rtol=1e-15)
    changed = [title for title, one in zip(titles.split(","), metres, strict=False) if one != 1]
    changed = [title for title in changed if "v-acc" not in title]
    assert [*found.notes] == [
        f"Columns of {path} that are converted from the units of titles: {', '.join(changed)}."
    ] * bool(changed)


def test_units_of_titles_and_of_a_map(tmp_path):
    path = tmp_path / "positions.csv"

    def read(system, titles, *values):
        path.write_text(f"{system}\nimage,{titles}\na.jpg,{','.join(map(str, values))}\n")
        return read_geo_file(path)

    feet = "Easting (ft),Northing (ft),z (ft)"
    there = read("EPSG:32615", "easting,northing,z", 500_000, 5_400_000, 30).geodetic
    same = read("EPSG:32615", feet, 500_000 / FOOT, 5_400_000 / FOOT, 30 / FOOT).geodetic
    np.testing.assert_allclose(same, there, rtol=1e-14)
    local = read("LOCAL", feet, 1, 2, 3).geodetic
    np.testing.assert_allclose(local, FOOT * np.array([[1, 2, 3]]), rtol=1e-15)
    # A map in feet counts its own, whichever the title means; metres become feet.
    there = read("EPSG:2263", "east,north,z", 980_000, 190_000, 30).geodetic
    np.testing.assert_array_equal(
        read("EPSG:2263", "X (ft),Y (ft),z", 980_000, 190_000, 30).geodetic, there
    )
    in_metres = [980_000 * SURVEY_FOOT, 190_000 * SURVEY_FOOT, 30]
    found = read("EPSG:2263", "X (m),Y (m),z", *in_metres)
    np.testing.assert_allclose(found.geodetic, there, rtol=1e-14)
    assert any("the units of titles: X (m), Y (m)." in note for note in found.notes)
    # The third axis of a system has a unit of its own.
    there = read("EPSG:32615+5703", "x,y,z", 500_000, 5_400_000, 30)
    same = read("EPSG:32615+5703", "x,y,z (ft)", 500_000, 5_400_000, 30 / FOOT)
    np.testing.assert_allclose(same.geodetic, there.geodetic, rtol=1e-14)


def test_the_ellipsoidal_height_of_two(tmp_path):
    path = tmp_path / "positions.csv"
    path.write_text("image,lat,lon,altitude,Ellipsoidal height [m]\na.jpg,48,9,420,467\n")
    found = read_geo_file(path)
    assert found.geodetic.tolist() == [[48, 9, 467]]
    assert len(found.notes) == 1 and "altitude" in found.notes[0]


@pytest.mark.parametrize(
    "head",
    [
        "EPSG:32632\nimage,easting,northing,z\n",
        "EPSG:32632\n#Label,X/Easting,Y/Northing,Z/Altitude\n",
        f"{WKT}\n#Label,X/Easting,Y/Northing,Z/Altitude\n",
        f"{WKT}\nLabel,X,Y,Z\n",
    ],
)
def test_tables_of_map_coordinates(tmp_path, head):
    path = tmp_path / "positions.csv"
    path.write_text(head + "a.jpg,500000,5400000,7\n")
    found = read_geo_file(path)
    assert found.geodetic[0].tolist() == pytest.approx([48.7530130, 9.0, 7.0], abs=1e-7)
    assert found.reference_system == "EPSG:32632"
    path.write_text("LOCAL\nimage,x,y,z\na.jpg,1,2,3\n")
    assert read_geo_file(path).geodetic.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "comment", ["# image\tx\ty\tz", "# image, x, y, z", "# image x y z yaw pitch roll"]
)
def test_comments_of_geo_txt_are_not_titles(tmp_path, comment):
    path = tmp_path / "geo.txt"
    for text in (f"EPSG:4326\n{comment}\na.jpg 9 48 1\n", f"{comment}\nEPSG:4326\na.jpg 9 48\n"):
        path.write_text(text)
        assert read_geo_file(path).names == ("a.jpg",)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("image,longitude,latitude\na.jpg,9\n", ["line 2", "3 fields", "found 2"]),
        ("image,longitude,latitude\na.jpg,9,3,48,1\n", ["line 2", "3 fields", "found 5"]),
        ("image,longitude,latitude\n\na.jpg,9,48\na.jpg,9,48\n", ["line 4", "'a.jpg' again"]),
        ("image,longitude,latitude\na.jpg,,48\n", ["line 2", "longitude: expected a number"]),
        ("image,latitude,longitude\na.jpg,9,148\nb.jpg,148,9\n", ["line 3", "area of EPSG:4326"]),
        ("image,Lat,Lon\na.jpg,48°06'00\"N,9\n", ["line 2", "Lat: expected a number", "48°06"]),
        ("image,lat,lon,h-acc\na.jpg,48,9,0\n", ["line 2", "h-acc", "above 0", "found 0"]),
        ("image;lat;lon;z\na.jpg;48;9;1.234,5\n", ["line 2", "z: expected a number or nan"]),
        ("image,longitude,latitude\n", ["expected images"]),
        ("EPSG:4326\nimage,longitude,altitude\na.jpg,9,48\n", ["line 2", "columns", "altitude"]),
        ("latitude,longitude\n48,9\n", ["line 1", "columns image", "longitude"]),
        ("image,x,y\na.jpg,9,48\n", ["line 1", "reference system", "x, y"]),
        ("Survey 3\nimage,lat,lon\na.jpg,9,48\n", ["reference system", "Survey 3"]),
        (f"image,lat,lon\n{'x' * 200_000},9,48\n", ["line 2", "3 fields"]),
    ],
)
def test_bad_tables_are_one_line(tmp_path, content, words):
    path = tmp_path / "positions.csv"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_geo_file(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and message.isprintable() and len(message) < 400
    assert all(word in message for word in words), message
