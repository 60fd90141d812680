"""Restrictions of the parameters of a solve, as arrays for the core."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.problem_keys import parameter_names
from bundle.solving.constraints.camera_bounds import ActiveBound, CameraBounds

if TYPE_CHECKING:
    from bundle.solving.constraints.applied import Applied


@dataclass(frozen=True, eq=False)
class Restrictions:
    """Bounds, constants and ties. An attribute is None if the problem has nothing of its kind.

    Attributes:
        bounds: bounds of camera parameters.
        held_camera_params: (num_cameras,) bit j is set if parameter j is constant.
        held_pose_parts: (num_images,) bits of the constant parts of a pose.
        camera_tie: index of the shared number of each parameter, or -1; in the shape of
            ``Problem.camera_params``.
        camera_tie_scale: ratio of each parameter to its shared number.
        num_ties: number of shared numbers.
    """

    bounds: CameraBounds | None = None
    held_camera_params: NDArray[np.uint32] | None = None
    held_pose_parts: NDArray[np.uint8] | None = None
    camera_tie: NDArray[np.int32] | None = None
    camera_tie_scale: NDArray[np.float64] | None = None
    num_ties: int = 0

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
        """Return the restrictions of a problem; None without any restriction.

        Raises:
            InputError: for the reasons of :meth:`CameraBounds.make`.
        """
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

        Raises:
            InputError: a parameter is not between its bounds, or tied parameters are not multiples
                of one number.
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
