"""A model cut into two that share images, the second in a frame of its own."""

import copy

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.similarity import Similarity, moved
from tests.scenes import make_problem

TO_B = Similarity(
    2.5, Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([4.0, -2.0, 9.0])
)


def whole(seed=0, **settings):
    """A model without noise, so that its halves agree exactly; one camera, tracks of 4 of 8."""
    settings = {
        **{"num_images": 8, "num_points": 80, "noise": 0, "perturbation": 0},
        **{"shared": True, "track": 4, "seed": seed, **settings},
    }
    model = make_problem(**settings).to_pycolmap()
    for point_id, point in model.points3D.items():
        point.color = [point_id % 256, 7, 9]
    return bundle.Problem.from_pycolmap(model)


def cut(problem, image_ids):
    """The model of these images as COLMAP keeps it: all keypoints, points of two images."""
    model = problem.to_pycolmap()
    for image_id in set(model.images) - set(image_ids):
        frame_id = model.image(image_id).frame_id
        model.deregister_frame(frame_id)
        del model.frames[frame_id], model.images[image_id]
    for camera_id in set(model.cameras) - {image.camera_id for image in model.images.values()}:
        del model.rigs[camera_id], model.cameras[camera_id]
    return bundle.Problem.from_pycolmap(model)


def halves(problem, first=range(1, 6), second=range(4, 9), similarity=TO_B):
    """A, and B as the similarity puts it."""
    return cut(problem, first), moved(cut(problem, second), similarity)


def edited(problem, change):
    """The problem of its reconstruction after ``change(reconstruction)``."""
    model = problem.to_pycolmap()
    change(model)
    return bundle.Problem.from_pycolmap(model)


def move_point(problem, point_id, by):
    points = problem.points.copy()
    points[problem.point_ids.tolist().index(point_id)] += by
    return problem.replace(points=points)


def tracks(problem):
    """By image name and keypoint, sorted: who sees what together, whatever the ids are."""
    found = {}
    for image, keypoint, point in zip(
        problem.observation_image,
        problem.observation_keypoint.tolist(),
        problem.observation_point.tolist(),
        strict=True,
    ):
        found.setdefault(point, []).append((problem.image_names[image], keypoint))
    return sorted(sorted(track) for track in found.values())


def renumbered(problem, cameras=0, images=0, points=0):
    """The same model under other ids, as another run of a mapper gives them."""
    old, new = problem.to_pycolmap(), pycolmap.Reconstruction()
    for camera_id, camera in old.cameras.items():
        new_camera = copy.copy(camera)
        new_camera.camera_id = camera_id + cameras
        new.add_camera_with_trivial_rig(new_camera)
    for image_id, image in old.images.items():
        xy = np.array([p.xy for p in image.points2D]).reshape(-1, 2)
        new_image = pycolmap.Image(image.name, xy, image.camera_id + cameras, image_id + images)
        new.add_image_with_trivial_frame(new_image, image.cam_from_world())
    for point_id, point in old.points3D.items():
        track = [
            pycolmap.TrackElement(e.image_id + images, e.point2D_idx) for e in point.track.elements
        ]
        new_point = pycolmap.Point3D(xyz=point.xyz, color=point.color, track=pycolmap.Track(track))
        new.add_point3D_with_id(point_id + points, new_point)
    return bundle.Problem.from_pycolmap(new)
