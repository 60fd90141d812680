"""GPS positions in EXIF tags, written by Pillow, read by ours."""

import math
import sys
from datetime import datetime

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from bundle import InputError
from bundle.georeference.exif_gps import capture_times, read_exif_gps

HERE = {1: "N", 2: (48.0, 30.0, 36.0), 3: "W", 4: (9.0, 15.0, 18.0), 5: b"\0", 6: 420.25}
"""The tags of GPS by number: latitude, longitude and altitude with their references."""


def photo(path, tags):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("RGB", (8, 6))
    exif = Image.Exif()
    exif[271] = "Maker"
    if tags is not None:
        exif[0x8825] = dict(tags)
    image.save(path, exif=exif.tobytes())


@pytest.mark.parametrize("suffix", ["jpg", "JPG", "png", "webp", "tif"])
def test_formats(tmp_path, suffix):
    photo(tmp_path / f"a.{suffix}", HERE)
    found = read_exif_gps(tmp_path, [f"a.{suffix}"])
    assert found.names == (f"a.{suffix}",)
    np.testing.assert_allclose(found.geodetic, [[48.51, -9.255, 420.25]], rtol=0, atol=1e-9)
    assert np.isnan(found.accuracy).all()
    assert found.notes == ()


def test_heic(tmp_path, monkeypatch) -> None:
    """iPhones write HEIC; Pillow needs a package for it."""
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    image, exif = Image.new("RGB", (64, 48)), Image.Exif()
    exif[0x8825] = HERE
    image.save(tmp_path / "a.HEIC", format="HEIF", exif=exif.tobytes())
    found = read_exif_gps(tmp_path, ["a.HEIC"])
    np.testing.assert_allclose(found.geodetic, [[48.51, -9.255, 420.25]], rtol=0, atol=1e-9)
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(InputError, match=r"a.HEIC: expected the package bundle-adjust\[heic\]"):
        read_exif_gps(tmp_path, ["a.HEIC"])


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({1: "S"}, (-48.51, -9.255, 420.25, math.nan)),
        ({3: "E"}, (48.51, 9.255, 420.25, math.nan)),
        ({5: b"\1"}, (48.51, -9.255, -420.25, math.nan)),
        ({5: None}, (48.51, -9.255, 420.25, math.nan)),
        ({6: None}, (48.51, -9.255, math.nan, math.nan)),
        ({6: IFDRational(1, 0)}, (48.51, -9.255, math.nan, math.nan)),
        ({31: 4.5}, (48.51, -9.255, 420.25, 4.5)),
        ({31: 0.0}, (48.51, -9.255, 420.25, math.nan)),
        ({2: (48.51, 0.0, 0.0)}, (48.51, -9.255, 420.25, math.nan)),
        ({2: (0.0, 0.0, 0.0)}, (0.0, -9.255, 420.25, math.nan)),
        ({2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0)}, None),
        ({1: None}, None),
        ({1: "X"}, None),
        ({2: None}, None),
        ({2: (48.0, 30.0)}, None),
        ({2: (IFDRational(48, 0), 0.0, 0.0)}, None),
        ({2: (91.0, 0.0, 0.0)}, None),
        ({4: (181.0, 0.0, 0.0)}, None),
    ],
)
def test_tags(tmp_path, changes, expected):
    tags = {tag: value for tag, value in (HERE | changes).items() if value is not None}
    photo(tmp_path / "a.jpg", tags)
    photo(tmp_path / "other.jpg", HERE)
    found = read_exif_gps(tmp_path, ["a.jpg", "other.jpg"])
    if expected is None:
        assert found.names == ("other.jpg",)
        (note,) = found.notes
        assert "1 image without a GPS position" in note
        assert "a.jpg" in note
        return
    (*geodetic, accuracy) = expected
    np.testing.assert_allclose(found.geodetic[0], geodetic, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.accuracy[0], [accuracy, math.nan])


