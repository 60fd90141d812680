"""Coordinate reference systems: every spelling that files use, axes, heights, what is refused."""

import pickle

import numpy as np
import pycolmap
import pytest

from bundle import InputError
from bundle.georeference.reference_system import ReferenceSystem

PLACES = np.array([[48.1, 9.3, 420.0], [48.2, 10.9, 380.5], [-33.9, 18.4, 55.0]])
"""Latitude, longitude, height."""


def utm(places, zone_system):
    """COLMAP's own projection, and its zone."""
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    xyz, zone = transform.ellipsoid_to_utm(places)
    assert zone == int(zone_system)
    return xyz


@pytest.mark.parametrize(
    "name",
    [
        "EPSG:32632",
        "epsg:32632",
        " EPSG: 32632 ",
        "WGS84 UTM 32N",
        "WGS84 UTM 32n",
        "WGS 84 / UTM zone 32N",
        "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs",
        "'+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs=True'",
        "+init=epsg:32632",
    ],
)
def test_spellings_of_a_utm_zone(name):
    system = ReferenceSystem(name)
    np.testing.assert_allclose(
        system.to_geodetic(utm(PLACES[:2], 32)), PLACES[:2], atol=1e-8, rtol=0
    )
    assert system.notes == ()
    assert not system.has_height


def test_southern_zones():
    system = ReferenceSystem("WGS84 UTM 34S")
    xyz = np.array([[500000.0, 6243185.0, 55.0]])
    (found,) = system.to_geodetic(xyz)
    assert found[0] == pytest.approx(-33.95, abs=0.1)
    assert found[1] == pytest.approx(21, abs=1e-9)
    np.testing.assert_allclose(found, ReferenceSystem("EPSG:32734").to_geodetic(xyz)[0], atol=1e-12)


@pytest.mark.parametrize("name", ["EPSG:4326", "+proj=longlat +datum=WGS84 +no_defs"])
def test_longitude_comes_first_whatever_the_authority_says(name):
    found = ReferenceSystem(name).to_geodetic(PLACES[:, [1, 0, 2]])
    np.testing.assert_allclose(found, PLACES, atol=1e-12, rtol=0)


def test_axes_of_an_authority_that_has_north_first():
    # Gauss-Krueger zone 3 of EPSG has northing first; files have easting first.
    (found,) = ReferenceSystem("EPSG:31467").to_geodetic([[3500000.0, 5400000.0, 10.0]])
    assert found[:2] == pytest.approx([48.73, 9.0], abs=0.02)
    assert found[2] == 10


def test_feet_and_heights_that_stay():
    system = ReferenceSystem("EPSG:2264")  # North Carolina, US survey feet
    (found,) = system.to_geodetic([[2000000.0, 600000.0, 100.0]])
    assert found[:2] == pytest.approx([35.4, -79.03], abs=0.1)
    assert found[2] == 100


def test_systems_with_heights_of_their_own():
    geocentric = ReferenceSystem("EPSG:4978")
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    found = geocentric.to_geodetic(transform.ellipsoid_to_ecef(PLACES))
    np.testing.assert_allclose(found, PLACES, atol=1e-6)
    assert ReferenceSystem("EPSG:4979").has_height
    found = ReferenceSystem("EPSG:4979").to_geodetic([[9.3, 48.1, 420.0], [9.3, 48.1, np.nan]])
    np.testing.assert_allclose(found, [PLACES[0], [48.1, 9.3, np.nan]])


@pytest.mark.parametrize(
    "name", ["+proj=utm +zone=32 +ellps=bessel +units=m", "EPSG:32632+5773", "EPSG: 32632 + 5773"]
)
def test_a_shift_that_proj_lacks_is_told(name):
    system = ReferenceSystem(name)
    (note,) = system.notes
    assert name in note
    assert "shift" in note
    found = system.to_geodetic(utm(PLACES[:2], 32))
    np.testing.assert_allclose(found, PLACES[:2], atol=0.02)
    assert not np.any(np.isnan(found))


def test_unknown_heights_stay_unknown():
    xyz = utm(PLACES[:2], 32)
    xyz[0, 2] = np.nan
    for name in ("EPSG:32632", "EPSG:4326+5773"):
        given = xyz if name == "EPSG:32632" else np.array([[9.3, 48.1, np.nan], [9.3, 48.1, 3]])
        found = ReferenceSystem(name).to_geodetic(given)
        assert np.isnan(found[:, 2]).tolist() == [True, False]
        assert found[0, :2] == pytest.approx([48.1, 9.3])


@pytest.mark.parametrize(
    "name",
    [
        "", "EPSG:", "EPSG:99999999", "EPSG:abc", "WGS84 UTM 61N", "WGS84 UTM 0N", "WGS84 UTM 32X",
        "WGS 1984", "WGS84 UTM", "+proj=nonsense", "+proj=utm +zone=99", "EPSG:5773", "32632",
        "image.jpg 1 2 3", None, 32632, "+proj=utm\x00",
    ],
)  # fmt: skip
def test_unknown_systems_are_one_line(name):
    with pytest.raises(InputError, match="coordinate reference system") as caught:
        ReferenceSystem(name)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("EPSG:4326", [9.0, 95.0, 0.0]),
        ("EPSG:4326", [500.0, 48.0, 0.0]),
        ("EPSG:4326", [np.nan, 48.0, 0.0]),
        ("EPSG:4326", [9.0, 48.0, np.inf]),
        ("EPSG:32632", [1e12, 1e12, 0.0]),
        ("EPSG:32632", [np.inf, 5e6, 0.0]),
        ("EPSG:4978", [4e6, 1e6, np.nan]),
    ],
)
def test_places_that_are_nowhere(name, row):
    good = {"EPSG:4326": [9, 48, 0], "EPSG:32632": [5e5, 5e6, 0], "EPSG:4978": [4e6, 1e6, 5e6]}
    with pytest.raises(InputError, match="position 1: expected coordinates within the area"):
        ReferenceSystem(name).to_geodetic([good[name], row])


def test_longitudes_lie_within_a_half_turn():
    found = ReferenceSystem("EPSG:4326").to_geodetic([[350, 1, 0], [-190, 1, 0], [180, 1, 0]])
    assert found[:, 1].tolist() == [-10, 170, -180]


def test_a_system_is_a_value():
    system = ReferenceSystem("EPSG:32632")
    system.to_geodetic(utm(PLACES[:2], 32))
    assert pickle.loads(pickle.dumps(system)) == system == ReferenceSystem("EPSG:32632")
