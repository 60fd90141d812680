"""Small seeded problems for tests, projected by formulas of their own."""

import numpy as np
from scipy.spatial.transform import Rotation

from bundle import Problem
from tests import formulas
from tests.formulas import PARAMS

SQUARE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0 0
VERTEX_SE2 2 1 1.2 0
EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1
EDGE_SE2 1 2 0 1 0 1 0 0 1 0 1
EDGE_SE2 2 0 -1 -1 0 1 0 0 1 0 1
"""
"""Text of a g2o file: a loop of three poses that contradicts itself a little."""


def project(model, params, points):
    """Pixels of (N, 3) points of the camera frame; also for complex numbers."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack(formulas.project(model, np.asarray(params), *np.transpose(points)), 1)


def make_problem(
    *,
    num_images=5,
    num_points=40,
    model="SIMPLE_RADIAL",
    shared=False,
    seed=0,
    noise=0.5,
    perturbation=1e-2,
    track=None,
    **changes,
):
    """Cameras on an arc around a cloud; every point is in every image, or in `track` of them."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (num_points, 3))
    angles = np.linspace(-0.6, 0.6, num_images)
    rotations = Rotation.from_rotvec(np.stack([0.1 * angles, angles, 0.05 * angles], 1))
    translations = np.stack([0.1 * angles, -0.05 * angles, 4 + 0.3 * angles], 1)
    num_cameras = 1 if shared else num_images
    params = np.tile(PARAMS[model], (num_cameras, 1))
    params[:, 0] += np.arange(num_cameras)
    image_camera = np.zeros(num_images, int) if shared else np.arange(num_images)

    if track is None:
        seen = np.tile(np.arange(num_images), (num_points, 1))
    else:
        seen = np.array([np.sort(rng.choice(num_images, track, False)) for _ in range(num_points)])
    image = seen.ravel()
    point = np.repeat(np.arange(num_points), seen.shape[1])
    xy = np.empty((len(image), 2))
    for i in range(num_images):
        in_camera = rotations[i].apply(points[point[image == i]]) + translations[i]
        xy[image == i] = project(model, params[image_camera[i]], in_camera)
    xy += noise * rng.standard_normal(xy.shape)

    start = Rotation.from_rotvec(perturbation * rng.standard_normal((num_images, 3))) * rotations
    arrays = {
        "cam_from_world": np.hstack(
            [
                start.as_quat(),
                translations + perturbation * rng.standard_normal(translations.shape),
            ]
        ),
        "image_ids": np.arange(1, num_images + 1),
        "image_names": [f"image{i}.jpg" for i in range(num_images)],
        "image_camera": image_camera,
        "camera_ids": np.arange(1, num_cameras + 1),
        "camera_models": [model] * num_cameras,
        "camera_params": params,
        "camera_sizes": np.tile([800, 600], (num_cameras, 1)),
        "points": points + perturbation * rng.standard_normal(points.shape),
        "point_ids": np.arange(1, num_points + 1),
        "observation_image": image,
        "observation_point": point,
        "observation_xy": xy,
        "observation_keypoint": np.full(len(image), -1),
    }
    return Problem(**{**arrays, **changes})


def with_observations(problem, keep):
    """The problem with some of its observations: a mask, or their rows."""
    names = [f"observation_{name}" for name in ("image", "point", "xy", "keypoint")]
    return problem.replace(**{name: getattr(problem, name)[keep] for name in names})


def scene(
    num_images=4, num_points=30, *, kind="bal", shared_camera=False, seed=1, noise=0.5, **changes
):
    """A problem as a BAL file has it: RADIAL, ids from 0, no names, principal point at 0.

    Observations are sorted by image, then by point.
    """
    problem = make_problem(
        num_images=num_images,
        num_points=num_points,
        model="RADIAL",
        shared=shared_camera,
        seed=seed,
        noise=noise,
    )
    order = np.argsort(problem.observation_image, kind="stable")
    bal = {
        "camera_params": problem.camera_params * [1, 0, 0, 1, 1],
        "observation_image": problem.observation_image[order],
        "observation_point": problem.observation_point[order],
        "observation_xy": problem.observation_xy[order] - PARAMS["RADIAL"][1:3],
        "camera_sizes": np.zeros((problem.num_cameras, 2)),
        "image_names": [""] * num_images,
        "image_ids": np.arange(num_images),
        "camera_ids": np.arange(problem.num_cameras),
        "point_ids": np.arange(num_points),
        "format": kind,
    }
    return problem.replace(**{**bal, **changes})


def residuals(problem, w=None, t=None, params=None, points=None):
    """(N, 2) residuals of a problem by formulas; any argument may be complex.

    w (num_images, 3) turns the rotations, Exp(w) R, by the series of the exponential.
    """
    num_images = problem.num_images
    w = np.zeros((num_images, 3)) if w is None else np.asarray(w)
    t = problem.cam_from_world[:, 4:] if t is None else np.asarray(t)
    params = problem.camera_params if params is None else np.asarray(params)
    points = problem.points if points is None else np.asarray(points)
    starts = Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()
    rotations = np.array([exp(w[i]) @ starts[i] for i in range(num_images)])
    image = problem.observation_image
    turned = np.einsum("nij,nj->ni", rotations[image], points[problem.observation_point])
    in_camera = turned + t[image]
    result = np.empty((problem.num_observations, 2), np.result_type(in_camera, params))
    for camera in np.unique(problem.image_camera[image]):
        of = problem.image_camera[image] == camera
        result[of] = project(problem.camera_models[camera], params[camera], in_camera[of])
    return result - problem.observation_xy


def exp(w):
    """The rotation matrix of a rotation vector by the power series, also for complex numbers."""
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ skew / k
        total = total + term
        if np.abs(term).max() < 1e-50:  # a complex step is 1e-30
            break
    return total
