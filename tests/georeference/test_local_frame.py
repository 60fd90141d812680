"""East, north, up: against COLMAP's own, distances, and the way back."""

import pickle

import numpy as np
import pycolmap
import pytest

from bundle import InputError
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.reference_system import ReferenceSystem

ORIGIN = (48.1, 9.3, 420.0)


def places(count=50, spread=0.02):
    rng = np.random.default_rng(3)
    offsets = rng.uniform(-1, 1, (count, 3)) * [spread, spread, 300]
    return np.asarray(ORIGIN) + offsets


def test_against_colmap():
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    expected = transform.ellipsoid_to_enu(places(), *ORIGIN)
    np.testing.assert_allclose(LocalFrame(*ORIGIN).to_enu(places()), expected, atol=2e-8, rtol=0)


def test_there_and_back():
    frame = LocalFrame(*ORIGIN)
    np.testing.assert_allclose(
        frame.to_geodetic(frame.to_enu(places())), places(), atol=1e-8, rtol=1e-13
    )
    assert np.abs(frame.to_enu([ORIGIN])).max() < 1e-8


def test_distances_are_those_of_space_and_not_of_the_map():
    # One kilometre of a UTM map on its central meridian is 1000.4 m, less what the height adds.
    xyz = [[500000.0, 5400000.0, 0.0], [500000.0, 5401000.0, 0.0]]
    geodetic = ReferenceSystem("EPSG:32632").to_geodetic(xyz)
    enu = LocalFrame.about(geodetic).to_enu(geodetic)
    assert np.linalg.norm(enu[1] - enu[0]) == pytest.approx(1000 / 0.9996, abs=1e-3)
    assert abs(enu[1, 0] - enu[0, 0]) < 1e-6


def test_the_middle_stays_with_the_majority():
    there = places(7)
    wrong = np.array([[0.0, 0.0, 0.0], [-35.0, 150.0, 9e6]])
    frame = LocalFrame.about(np.vstack([there, wrong]))
    away = np.abs(np.array([frame.latitude, frame.longitude, frame.height]) - ORIGIN)
    assert np.all(away < [0.02, 0.02, 300])
    exact = LocalFrame.about(places(1))
    np.testing.assert_allclose(
        [exact.latitude, exact.longitude, exact.height], places(1)[0], rtol=1e-13
    )


@pytest.mark.parametrize("longitude", [180.0, -180.0])
def test_the_date_line_and_a_pole(longitude):
    east = np.array([[10, longitude + 1e-4, 0], [10, longitude - 1e-4, 0], [10, -longitude, 0]])
    enu = LocalFrame.about(east).to_enu(east)
    assert np.abs(enu).max() < 12
    pole = np.array([[89.9999, lon, 0.0] for lon in (0, 90, 180, 270)])
    assert np.abs(LocalFrame.about(pole).to_enu(pole)).max() < 12


def test_unknown_heights():
    geodetic = places(3)
    geodetic[1, 2] = np.nan
    frame = LocalFrame.about(geodetic)
    assert frame.height == pytest.approx(geodetic[[0, 2], 2].mean())
    enu = frame.to_enu(geodetic)
    assert np.isnan(enu[:, 2]).tolist() == [False, True, False]
    level = frame.to_enu(np.where(np.isnan(geodetic), frame.height, geodetic))
    np.testing.assert_array_equal(enu[:, :2], level[:, :2])
    geodetic[:, 2] = np.nan
    assert LocalFrame.about(geodetic).height == 0


@pytest.mark.parametrize(
    ("origin", "field"),
    [
        ((91, 0, 0), "latitude"),
        ((0, 400, 0), "longitude"),
        ((0, 0, np.nan), "height"),
        (("48", 0, 0), "latitude"),
    ],
)
def test_bad_origins(origin, field):
    with pytest.raises(InputError, match=f"origin: {field}: expected"):
        LocalFrame(*origin)
    with pytest.raises(InputError, match="at least one position"):
        LocalFrame.about(np.zeros((0, 3)))


def test_a_frame_is_a_value():
    frame = LocalFrame(*ORIGIN)
    frame.to_enu(places(2))
    assert pickle.loads(pickle.dumps(frame)) == frame
    assert LocalFrame(**frame.asdict()) == frame
    # The operation on record is the one that is used, for any program with PROJ.
    import pyproj

    found = pyproj.Transformer.from_pipeline(frame.pipeline).transform(9.31, 48.11, 400.0)
    np.testing.assert_array_equal(found, frame.to_enu([[48.11, 9.31, 400.0]])[0])
