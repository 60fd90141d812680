"""A synthetic flight with ground control points, whose truth is known: all pixels are there."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bundle import GroundControlPoint, Problem
from bundle.georeference.similarity import Similarity, moved
from tests.scenes import project

MODEL = "SIMPLE_RADIAL"
SIZE = np.array([2000, 1500])


@dataclass
class Flight:
    """A start in metres east, north, up; its control points; the places without noise."""

    problem: Problem
    gcps: list[GroundControlPoint]
    truth: Problem
    targets: np.ndarray

    def elsewhere(self):
        """The start in a frame of its own."""
        turn = Rotation.from_euler("zyx", [130, 12, -25], degrees=True).as_matrix()
        return moved(self.problem, Similarity(0.27, turn, np.array([5, -9, 4])))


def flight(
    targets,
    *,
    num_images=16,
    num_points=150,
    seed=0,
    noise=1.0,
    target_noise=0.5,
    survey_noise=0.02,
    start_noise=0.0,
    start_k=None,
    k=-0.05,
    **settings,
):
    """Nadir images in a grid at 60 m over ground with little relief.

    Args:
        targets: (n, 3) east, north, up of control points.
        start_noise: metres by which points and cameras start elsewhere.
        start_k: distortion of the start, where it is another one.
        settings: of the control points.
    """
    rng = np.random.default_rng(seed)
    targets = np.array(targets, float).reshape(-1, 3)
    side = int(np.sqrt(num_images))
    grid = 16.0 * (np.indices((side, side)).reshape(2, -1).T - (side - 1) / 2)
    centers = np.column_stack([grid, 60 + rng.normal(size=len(grid))])
    down = Rotation.from_euler("x", 180, degrees=True)
    rotations = Rotation.from_rotvec(0.03 * rng.normal(size=(len(grid), 3))) * down
    reach = np.abs(grid).max() + 20
    ground = np.column_stack(
        [rng.uniform(-reach, reach, (num_points, 2)), rng.uniform(-1, 1, num_points)]
    )
    params = np.array([1500.0, 1000.0, 750.0, k])
    places = np.concatenate([ground, targets])
    image, point, xy = [], [], []
    for i, (rotation, center) in enumerate(zip(rotations, centers, strict=True)):
        pixels = project(MODEL, params, rotation.apply(places - center))
        seen = np.flatnonzero(((pixels > 0) & (pixels < SIZE)).all(axis=1))
        image += [i] * len(seen)
        point += seen.tolist()
        xy += pixels[seen].tolist()
    image, point, xy = np.array(image), np.array(point), np.array(xy)
    of_target = point >= num_points
    xy += np.where(of_target, target_noise, noise)[:, None] * rng.normal(size=xy.shape)
    names = [f"flight/{i:02}.jpg" for i in range(len(grid))]
    surveyed = targets + survey_noise * rng.normal(size=targets.shape)
    gcps = [
        GroundControlPoint(
            name=f"t{row}",
            position=tuple(surveyed[row].tolist()),
            measurements=[
                (names[image[n]], *xy[n].tolist())
                for n in np.flatnonzero(point == num_points + row)
            ],
            **settings,
        )
        for row in range(len(targets))
    ]
    # Points that two images see, as reconstructions have them.
    counts = np.bincount(point[~of_target], minlength=num_points)
    rows = np.cumsum(counts >= 2) - 1
    kept = ~of_target & (counts[np.minimum(point, num_points - 1)] >= 2)
    truth = Problem(
        cam_from_world=np.hstack([rotations.as_quat(), -rotations.apply(centers)]),
        image_ids=np.arange(1, len(grid) + 1),
        image_names=names,
        camera_models=[MODEL],
        camera_params=params[None],
        camera_sizes=[SIZE],
        points=ground[counts >= 2],
        point_ids=10 + np.arange((counts >= 2).sum()),
        observation_image=image[kept],
        observation_point=rows[point[kept]],
        observation_xy=xy[kept],
        format="colmap",
    )
    start = Rotation.from_rotvec(0.01 * start_noise * rng.normal(size=(len(grid), 3))) * rotations
    begins = centers + start_noise * rng.normal(size=centers.shape)
    problem = truth.replace(
        cam_from_world=np.hstack([start.as_quat(), -start.apply(begins)]),
        points=truth.points + start_noise * rng.normal(size=truth.points.shape),
        camera_params=[[1500.0, 1000.0, 750.0, k if start_k is None else start_k]],
    )
    return Flight(problem, gcps, truth, targets)
