"""Joining of model B to model A, in the same coordinate frame: images, cameras, points.

Ids, poses, cameras and points of A stay unchanged. B's ids are kept if A does not use them. Two
points meet if they have observations at the same keypoint of a shared image. Points of B are
handled in the order of their ids:

* A point that meets no point of A becomes a new point.
* A point that meets points of A is joined to an agreeing point of A: the point with most meetings,
  on a tie the point with the smallest id. Its observations in images that A's track lacks are added
  to A's track.
* A point that meets points of A but agrees with none of them becomes a new point. It loses its
  observations at the shared keypoints, which stay with A's points. It is dropped if fewer than two
  observations are left.
"""

from __future__ import annotations

from collections import Counter
from copy import copy
from dataclasses import dataclass

import pycolmap

from bundle.model.pycolmap.colmap_rigs import is_trivial

__all__ = ["Joined", "join"]

FEWEST = 2
"""Minimum observations left of a point of B that meets points of A but agrees with none."""


@dataclass
class Joined:
    """Numbers of images, cameras, points and observations of B by outcome.

    Attributes:
        num_images: images that were added to A.
        num_cameras: cameras that were added to A.
        num_points_added: points of B without a meeting.
        num_points_joined: points of B whose tracks extend tracks of A.
        num_points_apart: points of B that were added although they meet points of A, because they
            agree with none of them.
        num_points_dropped: points of B with fewer than two observations left.
        num_observations: observations that were added.
        num_observations_dropped: observations of B that were not added: observations at keypoints
            of A's points, in images that the track already has, and of dropped points.
    """

    num_images: int = 0
    num_cameras: int = 0
    num_points_added: int = 0
    num_points_joined: int = 0
    num_points_apart: int = 0
    num_points_dropped: int = 0
    num_observations: int = 0
    num_observations_dropped: int = 0


def join(
    a: pycolmap.Reconstruction,
    b: pycolmap.Reconstruction,
    *,
    images: list[tuple[int, int]],
    keypoints: tuple[dict[int, int | None], ...],
    meetings: dict[int, Counter[int]],
    agreeing: set[tuple[int, int]],
    cameras: dict[int, int],
) -> Joined:
    """Join B to A.

    Args:
        a: model A; changed in place.
        b: model B, in the coordinate frame of A.
        images: ids in A and in B of each shared image.
        keypoints: for each shared image, table from observed keypoints of B to keypoints of A; None
            if A's image lacks the keypoint.
        meetings: for each point of B, number of meetings with each point of A.
        agreeing: pairs of ids, in B and in A, of points that agree.
        cameras: table from cameras of B to cameras of A that replace them.
    """
    joined = Joined()
    places = _shared_places(a, b, images, keypoints)
    _add_images(a, b, {id_b for _, id_b in images}, cameras, places, joined)
    taken = set(a.points3D)
    spare = max([*taken, *b.points3D], default=0)
    for point_id, point in sorted(b.points3D.items()):
        elements = [places[e.image_id, e.point2D_idx] for e in point.track.elements]
        free = [e for e in elements if not a.image(e[0]).point2D(e[1]).has_point3D()]
        met = meetings.get(point_id, Counter())
        same = [other for other in met if (point_id, other) in agreeing]
        if same:
            chosen = min(same, key=lambda other: (-met[other], other))
            added = _continue(a, chosen, free)
            joined.num_points_joined += 1
        elif met and len(free) < FEWEST:
            added = 0
            joined.num_points_dropped += 1
        else:
            new_id = point_id
            if point_id in taken:
                spare += 1
                new_id = spare
            taken.add(new_id)
            track = pycolmap.Track([pycolmap.TrackElement(*e) for e in free])
            new = pycolmap.Point3D(xyz=point.xyz, color=point.color, track=track)
            a.add_point3D_with_id(new_id, new)
            added = len(free)
            if met:
                joined.num_points_apart += 1
            else:
                joined.num_points_added += 1
        joined.num_observations += added
        # Meetings with the joined point lose no observation: A's point has it already.
        kept = met[chosen] if same else 0
        joined.num_observations_dropped += len(elements) - added - kept
    a.update_point_3d_errors()
    return joined


def _shared_places(
    a: pycolmap.Reconstruction,
    b: pycolmap.Reconstruction,
    images: list[tuple[int, int]],
    keypoints: tuple[dict[int, int | None], ...],
) -> dict[tuple[int, int], tuple[int, int]]:
    """Map image and keypoint in B to image and keypoint in A; append keypoints that A lacks."""
    places = {}
    for (id_a, id_b), same in zip(images, keypoints, strict=True):
        image = a.image(id_a)
        for keypoint, other in same.items():
            if other is None:
                other = image.num_points2D()
                image.points2D.append(pycolmap.Point2D(b.image(id_b).point2D(keypoint).xy))
            places[id_b, keypoint] = (id_a, other)
    return places


def _add_images(
    a: pycolmap.Reconstruction,
    b: pycolmap.Reconstruction,
    shared: set[int],
    cameras: dict[int, int],
    places: dict[tuple[int, int], tuple[int, int]],
    joined: Joined,
) -> None:
    rigs = _Rigs(a)
    cameras = dict(cameras)
    spare_image = max([*a.images, *b.images], default=0)
    spare_camera = max([*a.cameras, *b.cameras], default=0)
    for image_id in sorted(set(b.reg_image_ids()) - shared):
        image = b.image(image_id)
        if image.camera_id not in cameras:
            camera = copy(b.camera(image.camera_id))
            if a.exists_camera(camera.camera_id):
                spare_camera += 1
                camera.camera_id = spare_camera
            cameras[image.camera_id] = camera.camera_id
            a.add_camera(camera)
            joined.num_cameras += 1
        new_id = image_id
        if a.exists_image(image_id):
            spare_image += 1
            new_id = spare_image
        new = pycolmap.Image(
            image.name,
            pycolmap.Point2DList([pycolmap.Point2D(point.xy) for point in image.points2D]),
            cameras[image.camera_id],
            new_id,
        )
        rigs.add(new, rigs.free_frame_id(new_id), image.cam_from_world())
        joined.num_images += 1
        for keypoint in map(int, image.get_observation_point2D_idxs()):
            places[image_id, keypoint] = (new_id, keypoint)


def _continue(a: pycolmap.Reconstruction, point_id: int, free: list[tuple[int, int]]) -> int:
    """Extend a track in images that it lacks; return the number of added observations."""
    seen = {element.image_id for element in a.point3D(point_id).track.elements}
    count = 0
    for image_id, keypoint in free:
        if image_id not in seen:
            a.add_observation(point_id, pycolmap.TrackElement(image_id, keypoint))
            seen.add(image_id)
            count += 1
    return count


class _Rigs:
    """Frames and rigs for added images. Each camera gets a single-camera rig if it has none."""

    def __init__(self, reconstruction: pycolmap.Reconstruction) -> None:
        self._reconstruction = reconstruction
        self._rig_of_camera: dict[int, int] = {}
        for rig_id, rig in sorted(reconstruction.rigs.items()):
            is_camera = rig.num_sensors() and rig.ref_sensor_id.type == pycolmap.SensorType.CAMERA
            if is_camera and is_trivial(rig):
                self._rig_of_camera.setdefault(rig.ref_sensor_id.id, rig_id)

    def free_frame_id(self, wanted: int) -> int:
        """Return an unused frame id, if possible the wanted one."""
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
