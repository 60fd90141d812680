"""Frames and rigs of a reconstruction: adding, moving and removing images and cameras."""

from __future__ import annotations

import pycolmap

from bundle.model.pycolmap.colmap_rigs import cameras_of, is_trivial

__all__ = ["Rigs", "remove_cameras", "remove_images"]


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

    def move(self, image: pycolmap.Image, camera_id: int, pose: pycolmap.Rigid3d) -> None:
        """Give an image another camera, and with it a frame of that camera's rig."""
        image_id = image.image_id
        moved = pycolmap.Image(image.name, image.points2D, camera_id, image_id)
        # A frame takes the observations of its images with it, but these are the copy's now.
        for keypoint in image.get_observation_point2D_idxs():
            image.reset_point3D_for_point2D(int(keypoint))
        frame_id = image.frame_id
        remove_images(self._reconstruction, {image_id})
        self.add(moved, frame_id, pose)

    def _rig(self, camera_id: int) -> int:
        if camera_id not in self._rig_of_camera:
            rigs = self._reconstruction.rigs
            rig = pycolmap.Rig()
            rig.rig_id = camera_id if camera_id not in rigs else max(rigs) + 1
            rig.add_ref_sensor(self._reconstruction.camera(camera_id).sensor_id)
            self._reconstruction.add_rig(rig)
            self._rig_of_camera[camera_id] = rig.rig_id
        return self._rig_of_camera[camera_id]


def remove_cameras(reconstruction: pycolmap.Reconstruction, camera_ids: set[int]) -> None:
    """Remove cameras that no registered image has, their rigs and images without a pose."""
    if not camera_ids:
        return
    orphans = {i for i, image in reconstruction.images.items() if image.camera_id in camera_ids}
    remove_images(reconstruction, orphans)
    rigs = {
        rig_id
        for rig_id, rig in reconstruction.rigs.items()
        if not camera_ids.isdisjoint(sensor.id for sensor in cameras_of(rig))
    }
    for frame_id in [f for f, frame in reconstruction.frames.items() if frame.rig_id in rigs]:
        _remove_frame(reconstruction, frame_id)
    for rig_id in rigs:
        del reconstruction.rigs[rig_id]
    for camera_id in camera_ids:
        del reconstruction.cameras[camera_id]


def remove_images(reconstruction: pycolmap.Reconstruction, image_ids: set[int]) -> None:
    """Remove images that observe no point any more, with their frames: all images of each."""
    for image_id in sorted(image_ids):
        frame_id = reconstruction.image(image_id).frame_id
        if frame_id in reconstruction.frames:
            _remove_frame(reconstruction, frame_id)
        del reconstruction.images[image_id]


def _remove_frame(reconstruction: pycolmap.Reconstruction, frame_id: int) -> None:
    if reconstruction.frame(frame_id).has_pose():
        reconstruction.deregister_frame(frame_id)
    del reconstruction.frames[frame_id]
