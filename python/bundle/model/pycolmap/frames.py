"""Frames and rigs of a reconstruction to which images are added."""

from __future__ import annotations

import pycolmap

from bundle.model.pycolmap.colmap_rigs import is_trivial

__all__ = ["Rigs"]


class Rigs:
    """Puts images into frames of rigs of one camera, and makes such rigs where there are none."""

    def __init__(self, reconstruction: pycolmap.Reconstruction) -> None:
        self._reconstruction = reconstruction
        self._rig_of_camera: dict[int, int] = {}
        for rig_id, rig in sorted(reconstruction.rigs.items()):
            is_camera = rig.num_sensors() and rig.ref_sensor_id.type == pycolmap.SensorType.CAMERA
            if is_camera and is_trivial(rig):
                self._rig_of_camera.setdefault(rig.ref_sensor_id.id, rig_id)

    def free_frame_id(self, wanted: int) -> int:
        """Return a frame id that is not taken, the wanted one where possible."""
        taken = self._reconstruction.frames
        return wanted if wanted not in taken else max(taken) + 1

    def add(self, image: pycolmap.Image, frame_id: int, pose: pycolmap.Rigid3d) -> None:
        """Add an image in a frame of its own."""
        frame = pycolmap.Frame()
        frame.frame_id = frame_id
        frame.rig_id = self._rig(image.camera_id)
        frame.add_data_id(image.data_id)
        frame.rig_from_world = pose
        self._reconstruction.add_frame(frame)
        image.frame_id = frame_id
        self._reconstruction.add_image(image)

    def _rig(self, camera_id: int) -> int:
        if camera_id not in self._rig_of_camera:
            rigs = self._reconstruction.rigs
            rig = pycolmap.Rig()
            rig.rig_id = camera_id if camera_id not in rigs else max(rigs) + 1
            rig.add_ref_sensor(self._reconstruction.camera(camera_id).sensor_id)
            self._reconstruction.add_rig(rig)
            self._rig_of_camera[camera_id] = rig.rig_id
        return self._rig_of_camera[camera_id]
