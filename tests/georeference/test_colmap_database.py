"""Positions of COLMAP's database, written by pycolmap, and of the older table."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

import bundle
from bundle.georeference.gps_positions import read_database_gps
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.survey_priors import given_gps
from tests.georeference import blocks

pycolmap = pytest.importorskip("pycolmap")
ORIGIN = LocalFrame(46.8425, -91.9942, 198.5)


def database(path, made, system="WGS84"):
    """A database with a prior for each image but the last."""
    geodetic = ORIGIN.to_geodetic(made.cameras)
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_RADIAL", width=2000, height=1500, params=blocks.PARAMS
    )
    found = pycolmap.Database.open(path)
    found.write_camera(camera, use_camera_id=True)
    for name, place in zip(made.problem.image_names, geodetic, strict=True):
        number = found.write_image(pycolmap.Image(name=name, camera_id=1))
        prior = pycolmap.PosePrior()
        prior.position = place if name != made.problem.image_names[-1] else np.full(3, np.nan)
        prior.position_covariance = np.diag([0.04, 0.04, 0.25])
        prior.coordinate_system = getattr(pycolmap.PosePriorCoordinateSystem, system)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1)
        prior.corr_data_id = pycolmap.data_t(sensor, number)
        found.write_pose_prior(prior)
    found.close()


def test_positions_of_pycolmap(tmp_path) -> None:
    made = blocks.block(num_targets=4, seed=5)
    path = tmp_path / "database.db"
    database(path, made)
    found = read_database_gps(path)
    assert found.names == made.problem.image_names[:-1]
    np.testing.assert_allclose(ORIGIN.to_enu(found.geodetic), made.cameras[:-1], atol=1e-6)
    np.testing.assert_allclose(found.accuracy, [[0.2, 0.5]] * len(found))
    assert found.notes == ("1 pose prior without a position.",)
    aligned = bundle.align(made.problem, gps=path)
    assert aligned.similarity.scale == pytest.approx(blocks.TRUTH.scale, rel=1e-6)


def test_the_older_table(tmp_path) -> None:
    path = tmp_path / "old.db"
    with closing(sqlite3.connect(path)) as old, old:
        old.execute("CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT)")
        old.execute(
            "CREATE TABLE pose_priors (image_id INTEGER PRIMARY KEY, position BLOB, "
            "coordinate_system INTEGER, position_covariance BLOB)"
        )
        old.execute("INSERT INTO images VALUES (7, 'a.jpg')")
        row = np.array([46.8, -91.9, 200.0]).tobytes()
        old.execute("INSERT INTO pose_priors VALUES (7, ?, 0, NULL)", (row,))
    found = read_database_gps(path)
    assert found.names == ("a.jpg",) and np.isnan(found.accuracy).all()
    assert found.geodetic.tolist() == [[46.8, -91.9, 200.0]]


def test_cartesian_positions(tmp_path) -> None:
    made = blocks.block(num_targets=4, seed=5)
    path = tmp_path / "database.db"
    database(path, made, "CARTESIAN")
    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute(
            "UPDATE pose_priors SET position = ? WHERE pose_prior_id = 1", (np.zeros(3).tobytes(),)
        )
    found = read_database_gps(path)
    assert found.reference_system is None
    assert found.geodetic[0].tolist() == [0, 0, 0]  # a place like any other
    assert given_gps(path, None, made.problem).names == made.problem.image_names[:-1]


def test_bad_databases(tmp_path) -> None:
    made = blocks.block(num_targets=4, seed=5)
    path = tmp_path / "database.db"
    database(path, made, "CARTESIAN")

    def refused(match: str) -> None:
        with pytest.raises(bundle.InputError, match=match) as caught:
            bundle.align(made.problem, gps=path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)

    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute("UPDATE pose_priors SET coordinate_system = 0 WHERE pose_prior_id = 2")
    refused("expected Cartesian coordinates, found WGS84")
    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute("UPDATE pose_priors SET coordinate_system = -1")
    refused("expected WGS84 or Cartesian coordinates, found undefined")
    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute("UPDATE pose_priors SET position = x'00'")
    refused("position: expected 24 bytes, found 1 bytes")
    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute("DELETE FROM pose_priors")
    refused("expected positions in pose_priors, found 0")
    with closing(sqlite3.connect(path)) as changed, changed:
        changed.execute("DROP TABLE pose_priors")
    refused("expected COLMAP's table pose_priors")
    path.write_bytes(path.read_bytes()[:3000])
    refused("expected COLMAP's database, found")
