"""The cost of a COLMAP model by pycolmap's own camera models: the oracle for COLMAP input."""

from __future__ import annotations

import numpy as np
import pycolmap


def cost(reconstruction: pycolmap.Reconstruction) -> float:
    """Return 1/2 sum ||r||^2 in pixels over registered images; behind the camera counts as zero.

    Text models hold rounded quaternions; they are normalised here, as COLMAP's adjuster does.
    """
    total = 0.0
    xyz_of = {id_: point.xyz for id_, point in reconstruction.points3D.items()}
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.images[image_id]
        seen = [point for point in image.points2D if point.has_point3D()]
        if not seen:
            continue
        pose = image.cam_from_world()
        pose.rotation.normalize()
        in_camera = pose * np.array([xyz_of[point.point3D_id] for point in seen])
        front = in_camera[:, 2] > np.finfo(float).eps
        measured = np.array([point.xy for point in seen])[front]
        camera = reconstruction.cameras[image.camera_id]
        errors = camera.img_from_cam(np.ascontiguousarray(in_camera[front])) - measured
        total += 0.5 * float(np.sum(errors * errors))
    return total
