"""Models as learned reconstructions export them (VGGT, MASt3R, DUSt3R), with their faults.

A network gives each image a pose, a focal length and a depth per pixel. An export turns pixels into
points by these, so that the error of a point's first observation is zero, whatever is wrong:

* ``single``: each pixel is a point of its own, seen by one image (VGGT without bundle adjustment);
* ``pairs``: each match of two images is a point of its own, so that the same corner is many points
  (MASt3R, DUSt3R).

Poses, depths and focal lengths are noisy, and each image has a camera of its own although one lens
took them all.
"""

import numpy as np
from scipy.spatial.transform import Rotation

import bundle

FOCAL, TURN, MOVE, DEPTH = 0.15, 0.02, 0.02, 0.05
"""Standard deviations: logarithm, radians, share of the scene, logarithm."""


def truth(seed: int) -> bundle.Problem:
    """Images around an object, with a camera of its own each, which are the same lens."""
    return bundle.synthesize(
        scene="orbit", num_images=24, num_points=1500, mean_track_length=3, seed=seed,
        camera_model="SIMPLE_PINHOLE", cameras="individual", pixel_noise=0.7, focal_noise=0.0,
    ).ground_truth  # fmt: skip


def export(scene: bundle.Problem, kind: str, seed: int) -> bundle.Problem:
    """Return the export of a network's answer to the images of a scene."""
    rng = np.random.default_rng(seed)
    size = np.linalg.norm(scene.points - scene.points.mean(axis=0), axis=1).mean()
    lenses = scene.camera_params.copy()
    lenses[:, 0] *= np.exp(rng.normal(0, FOCAL, len(lenses)))
    right = Rotation.from_quat(scene.cam_from_world[:, :4])
    turned = Rotation.from_rotvec(rng.normal(0, TURN, (scene.num_images, 3))) * right
    moved = scene.cam_from_world[:, 4:] + rng.normal(0, MOVE * size, (scene.num_images, 3))

    image, point, xy = scene.observation_image, scene.observation_point, scene.observation_xy
    if kind == "single":
        groups = np.arange(len(image))[:, None]
    else:
        order = np.lexsort((rng.random(len(point)), point))
        same = point[order[:-1]] == point[order[1:]]
        groups = np.stack([order[:-1][same], order[1:][same]], axis=1)
    first = groups[:, 0]
    seen_by = image[first]
    depth = (right[seen_by].apply(scene.points[point[first]]) + scene.cam_from_world[seen_by, 4:])[
        :, 2
    ]
    depth *= np.exp(rng.normal(0, DEPTH, len(first)))
    f, cx, cy = lenses[scene.image_camera[seen_by]].T
    ray = np.stack([(xy[first, 0] - cx) / f, (xy[first, 1] - cy) / f, np.ones(len(first))], axis=1)
    points = turned[seen_by].inv().apply(depth[:, None] * ray - moved[seen_by])
    rows = groups.ravel()
    return scene.replace(
        camera_params=lenses,
        cam_from_world=np.hstack([turned.as_quat(), moved]),
        points=points,
        point_ids=np.arange(1, len(points) + 1),
        observation_image=image[rows],
        observation_point=np.repeat(np.arange(len(points), dtype=np.int32), groups.shape[1]),
        observation_xy=xy[rows],
        observation_keypoint=np.full(len(rows), -1, np.int32),
    )
