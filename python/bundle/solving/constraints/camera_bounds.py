"""Bounds of camera parameters, and the bounds that are active at the end of a solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import as_array
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.problem_keys import ProblemKeys, parameter_names

ActiveBound = tuple[tuple[str, int], str, str]
"""Tuple of a camera's key, a parameter's name, and "lower" or "upper"."""

_SIDES = ("lower", "upper")


@dataclass(frozen=True, eq=False)
class CameraBounds:
    """Bounds of every camera parameter of a problem.

    Attributes:
        lower: (num_cameras, width) as in ``Problem.camera_params``; -inf without a lower bound.
        upper: upper bounds in the same shape; inf without an upper bound.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @staticmethod
    def make(problem: Problem, bounds: Any) -> CameraBounds:
        """Check bounds given as {("camera", id): (lower, upper)} and return them.

        Raises:
            InputError: the problem has no camera of a key; the length of a bound differs from the
                number of parameters of the camera's model; a bound is nan; a lower bound is above
                the upper bound; or the problem's parameter is not between them.
        """
        if not isinstance(bounds, Mapping):
            raise InputError(
                'bounds: expected a mapping {("camera", id): (lower, upper)}, '
                f"found {brief(bounds)}"
            )
        shape = problem.camera_params.shape
        result = CameraBounds(np.full(shape, -np.inf), np.full(shape, np.inf))
        keys = ProblemKeys(problem, ("camera",), "key")
        for key, pair in bounds.items():
            _, index = keys.find("bounds", key)
            names = parameter_names("bounds", problem, index)
            name = f"bounds: camera {problem.camera_ids[index]}"
            for side, array, values in zip(
                _SIDES, (result.lower, result.upper), _pair(name, pair), strict=True
            ):
                array[index, : len(names)] = _bound(f"{name}: {side}", names, values)
            result._check_sides(name, names, index)
        result.check_start(problem)
        return CameraBounds(freeze(result.lower), freeze(result.upper))

    def check_start(self, problem: Problem) -> None:
        """Check that a problem starts within the bounds.

        The problem must have the cameras for which the bounds were made.

        Raises:
            InputError: a parameter is not between its bounds.
        """
        params = problem.camera_params
        outside = np.argwhere((params < self.lower) | (params > self.upper))
        if not len(outside):
            return
        camera, j = outside[0].tolist()
        name = f"bounds: camera {problem.camera_ids[camera]}"
        lower, upper = self.lower[camera, j], self.upper[camera, j]
        raise InputError(
            f"{name}: {parameter_names(name, problem, camera)[j]}: expected a start within "
            f"[{lower:g}, {upper:g}], found {params[camera, j]:.10g}"
        )

    def tightened(self, more: Mapping[tuple[int, int], tuple[float, float]]) -> CameraBounds:
        """Return the bounds after adding others, by camera index and column; the tighter counts."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for place, (least, most) in more.items():
            lower[place], upper[place] = max(lower[place], least), min(upper[place], most)
        return CameraBounds(freeze(lower), freeze(upper))

    def given(self, problem: Problem) -> dict[tuple[str, int], tuple[Any, Any]]:
        """Return the bounds as input of :meth:`make`, for the cameras that have a bound."""
        bounded = np.isfinite(self.lower) | np.isfinite(self.upper)
        bounds = {}
        for camera in np.flatnonzero(bounded.any(axis=1)).tolist():
            size = len(parameter_names("bounds", problem, camera))
            key = ("camera", int(problem.camera_ids[camera]))
            bounds[key] = self.lower[camera, :size], self.upper[camera, :size]
        return bounds

    def active(self, problem: Problem) -> tuple[ActiveBound, ...]:
        """Return the active bounds: those that parameters of the problem have reached."""
        params = problem.camera_params
        found = []
        for camera, j in np.argwhere(
            ((params == self.lower) | (params == self.upper)) & (self.lower < self.upper)
        ):
            key = ("camera", int(problem.camera_ids[camera]))
            side = _SIDES[int(params[camera, j] == self.upper[camera, j])]
            found.append((key, camera_models()[problem.camera_models[camera]][j], side))
        return tuple(found)

    def _check_sides(self, name: str, names: tuple[str, ...], index: int) -> None:
        rows = (self.lower[index], self.upper[index])
        for parameter, lower, upper in zip(
            names, *(row[: len(names)] for row in rows), strict=True
        ):
            if lower > upper:
                raise InputError(
                    f"{name}: {parameter}: expected a lower bound of at most the upper one "
                    f"({upper:g}), found {lower:g}"
                )


def _pair(name: str, pair: Any) -> tuple[Any, Any]:
    try:
        lower, upper = pair
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected (lower, upper), found {brief(pair)}") from None
    return lower, upper


def _bound(name: str, names: tuple[str, ...], values: Any) -> NDArray[np.float64]:
    array = as_array(name, values)
    if array.shape != (len(names),):
        raise InputError(
            f"{name}: expected {len(names)} numbers ({', '.join(names)}), found an array of shape "
            f"{array.shape}"
        )
    if np.isnan(array).any():
        parameter = names[int(np.argmax(np.isnan(array)))]
        raise InputError(
            f"{name}: expected numbers, or infinity without a bound, found nan ({parameter})"
        )
    return array
