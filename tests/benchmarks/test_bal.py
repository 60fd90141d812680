from __future__ import annotations

import bz2
import dataclasses
import gzip

import cv2
import numpy as np
import pycolmap
import pytest
from benchmarks.runners import pycolmap_

from benchmarks import bal, colmap


def test_write_and_read_are_inverse(scene, tmp_path):
    path = tmp_path / "problem.txt"
    bal.write(scene, path)
    back = bal.read(path)
    for field in dataclasses.fields(bal.Bal):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(scene, field.name))


@pytest.mark.parametrize(("suffix", "compress"), [(".bz2", bz2.compress), (".gz", gzip.compress)])
def test_compressed_files_read_the_same(scene, tmp_path, suffix, compress):
    plain, packed = tmp_path / "problem.txt", tmp_path / f"problem.txt{suffix}"
    bal.write(scene, plain)
    packed.write_bytes(compress(plain.read_bytes()))
    np.testing.assert_array_equal(bal.read(packed).points, bal.read(plain).points)


def test_residuals_are_those_of_opencv(scene):
    errors = bal.residuals(scene)
    for index, camera in enumerate(scene.cameras):
        mine = scene.camera_index == index
        turned = np.diag(bal.FLIP_FRAME) @ cv2.Rodrigues(camera[:3])[0]
        focal, k1, k2 = camera[6:]
        pixels, _ = cv2.projectPoints(
            scene.points[scene.point_index[mine]],
            cv2.Rodrigues(turned)[0],
            bal.FLIP_FRAME * camera[3:6],
            np.diag([focal, focal, 1.0]),
            np.array([k1, k2, 0.0, 0.0]),
        )
        expected = bal.FLIP_IMAGE * pixels[:, 0] - scene.xy[mine]
        np.testing.assert_allclose(errors[mine], expected, atol=1e-9)


def test_an_observation_behind_the_camera_counts_as_zero(scene):
    points = scene.points.copy()
    points[3] = [0.0, 0.0, 1000.0]
    errors = bal.residuals(dataclasses.replace(scene, points=points))
    behind = scene.point_index == 3
    assert np.all(errors[behind] == 0.0)
    np.testing.assert_array_equal(errors[~behind], bal.residuals(scene)[~behind])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7])
def test_rotation_vectors_invert_rotation_matrices(angle):
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(20, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    matrices = bal.rotation_matrices(vectors)
    np.testing.assert_allclose(matrices, [cv2.Rodrigues(v)[0] for v in vectors], atol=1e-14)
    np.testing.assert_allclose(bal.rotation_vectors(matrices), vectors, atol=1e-12)


def test_the_pycolmap_model_has_the_same_cost_and_leads_back(scene):
    reconstruction = pycolmap_.to_reconstruction(scene)
    assert colmap.cost(reconstruction) == pytest.approx(bal.cost(scene), rel=1e-12)
    back = pycolmap_.to_bal(reconstruction, scene)
    np.testing.assert_allclose(back.cameras, scene.cameras, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(back.points, scene.points)


def test_a_quaternion_that_is_not_quite_of_unit_length_costs_the_same(scene):
    reconstruction = pycolmap_.to_reconstruction(scene)
    exact = colmap.cost(reconstruction)
    for image_id in reconstruction.reg_image_ids():
        frame = reconstruction.frames[image_id]
        pose = frame.rig_from_world
        stretched = pycolmap.Rotation3d(1.001 * pose.rotation.quat)
        frame.rig_from_world = pycolmap.Rigid3d(stretched, pose.translation)
    assert np.linalg.norm(reconstruction.images[1].cam_from_world().rotation.quat) > 1.0005
    assert colmap.cost(reconstruction) == pytest.approx(exact, rel=1e-10)
