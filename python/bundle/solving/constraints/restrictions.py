"""Restrictions of the parameters of a solve, as arrays for the core, with bounds of cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_array, check_type, freeze
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.problem_keys import ProblemKeys, parameter_names

if TYPE_CHECKING:
    from bundle.solving.constraints.ends import Applied


@dataclass(frozen=True, eq=False)
class Restrictions:
    """Bounds, constants and ties. An attribute is None if the problem has nothing of its kind."""

    bounds: CameraBounds | None = None  # bounds of camera parameters
    # (num_cameras,) bit j is set if parameter j is constant
    held_camera_params: NDArray[np.uint32] | None = None
    # (num_images,) bits of the constant parts of a pose
    held_pose_parts: NDArray[np.uint8] | None = None
    # index of the shared number of each parameter, or -1; in the shape of ``Problem.camera_params``
    camera_tie: NDArray[np.int32] | None = None
    # ratio of each parameter to its shared number
    camera_tie_scale: NDArray[np.float64] | None = None
    num_ties: int = 0  # number of shared numbers

    @property
    def lower(self) -> NDArray[np.float64] | None:
        """Lower bounds in the shape of ``Problem.camera_params``."""
        return None if self.bounds is None else self.bounds.lower

    @property
    def upper(self) -> NDArray[np.float64] | None:
        """Upper bounds in the shape of ``Problem.camera_params``."""
        return None if self.bounds is None else self.bounds.upper

    @staticmethod
    def make(
        problem: Problem, bounds: Mapping[Any, Any] | None, applied: Applied | None
    ) -> Restrictions | None:
        """Return the restrictions of a problem; None without any restriction."""
        limits = None if bounds is None else CameraBounds.make(problem, bounds)
        if applied is None:
            return None if limits is None else Restrictions(bounds=limits)
        camera_row = {key: row for row, key in enumerate(problem.camera_ids.tolist())}
        if applied.bounds:
            limits = CameraBounds.make(problem, {}) if limits is None else limits
            limits = limits.tightened(
                {(camera_row[key], j): pair for (key, j), pair in applied.bounds.items()}
            )
        parts: dict[str, Any] = {}
        if applied.held_params:
            held = np.zeros(problem.num_cameras, np.uint32)
            for key, columns in applied.held_params.items():
                held[camera_row[key]] = sum(1 << j for j in columns)
            parts["held_camera_params"] = freeze(held)
        if applied.held_poses:
            image_row = {key: row for row, key in enumerate(problem.image_ids.tolist())}
            poses = np.zeros(problem.num_images, np.uint8)
            for key, bits in applied.held_poses.items():
                poses[image_row[key]] = bits
            parts["held_pose_parts"] = freeze(poses)
        if applied.ties:
            tie = np.full(problem.camera_params.shape, -1, np.int32)
            scale = np.ones(problem.camera_params.shape)
            for number, one in enumerate(applied.ties):
                for key, j, times in one.members:
                    tie[camera_row[key], j] = number
                    scale[camera_row[key], j] = times
            parts |= {"camera_tie": freeze(tie), "camera_tie_scale": freeze(scale)}
            parts["num_ties"] = len(applied.ties)
        return Restrictions(bounds=limits, **parts)

    def check_start(self, problem: Problem) -> None:
        """Check that a problem starts within the restrictions.

        The problem must have the structure for which the restrictions were made.
        """
        if self.bounds is not None:
            self.bounds.check_start(problem)
        if self.camera_tie is None or self.camera_tie_scale is None:
            return
        number: dict[int, tuple[int, float]] = {}
        for camera, j in np.argwhere(self.camera_tie >= 0).tolist():
            u = problem.camera_params[camera, j] / self.camera_tie_scale[camera, j]
            first, expected = number.setdefault(int(self.camera_tie[camera, j]), (camera, u))
            if abs(u - expected) > 1e-12 * abs(expected):
                names = parameter_names("constraints", problem, camera)
                raise InputError(
                    f"constraints: camera {problem.camera_ids[camera]}: {names[j]}: expected the "
                    f"value of camera {problem.camera_ids[first]}, with which it is shared, found "
                    f"{problem.camera_params[camera, j]:.10g}"
                )

    def active(self, problem: Problem) -> tuple[ActiveBound, ...]:
        """Return the active bounds: those that parameters of the problem have reached."""
        return () if self.bounds is None else self.bounds.active(problem)


ActiveBound = tuple[tuple[str, int], str, str]
"""Tuple of a camera's key, a parameter's name, and "lower" or "upper"."""

_SIDES = ("lower", "upper")


@dataclass(frozen=True, eq=False)
class CameraBounds:
    """Bounds of every camera parameter of a problem."""

    # (num_cameras, width) as in ``Problem.camera_params``; -inf without a lower bound
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]  # upper bounds in the same shape; inf without an upper bound

    @staticmethod
    def make(problem: Problem, bounds: Any) -> CameraBounds:
        """Check bounds given as {("camera", id): (lower, upper)} and return them."""
        check_type("bounds", bounds, Mapping, 'a mapping {("camera", id): (lower, upper)}')
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
        """Return the bounds combined with others, by camera index and column: the tighter ones."""
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
        raise InputError(f"{name}: expected numbers (infinity: no bound), found nan ({parameter})")
    return array
