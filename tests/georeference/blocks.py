"""A synthetic flight over ground control points, in a model frame of its own."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bundle import GroundControlPoint, Problem
from bundle.georeference.control_point import Measurement
from bundle.georeference.similarity import Similarity
from tests.scenes import project

MODEL = "SIMPLE_RADIAL"
PARAMS = np.array([1500.0, 1000.0, 750.0, -0.05])
TRUTH = Similarity(
    3.7, Rotation.from_euler("zyx", [130, 12, -25], degrees=True).as_matrix(), np.array([5, -9, 4])
)
"""From the model to east, north, up."""


@dataclass
class Block:
    problem: Problem
    gcps: list[GroundControlPoint]
    surveyed: np.ndarray
    cameras: np.ndarray


def block(
    num_targets=8,
    *,
    seed=0,
    relief=5.0,
    pixel_noise=0.0,
    survey_noise=0.0,
    num_images=9,
    **settings,
):
    """Nadir images in a grid at 60 m over targets that each of them may see."""
    rng = np.random.default_rng(seed)
    centers = np.column_stack(
        [
            *(20.0 * (np.indices((3, num_images // 3)).reshape(2, -1) - 1)),
            60 + rng.normal(size=num_images),
        ]
    )
    down = Rotation.from_euler("x", 180, degrees=True)
    tilts = Rotation.from_rotvec(0.05 * rng.normal(size=(num_images, 3)))
    enu_rotations = tilts * down
    targets = np.column_stack(
        [rng.uniform(-25, 25, (num_targets, 2)), relief * rng.uniform(-1, 1, num_targets)]
    )
    # Into the model: x = R^T (y - t) / s.
    turn = Rotation.from_matrix(TRUTH.rotation)
    model_rotations = enu_rotations * turn
    model_centers = (centers - TRUTH.translation) @ TRUTH.rotation / TRUTH.scale
    names = [f"flight/{index:02}.jpg" for index in range(num_images)]
    gcps = []
    for row, target in enumerate(targets):
        measurements = []
        for image in range(num_images):
            in_camera = enu_rotations[image].apply(target - centers[image])
            xy = project(MODEL, PARAMS, in_camera[None])[0] + pixel_noise * rng.normal(size=2)
            measurements.append(Measurement(names[image], *xy.tolist()))
        surveyed = target + survey_noise * rng.normal(size=3)
        gcps.append(
            GroundControlPoint(
                name=f"t{row}", position=tuple(surveyed), measurements=measurements, **settings
            )
        )
    ground = np.column_stack([rng.uniform(-30, 30, (50, 2)), np.zeros(50)]) - TRUTH.translation
    problem = Problem(
        cam_from_world=np.hstack(
            [model_rotations.as_quat(), -model_rotations.apply(model_centers)]
        ),
        image_ids=np.arange(1, num_images + 1),
        image_names=names,
        camera_models=[MODEL],
        camera_params=PARAMS[None],
        camera_sizes=[[2000, 1500]],
        points=ground @ TRUTH.rotation / TRUTH.scale,
        observation_image=[0] * 50,
        observation_point=range(50),
        observation_xy=np.zeros((50, 2)),
        format="colmap",
    )
    return Block(problem, gcps, targets, centers)
