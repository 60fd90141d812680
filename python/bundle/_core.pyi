"""Types of the C++ core, one section a binding file."""

import os

import numpy as np
from numpy.typing import NDArray

from bundle.problem import Problem

__version__: str

class InputError(ValueError): ...

# bind_problem.cpp
def validate(problem: Problem) -> None: ...

# bind_cameras.cpp

# bind_bal.cpp
def read_bal(
    path: str | os.PathLike[str],
) -> tuple[
    NDArray[np.float64],  # cam_from_world (num_images, 7)
    NDArray[np.float64],  # camera_params (num_images, 5): f cx cy k1 k2
    NDArray[np.float64],  # points (num_points, 3)
    NDArray[np.int32],  # observation_image (num_observations,)
    NDArray[np.int32],  # observation_point (num_observations,)
    NDArray[np.float64],  # observation_xy (num_observations, 2)
]: ...
def write_bal(
    path: str | os.PathLike[str],
    cam_from_world: NDArray[np.float64],
    camera_params: NDArray[np.float64],
    points: NDArray[np.float64],
    observation_image: NDArray[np.int32],
    observation_point: NDArray[np.int32],
    observation_xy: NDArray[np.float64],
    compression: str,
) -> None: ...

# bind_colmap.cpp
def is_colmap_model(folder: str | bytes) -> bool: ...
def check_colmap_model(folder: str | bytes) -> tuple[bool, dict[int, str]]: ...

# bind_solve.cpp
