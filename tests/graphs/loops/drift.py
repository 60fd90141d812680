"""A drive whose model has drifted, and closures of its loop."""

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle.analysis.diagnosis.track_table import shared_points
from bundle.georeference.similarity import umeyama


def centers_and_rotations(problem):
    """Rotations world_from_camera and camera centres."""
    return Rotation.from_quat(problem.cam_from_world[:, :4]).inv(), problem.projection_centers


def with_poses(problem, rotations, centers, points):
    back = rotations.inv()
    poses = np.hstack([back.as_quat(), -back.apply(centers)])
    return problem.replace(cam_from_world=poses, points=points)


def drifted_street(num_images=60, num_points=1500, degrees=0.25, growth=0.006, seed=3):
    """The truth, the model that turns and grows from image to image, and its scales.

    A point stands where the first image that sees it has it.
    """
    truth = bundle.synthesize(num_images=num_images, num_points=num_points, seed=seed).ground_truth
    rng = np.random.default_rng(seed)
    turned, centers = centers_and_rotations(truth)
    rotation, where, scales = [turned[0]], [centers[0]], [1.0]
    for k in range(1, num_images):
        step = turned[k - 1].inv().apply(centers[k] - centers[k - 1]) * scales[-1]
        where.append(where[-1] + rotation[-1].apply(step))
        bend = np.radians(degrees) * (np.array([0.1, 1.0, 0.1]) + 0.3 * rng.normal(size=3))
        relative = turned[k - 1].inv() * turned[k] * Rotation.from_rotvec(bend)
        rotation.append(rotation[-1] * relative)
        scales.append(scales[-1] * np.exp(growth * (1 + 0.3 * rng.normal())))
    rotations, where, scales = Rotation.concatenate(rotation), np.array(where), np.array(scales)
    points, first = np.unique(truth.observation_point, return_index=True)
    assert len(points) == truth.num_points
    image = truth.observation_image[first]
    local = turned[image].inv().apply(truth.points - centers[image])
    moved = rotations[image].apply(local) * scales[image, None] + where[image]
    return truth, with_poses(truth, rotations, where, moved), scales


def pairs_far_apart(problem, count):
    """The pairs of images a third of the drive apart that share most points."""
    low, high, shared = shared_points(problem)
    far = np.flatnonzero(high - low > problem.num_images // 3)
    return np.stack([low, high], axis=1)[far[np.argsort(-shared[far], kind="stable")][:count]]


def pairs_along(problem, every, apart=30, least=6):
    """The image that shares most points with one long before it, of so many in a row."""
    low, high, shared = shared_points(problem)
    far = np.flatnonzero((high - low > apart) & (shared >= least))
    far = far[np.argsort(shared[far], kind="stable")]
    best = {high[k] // every: (low[k], high[k]) for k in far}
    return np.array(sorted(best.values()))


def closures_of(truth, scales, count=6, *, pairs=None, wrong=0, seed=0, degrees=0.2, metres=0.03):
    """Closures between the pairs of images far from each other that share most points, or these.

    Their translations are in the unit of the model at the first image. The last ones are wrong.
    """
    pairs = pairs_far_apart(truth, count) if pairs is None else pairs
    rng = np.random.default_rng(seed)
    rotations, centers = centers_and_rotations(truth)
    a, b = pairs.T
    turn = rotations[a].inv() * rotations[b]
    turn = turn * Rotation.from_rotvec(np.radians(degrees) * rng.normal(size=(len(pairs), 3)))
    shift = rotations[a].inv().apply(centers[b] - centers[a]) * scales[a, None]
    shift += metres * rng.normal(size=shift.shape)
    shift[len(pairs) - wrong :] += 8.0
    information = np.diag([np.radians(degrees) ** -2] * 3 + [metres**-2] * 3)
    return bundle.PoseGraph(
        poses=np.tile([0, 0, 0, 1.0, 0, 0, 0], (truth.num_images, 1)),
        ids=truth.image_ids,
        edges=pairs,
        measurements=np.hstack([turn.as_quat(), shift]),
        information=np.tile(information, (len(pairs), 1, 1)),
    )


def ate(problem, truth):
    """RMS distance of camera centres after the best similarity, in metres."""
    found, known = problem.projection_centers, truth.projection_centers
    apart = umeyama(found, known).apply(found) - known
    return float(np.sqrt((apart**2).sum(axis=1).mean()))
