"""Small COLMAP models for the tests, and what it means that two reconstructions are the same."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from bundle import InputError, Problem
from bundle.io import colmap

REAL_MODELS = (
    "vr_opencv",
    "batmo_rigs",
    "maupertuis",
    "lund_door",
    "video48",
    "crane_mast",
    "bartoszek",
)
ARRAYS = (
    "cam_from_world",
    "image_ids",
    "image_camera",
    "camera_ids",
    "camera_params",
    "camera_sizes",
    "points",
    "point_ids",
    "observation_image",
    "observation_point",
    "observation_xy",
)


def synthesize(
    seed: int, *, num_cameras_per_rig: int = 1, model: str = "SIMPLE_RADIAL", num_points: int = 40
) -> pycolmap.Reconstruction:
    """Two rigs of five frames each, with colours, names with folders and errors that are not 0."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = 2
    options.num_frames_per_rig = 5
    options.num_cameras_per_rig = num_cameras_per_rig
    options.num_points3D = num_points
    options.track_length = 6
    options.num_points2D_without_point3D = 3
    camera = pycolmap.Camera.create_from_model_name(1, model, 900.0, 1024, 768)
    options.camera_model_id = camera.model
    options.camera_params = camera.params.tolist()
    pycolmap.set_random_seed(seed)
    reconstruction = pycolmap.synthesize_dataset(options)
    rng = np.random.default_rng(seed)
    for _, point in sorted(reconstruction.points3D.items()):
        point.xyz = point.xyz + rng.normal(0, 0.01, 3)
        point.color = rng.integers(0, 256, 3, dtype=np.uint8)
    for image_id, image in sorted(reconstruction.images.items()):
        image.name = f"folder/{image_id:03d}.jpg"
    reconstruction.update_point_3d_errors()
    return reconstruction


def write_model(reconstruction: pycolmap.Reconstruction, folder: Path, *, binary: bool) -> Path:
    folder.mkdir(parents=True)
    if binary:
        reconstruction.write_binary(folder)
    else:
        reconstruction.write_text(folder)
    return folder


def pose_of(rigid: pycolmap.Rigid3d) -> list[float]:
    return [*rigid.rotation.quat.tolist(), *rigid.translation.tolist()]


def fields(reconstruction: pycolmap.Reconstruction) -> dict[str, object]:
    """Return every field but the errors as plain Python values, to be compared with ==."""
    return {
        "cameras": {
            camera_id: (camera.model.name, camera.width, camera.height, camera.params.tolist())
            for camera_id, camera in reconstruction.cameras.items()
        },
        "rigs": {
            rig_id: (
                str(rig.ref_sensor_id) if rig.num_sensors() else None,
                {str(s): p and pose_of(p) for s, p in rig.non_ref_sensors.items()},
            )
            for rig_id, rig in reconstruction.rigs.items()
        },
        "frames": {
            frame_id: (
                frame.rig_id,
                pose_of(frame.rig_from_world) if frame.has_pose() else None,
                [str(datum) for datum in frame.data_ids],
            )
            for frame_id, frame in reconstruction.frames.items()
        },
        "images": {
            image_id: (
                image.name,
                image.camera_id,
                image.frame_id,
                pose_of(image.cam_from_world()) if image.has_pose else None,
                [(p.x(), p.y(), p.point3D_id) for p in image.points2D],
            )
            for image_id, image in reconstruction.images.items()
        },
        "points": {
            point_id: (
                point.xyz.tolist(),
                point.color.tolist(),
                [(element.image_id, element.point2D_idx) for element in point.track.elements],
            )
            for point_id, point in reconstruction.points3D.items()
        },
    }


def errors_of(reconstruction: pycolmap.Reconstruction) -> dict[int, float]:
    return {point_id: point.error for point_id, point in reconstruction.points3D.items()}


def write_files(folder: Path, files: Mapping[str, bytes | str]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
    return folder


def complaint(folder: Path) -> str:
    """Return the message, checked to be one line, without the folder."""
    with pytest.raises(InputError) as caught:
        colmap.load(folder)
    message = str(caught.value)
    assert message.startswith(str(folder))
    assert len(message.splitlines()) == 1
    return message.removeprefix(str(folder)).removeprefix(os.sep)


def bal_like() -> Problem:
    """Ids from 0, no names, sizes, keypoints or source; observations in no particular order."""
    rng = np.random.default_rng(7)
    num_images, num_points = 4, 9
    poses = np.zeros((num_images, 7))
    poses[:, :4] = rng.normal(size=(num_images, 4))
    poses[:, 4:] = rng.normal(size=(num_images, 3))
    image, point = np.divmod(rng.permutation(num_images * num_points), num_points)
    return Problem(
        cam_from_world=poses,
        image_ids=np.arange(num_images),
        image_names=("",) * num_images,
        image_camera=np.arange(num_images)[::-1],
        camera_ids=np.arange(num_images),
        camera_models=("RADIAL",) * num_images,
        camera_params=np.c_[
            rng.uniform(500, 900, num_images),
            np.zeros((num_images, 2)),
            rng.normal(0, 1e-3, (num_images, 2)),
        ],
        camera_sizes=np.zeros((num_images, 2)),
        points=rng.normal(size=(num_points, 3)),
        point_ids=np.arange(num_points),
        observation_image=image,
        observation_point=point,
        observation_xy=rng.normal(0, 200, (num_images * num_points, 2)),
        observation_keypoint=np.full(num_images * num_points, -1),
        format="bal",
    )
