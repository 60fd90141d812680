"""Images, cameras and points of model B put into model A, which lies in the same frame.

What A has stays as it is: ids, poses, cameras, points. B's ids are kept where A has them free.

Points, in the order of their ids. One that meets no point of A at a keypoint of a shared image
becomes a new point. One that meets points of A is joined to one of those that agree with it, the
one that it meets most often (of several, the least id): its track continues A's, in images that A's
track does not see yet. One that agrees with none of them stays apart, and A keeps the keypoints at
which they met; it is dropped if fewer than two observations are left.
"""

from __future__ import annotations

from collections import Counter
from copy import copy
from dataclasses import dataclass

import pycolmap

from bundle.model.pycolmap.frames import Rigs

__all__ = ["Joined", "join"]

FEWEST = 2
"""Observations of a point that stays apart."""


@dataclass
class Joined:
    """What became of B.

    Attributes:
        num_images: images that A did not have.
        num_cameras: cameras that A did not have.
        num_points_added: points of B that meet none of A.
        num_points_joined: points of B whose tracks continue tracks of A.
        num_points_apart: points of B that disagree with those that they meet, and stay.
        num_points_dropped: those of which fewer than two observations were left.
        num_observations: observations that were added.
        num_observations_dropped: observations of B that were not: at keypoints that A keeps, in
            images that a track sees already, and of dropped points.
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
    """Put B into A.

    Args:
        a: changed in place.
        b: in the frame of A.
        images: ids in A and in B of each shared image.
        keypoints: for each of them, from keypoints of B that see a point to those of A or None.
        meetings: for points of B, how often they meet which point of A.
        agreeing: ids in B and in A of points that are one.
        cameras: from ids of B to the cameras of A that take their images over.
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
        # Meetings of points that are one are no loss: A has the observation.
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
    """Return image and keypoint in A of those in B; keypoints that A has not are appended."""
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
    rigs = Rigs(a)
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
    """Lengthen a track by what is in images that it does not see; return by how much."""
    seen = {element.image_id for element in a.point3D(point_id).track.elements}
    count = 0
    for image_id, keypoint in free:
        if image_id not in seen:
            a.add_observation(point_id, pycolmap.TrackElement(image_id, keypoint))
            seen.add(image_id)
            count += 1
    return count
