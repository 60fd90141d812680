"""Factors beside the observations of a reconstruction: their keys name its images, cameras, points.

========================  =========  ===========================================
key                       manifold   value
========================  =========  ===========================================
``("image", image_id)``   se3        cam_from_world: qx qy qz qw tx ty tz
``("camera", camera_id)`` euclidean  the camera's parameters, in COLMAP's order
``("point", point_id)``   euclidean  x y z
========================  =========  ===========================================
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bundle.cameras import camera_models
from bundle.errors import InputError, brief
from bundle.graph.factor_graph import FactorGraph
from bundle.graph.factors import Factor
from bundle.graph.variables import Array, Key, as_list
from bundle.problem import Problem

__all__ = ["ProblemFactors"]

_KINDS = ("image", "camera", "point")


class ProblemFactors:
    """Factors whose variables are those of a problem, checked.

    Raises:
        InputError: these are no factors, a key names nothing of the problem, or a factor does not
            fit its variables.
    """

    def __init__(self, problem: Problem, factors: Iterable[Factor]) -> None:
        self._problem = problem
        self._indices: dict[str, dict[int, int]] = {}
        self._graph = FactorGraph()
        self._places: list[tuple[str, int]] = []
        for position, factor in enumerate(as_list("factors", "factors", factors)):
            if not isinstance(factor, Factor):
                raise InputError(
                    f"factors: expected factors such as PriorFactor, found {brief(factor)} "
                    f"at [{position}]"
                )
            for key in factor.keys:
                self._add(f"factor {position}, {factor.name}", key)
            self._graph.add_factor(factor)

    @property
    def locate(self) -> bool:
        """Whether some of them say where images or points are."""
        return any(kind != "camera" for kind, _ in self._places)

    def core(self) -> tuple[list[Any], list[Any], list[tuple[str, int]]] | None:
        """Return what ``_core.solve`` takes: variables, factors and what the variables are."""
        if not self._graph.factors:
            return None
        return (*self._graph.core(), self._places)

    def _add(self, name: str, key: Key) -> None:
        kind, index = self._find(name, key)
        if key in self._graph.values:
            return
        value, manifold = self._value(name, kind, index)
        self._graph.add_variable(key, value, manifold)
        self._places.append((kind, index))

    def _find(self, name: str, key: Key) -> tuple[str, int]:
        if (
            not isinstance(key, tuple)
            or len(key) != 2
            or key[0] not in _KINDS
            or isinstance(key[1], bool)
            or not isinstance(key[1], int | np.integer)
        ):
            raise InputError(
                f"{name}: expected ('image', id), ('camera', id) or ('point', id) for a variable, "
                f"found {brief(key)}"
            )
        kind, number = key
        if kind not in self._indices:
            ids = getattr(self._problem, f"{kind}_ids").tolist()
            self._indices[kind] = {known: index for index, known in enumerate(ids)}
        index = self._indices[kind].get(int(number))
        if index is None:
            raise InputError(f"{name}: there is no {kind} {number} in the problem")
        return kind, index

    def _value(self, name: str, kind: str, index: int) -> tuple[Array, str]:
        problem = self._problem
        if kind == "image":
            return problem.cam_from_world[index], "se3"
        if kind == "point":
            return problem.points[index], "euclidean"
        model = problem.camera_models[index]
        parameters = camera_models().get(model)
        if parameters is None:
            raise InputError(
                f"{name}: camera {problem.camera_ids[index]}: model {model} is not supported"
            )
        return problem.camera_params[index, : len(parameters)], "euclidean"
