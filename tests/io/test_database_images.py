"""Keypoints and matches in COLMAP's database."""

import sqlite3
from contextlib import closing

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.io.database_images import MOST_IMAGES, database_matches

NAMES = ["a.jpg", "b.jpg", "c.jpg"]


@pytest.fixture
def database(tmp_path):
    """Three images of 20 keypoints; c comes first in the file, and a pair has few matches."""
    rng = np.random.default_rng(0)
    path = tmp_path / "database.db"
    with pycolmap.Database.open(path) as opened:
        camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500, 640, 480)
        camera_id = opened.write_camera(camera)
        ids = {}
        for name in ("c.jpg", "unused.jpg", "b.jpg", "a.jpg"):
            ids[name] = opened.write_image(pycolmap.Image(name, np.zeros((0, 2)), camera_id))
            opened.write_keypoints(ids[name], rng.uniform(0, 400, (20, 4)).astype(np.float32))
        for one, other, count in (
            ("a.jpg", "c.jpg", 17), ("b.jpg", "c.jpg", 14), ("a.jpg", "b.jpg", 15),
            ("a.jpg", "unused.jpg", 20),
        ):  # fmt: skip
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = np.stack([np.arange(count), np.arange(count)[::-1]], 1)
            opened.write_two_view_geometry(ids[one], ids[other], geometry)
    return path


def test_matches_are_those_that_pycolmap_reads(database):
    found = database_matches(database, NAMES)
    with pycolmap.Database.open(database) as opened:
        ids = [opened.read_image_with_name(name).image_id for name in NAMES]
        for key, xy in zip(ids, found.keypoints, strict=True):
            np.testing.assert_array_equal(xy, opened.read_keypoints(key)[:, :2])
        # The pair with 14 matches and the image that is not asked for are left out.
        assert sorted(sorted(pair[:2]) for pair in found.pairs) == [[0, 1], [0, 2]]
        for a, b, matches in found.pairs:
            expected = opened.read_two_view_geometry(ids[a], ids[b]).inlier_matches
            np.testing.assert_array_equal(matches, expected)


def test_reading_changes_nothing(database):
    before = database.read_bytes()
    database_matches(database, NAMES)
    assert database.read_bytes() == before
    assert [path.name for path in database.parent.iterdir()] == ["database.db"]


def test_matches_in_a_log_are_read(database):
    """Another process has added matches that are not yet in the file itself."""
    with closing(sqlite3.connect(database)) as writer:
        writer.execute("PRAGMA journal_mode = WAL")
        writer.execute("DELETE FROM two_view_geometries WHERE rows = 17")
        writer.commit()
        assert (database.parent / "database.db-wal").stat().st_size > 0
        assert len(database_matches(database, NAMES).pairs) == 1


def test_images_without_keypoints_have_none(database):
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.execute("DELETE FROM keypoints WHERE image_id = 3")
        opened.execute("DELETE FROM two_view_geometries WHERE pair_id % ? = 4", (MOST_IMAGES,))
        opened.execute("INSERT INTO two_view_geometries (pair_id, rows, cols, config, data) "
                       "SELECT 1 * 2147483647 + 4, 15, 2, 2, ?", (bytes(120),))  # fmt: skip
    found = database_matches(database, NAMES)
    assert [len(xy) for xy in found.keypoints] == [20, 0, 20]


DAMAGES = {
    "short keypoints": ("UPDATE keypoints SET data = x'00'", "keypoints"),
    "keypoints as text": ("UPDATE keypoints SET data = 'text', rows = 1, cols = 1", "keypoints"),
    "negative rows": ("UPDATE keypoints SET rows = -1", "keypoints"),
    "text rows": ("UPDATE keypoints SET rows = 'many'", "keypoints"),
    "short matches": ("UPDATE two_view_geometries SET data = x'0102'", "two_view_geometries"),
    "three columns": (
        "UPDATE two_view_geometries SET rows = 16, cols = 3, data = zeroblob(192)",
        "two_view_geometries",
    ),
    "indices beyond the keypoints": (
        "UPDATE two_view_geometries SET rows = 15, data = unhex(hex(randomblob(120)))",
        "two_view_geometries",
    ),
    "no table": ("DROP TABLE keypoints", "no such table"),
    "no images": ("DELETE FROM images", r"3 of 3 are missing"),
    "other names": ("UPDATE images SET name = 'x' || name", r"such as x\w+.jpg, found no a.jpg"),
    "no matches": ("DELETE FROM two_view_geometries", "found 0$"),
    "few matches": ("UPDATE two_view_geometries SET rows = 14", "found 0$"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_databases_are_one_line(database, damage):
    statement, expected = DAMAGES[damage]
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.create_function("unhex", 1, bytes.fromhex)
        opened.execute(statement)
    with pytest.raises(bundle.InputError, match=expected) as caught:
        database_matches(database, NAMES)
    assert str(database) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_files_are_refused(tmp_path, database):
    with pytest.raises(FileNotFoundError):
        database_matches(tmp_path / "missing.db", NAMES)
    assert not (tmp_path / "missing.db").exists()
    (tmp_path / "text.db").write_text("no database")
    with pytest.raises(bundle.InputError, match="expected COLMAP's database"):
        database_matches(tmp_path / "text.db", NAMES)
    (tmp_path / "cut.db").write_bytes(database.read_bytes()[:5000])
    with pytest.raises(bundle.InputError):
        database_matches(tmp_path / "cut.db", NAMES)
    with pytest.raises(IsADirectoryError):
        database_matches(tmp_path, NAMES)
    with pytest.raises(bundle.InputError, match="1 of 1"):
        database_matches(database, [""])