def test_folders_broken_files_and_missing_ones(tmp_path, caplog, capfd):
    photo(tmp_path / "left" / "a.jpg", HERE)
    photo(tmp_path / "b.jpg", HERE | {6: 500.0})
    photo(tmp_path / "plain.jpg", None)
    (tmp_path / "empty.jpg").touch()
    (tmp_path / "noise.jpg").write_bytes(np.random.default_rng(0).bytes(5000))
    whole = (tmp_path / "b.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[:60])
    names = ["left/a.jpg", "right/b.jpg", "plain.jpg", "empty.jpg", "noise.jpg", "cut.jpg", "none"]
    found = read_exif_gps(tmp_path, names)
    assert found.names == ("left/a.jpg", "right/b.jpg")  # the second without its folder
    assert found.geodetic[1, 2] == 500
    missing, silent = found.notes
    assert "1 image not in" in missing
    assert "none" in missing
    assert "4 images without" in silent
    assert "plain.jpg, empty.jpg, noise.jpg and 1 more" in silent
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


def test_one_file_is_not_the_photograph_of_two_images(tmp_path):
    photo(tmp_path / "a.jpg", HERE)
    photo(tmp_path / "left" / "b.jpg", HERE)
    found = read_exif_gps(tmp_path, ["left/a.jpg", "right/a.jpg", "left/b.jpg"])
    assert found.names == ("left/b.jpg",)
    assert "2 images not in" in found.notes[0]


def test_cut_anywhere(tmp_path):
    """Truncated and damaged tags give a position or none, never an exception."""
    photo(tmp_path / "whole.jpg", HERE)
    content = (tmp_path / "whole.jpg").read_bytes()
    rng = np.random.default_rng(5)
    names = []
    for index in range(150):
        damaged = bytearray(content[: rng.integers(1, len(content))] if index % 2 else content)
        for place in rng.integers(0, min(len(damaged), 250), 3):
            damaged[place] = rng.integers(256)
        names.append(f"{index}.jpg")
        (tmp_path / names[-1]).write_bytes(damaged)
    found = read_exif_gps(tmp_path, names)
    assert np.isfinite(found.geodetic[:, :2]).all()
    assert 0 < len(found) < 150


def test_images_beyond_pillows_limit(tmp_path, monkeypatch):
    photo(tmp_path / "a.jpg", HERE)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    assert len(read_exif_gps(tmp_path, ["a.jpg"])) == 1
    assert Image.MAX_IMAGE_PIXELS == 10


def test_no_folder_and_no_images(tmp_path):
    with pytest.raises(InputError, match="expected the folder of the images; it does not exist"):
        read_exif_gps(tmp_path / "nowhere", ["a.jpg"])
    with pytest.raises(InputError, match=r"expected the images .* such as 'a.jpg', found 0"):
        read_exif_gps(tmp_path, ["a.jpg", "b.jpg"])
    with pytest.raises(InputError, match="which have no names"):
        read_exif_gps(tmp_path, ["", ""])


def test_times_of_capture(tmp_path):
    taken = {
        "b.jpg": "2021:05:02 09:00:30 +02:00",  # some cameras add their zone
        "a.jpg": "2021:05:01 10:03:00",
        "c.jpg": "0000:00:00 00:00:00",  # a clock that was never set
        "d.jpg": "",
        "e.jpg": None,
    }
    for name, time in taken.items():
        exif = Image.Exif()
        exif[271] = "Maker"
        if time is not None:
            exif[0x8769] = {0x9003: time}
        Image.new("RGB", (8, 6)).save(tmp_path / name, exif=exif.tobytes())
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    names = [*taken, "broken.jpg", "elsewhere.jpg"]
    first, last = datetime(2021, 5, 1, 10, 3), datetime(2021, 5, 2, 9, 0, 30)
    assert capture_times(tmp_path, names) == (first, last)
    assert capture_times(tmp_path, ["b.jpg"]) == (last, last)
    assert capture_times(tmp_path, names[2:]) is None
    assert capture_times(tmp_path / "no folder", names) is None
    assert capture_times(tmp_path, [""]) is None
