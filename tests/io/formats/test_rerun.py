"""Recordings for rerun's viewer, read again by rerun's own reader."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.cli.main import main
from tests.io.formats.foreign_files import small
from tests.io.formats.test_write import colored


def entities(path) -> dict[str, dict[str, np.ndarray]]:
    """The components of each entity, as numbers."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if ":" in name or name in ("error", "num_views"):
                found.setdefault(chunk.entity_path, {})[name] = column[0].as_py()
    return found


def project(entity, points):
    turn = Rotation.from_quat(entity["Transform3D:quaternion"][0]).inv()
    inside = turn.apply(points - entity["Transform3D:translation"][0])
    matrix = np.reshape(entity["Pinhole:image_from_camera"][0], (3, 3)).T  # columns
    pixels = inside @ matrix.T
    return pixels[:, :2] / pixels[:, 2:]


def test_points_poses_lenses_and_observations(tmp_path) -> None:
    pytest.importorskip("rerun")
    problem = colored(small("SIMPLE_PINHOLE"), tmp_path / "sparse")
    names = ("a b/c.jpg", "b/ü.png", "c", "d.jpg")
    problem = problem.replace(image_names=names)
    lost = bundle.save(problem, tmp_path / "scene.rrd")
    assert len(lost) == 1 and "Distortion" not in lost[0]
    found = entities(tmp_path / "scene.rrd")
    points = found["/world/points"]
    xyz = np.array(points["Points3D:positions"])
    np.testing.assert_allclose(xyz, problem.points, rtol=1e-6, atol=1e-6)
    packed = problem.point_ids % 256 << 24 | 3 * problem.point_ids % 256 << 16 | 7 << 8 | 255
    assert points["Points3D:colors"] == packed.tolist()
    assert points["num_views"] == [3] * 30
    assert np.isclose(np.mean(points["error"]), bundle.reprojection_errors(problem)[0].mean())
    errors = []
    for image, entity in enumerate(("a\\ b\\/c.jpg", "b\\/ü.png", "c", "d.jpg")):
        mine = problem.observation_image == image
        camera = found[f"/world/images/{entity}"]
        assert camera["Pinhole:resolution"] == [[800, 600]]
        seen = np.array(found[f"/world/images/{entity}/keypoints"]["Points2D:positions"])
        np.testing.assert_allclose(seen, problem.observation_xy[mine], rtol=1e-6)
        errors += [*np.hypot(*(project(camera, xyz[problem.observation_point[mine]]) - seen).T)]
    order = np.argsort(problem.observation_image, kind="stable")
    np.testing.assert_allclose(errors, bundle.reprojection_errors(problem)[0][order], atol=1e-3)


def test_lenses_that_are_no_pinhole(tmp_path) -> None:
    pytest.importorskip("rerun")
    assert "RADIAL" in bundle.save(small(), tmp_path / "a.rrd")[0]
    sphere = small("EQUIRECTANGULAR", camera_params=np.tile([800.0, 400], (4, 1)))
    bundle.save(sphere, tmp_path / "b.rrd")
    found = entities(tmp_path / "b.rrd")
    assert "/world/points" in found and "Points3D:colors" not in found["/world/points"]
    assert not [name for name in found if name.endswith("keypoints")]
    assert not [name for name in found.values() if "Pinhole:resolution" in name]


def test_rerun_is_an_extra(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    bundle.save(small(), tmp_path / "in", "colmap")
    code = main(["convert", str(tmp_path / "in"), str(tmp_path / "a.rrd"), "--quiet"])
    error = capsys.readouterr().err
    assert code == 2 and "pip install bundle-adjust[rerun]" in error
    assert not (tmp_path / "a.rrd").exists()
