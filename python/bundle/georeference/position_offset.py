"""Unknown offset that measured positions have in common, as a variable of a solve.

Heights of GPS are above the ellipsoid, those of control points often above the sea: they differ by
the same amount everywhere in a block. With the offset o, the antenna at c_i + R_i^T a and the
measured position p_i,

    r_i = L_i^-1 (c_i + R_i^T a + A o - p_i),    A = diag(0, 0, 1) for "up", I for "all".

o is an unknown like all others: it is the translation of a pose without observations, the last
image of the solve. The rotation of this pose, and the coordinates that A leaves out, have no
influence; priors at their start keep them there and cost nothing. Control points, which have no
offset, determine o.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.vector_priors import UNKNOWN
from bundle.graphs.factors.factors import Factor, PositionFactor
from bundle.graphs.factors.image_factors import RotationFactor
from bundle.interface.georeference_options import OFFSET_AXES
from bundle.model.problem import Problem

LARGEST_ID = 2**63 - 1

HELD = 1e16
"""Information of the rotation: its uncertainty must not show in that of the offset."""

_IDENTITY = (0.0, 0.0, 0.0, 1.0)
_OF_IMAGES = ("cam_from_world", "image_ids", "image_camera", "image_frame", "image_sensor")


@dataclass(frozen=True)
class PositionOffset:
    """Offset of the positions of a solve."""

    image_id: int  # id of the pose in the solve
    axes: str  # "up" or "all"

    @staticmethod
    def beside(problem: Problem, axes: str) -> PositionOffset:
        """Return an offset whose pose has an unused id.

        Raises:
            InputError: the problem has the largest possible id.
        """
        last = int(problem.image_ids.max(initial=0))
        if last >= LARGEST_ID:
            raise InputError(f"image_ids: expected ids below {LARGEST_ID} with an offset")
        return PositionOffset(last + 1, axes)

    @property
    def key(self) -> tuple[str, int]:
        """Key of the pose."""
        return ("image", self.image_id)

    def added_to(self, problem: Problem, start: NDArray[np.float64]) -> Problem:
        """Return the problem with the pose as its last image, at a start (3,) of the offset."""
        value = np.array(OFFSET_AXES[self.axes]) * start
        fields = {
            "cam_from_world": [*_IDENTITY, *value],
            "image_ids": self.image_id,
            "image_camera": problem.image_camera[0],
            "image_frame": -1,
            "image_sensor": -1,
        }
        has_rigs = len(problem.image_frame) > 0
        changes: dict[str, Any] = {
            name: np.concatenate([getattr(problem, name), np.array([row])])
            for name, row in fields.items()
            if has_rigs or name not in _OF_IMAGES[3:]
        }
        shutter = problem.rolling_shutter
        if shutter is not None:
            frames, neighbours = shutter.frames, shutter.neighbours
            changes["rolling_shutter"] = dataclasses.replace(
                shutter,
                twist=np.concatenate([shutter.twist, np.zeros((1, 6))]),
                frames=None if frames is None else np.append(frames, np.nan),
                neighbours=None
                if neighbours is None
                else np.concatenate([neighbours, np.array([[-1, -1]], np.int32)]),
            )
        return problem.replace(image_names=(*problem.image_names, ""), **changes)

    def taken_from(self, problem: Problem) -> Problem:
        """Return a solved or filtered problem of :meth:`added_to` without the pose."""
        has_rigs = len(problem.image_frame) > 0
        names = _OF_IMAGES if has_rigs else _OF_IMAGES[:3]
        changes: dict[str, Any] = {name: getattr(problem, name)[:-1] for name in names}
        shutter = problem.rolling_shutter
        if shutter is not None:
            frames, neighbours = shutter.frames, shutter.neighbours
            changes["rolling_shutter"] = dataclasses.replace(
                shutter,
                twist=shutter.twist[:-1],
                frames=None if frames is None else frames[:-1],
                neighbours=None if neighbours is None else neighbours[:-1],
            )
        return problem.replace(image_names=problem.image_names[:-1], **changes)

    def factors(self) -> list[Factor]:
        """Return the priors of the coordinates without influence; they cost nothing."""
        held: list[Factor] = [RotationFactor(self.key, _IDENTITY, HELD)]
        if self.axes == "up":
            information = np.diag([1.0, 1.0, UNKNOWN**-2])
            held.append(PositionFactor(self.key, (0.0, 0.0, 0.0), information))
        return held

    def of(self, factor: PositionFactor, axes: str) -> PositionFactor:
        """Return the factor of a position that has this offset along `axes`."""
        return dataclasses.replace(factor, offset=self.key, axes=OFFSET_AXES[axes])

    def value_in(self, problem: Problem) -> NDArray[np.float64]:
        """Return the offset (3,) in a problem of :meth:`added_to`: position minus model."""
        value: NDArray[np.float64] = problem.cam_from_world[-1, 4:].copy()
        return value
