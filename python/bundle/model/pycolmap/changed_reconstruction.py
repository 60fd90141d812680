"""Changes of a ``pycolmap.Reconstruction`` in place: refined values, and bad observations.

Only the values of variables are set; images, tracks, colours and all other records stay as they
are. pycolmap has no arrays of poses or points, so that each value is set alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pycolmap
from numpy.typing import NDArray

if TYPE_CHECKING:
    from bundle.model.problem import Problem

_Mask = NDArray[np.bool_]


def frames_of_images(
    reconstruction: pycolmap.Reconstruction, image_ids: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the frame id of each image."""
    ids = (reconstruction.image(image_id).frame_id for image_id in image_ids.tolist())
    return np.fromiter(ids, np.int64, len(image_ids))


def set_values(
    reconstruction: pycolmap.Reconstruction,
    refined: Problem,
    *,
    images: _Mask,
    points: _Mask,
) -> None:
    """Set the refined values of a sub-problem.

    Args:
        reconstruction: the reconstruction to change.
        refined: the sub-problem with its new values.
        images: mask of its images whose poses are set, each with its frame.
        points: mask of its points that are set.
    """
    for camera_id, model, params in zip(
        refined.camera_ids.tolist(), refined.camera_models, refined.camera_params, strict=True
    ):
        camera = reconstruction.camera(camera_id)
        assert camera.model.name == model
        camera.params = params[: len(camera.params)]
    alone = images if not refined.num_frames else images & (refined.image_frame < 0)
    for row in np.flatnonzero(alone).tolist():
        frame = reconstruction.frame(reconstruction.image(int(refined.image_ids[row])).frame_id)
        frame.rig_from_world = _rigid(refined.cam_from_world[row])
    for frame_id, pose in zip(refined.frame_ids.tolist(), refined.rig_from_world, strict=True):
        reconstruction.frame(frame_id).rig_from_world = _rigid(pose)
    for rig_id, camera_id, pose in zip(
        refined.sensor_rig_ids.tolist(),
        refined.sensor_camera_ids.tolist(),
        refined.sensor_from_rig,
        strict=True,
    ):
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
        reconstruction.rig(rig_id).set_sensor_from_rig(sensor, _rigid(pose))
    rows = np.flatnonzero(points)
    for point_id, xyz in zip(refined.point_ids[rows].tolist(), refined.points[rows], strict=True):
        reconstruction.point3D(point_id).xyz = xyz


def delete_observations_behind(reconstruction: pycolmap.Reconstruction) -> None:
    """Delete observations of points behind their camera, as ``pycolmap.bundle_adjustment`` does."""
    pycolmap.ObservationManager(reconstruction).filter_observations_with_negative_depth()


def update_errors(reconstruction: pycolmap.Reconstruction) -> None:
    """Recompute the reprojection errors that the points hold."""
    reconstruction.update_point_3d_errors()


def _rigid(pose: NDArray[np.float64]) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])
