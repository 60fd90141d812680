"""Types of the C++ core, one section a binding file."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.problem import Problem

__version__: str

class InputError(ValueError): ...

# bind_problem.cpp
def validate(problem: Problem) -> None: ...
def reprojection_errors(
    problem: Problem, num_threads: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...

# bind_cameras.cpp
PROJECTION_VALID: int
PROJECTION_BEHIND: int
PROJECTION_UNDEFINED: int

def camera_models() -> list[tuple[str, list[tuple[str, str]]]]: ...
def project(
    model: str, params: NDArray[np.float64], points: NDArray[np.float64], jacobians: bool
) -> tuple[
    NDArray[np.float64],
    NDArray[np.int8],
    NDArray[np.float64] | None,
    NDArray[np.float64] | None,
]: ...

# bind_bal.cpp

# bind_colmap.cpp

# bind_solve.cpp
CERES_VERSION: str

def hardware_threads() -> int: ...
def solve(
    problem: Problem,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
) -> dict[str, Any]: ...
