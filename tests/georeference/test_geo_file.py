"""OpenDroneMap's geo.txt in every form that editors give it, and bad lines."""

import numpy as np
import pytest

from bundle import InputError
from bundle.georeference import read_geo_file

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
        (b"", ["a line with the coordinate reference system, found none"]),
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
