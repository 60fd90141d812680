"""Factors beside the observations of a reconstruction: their keys name what it consists of.

=====================================  =========  ===========================================
key                                    manifold   value
=====================================  =========  ===========================================
``("image", image_id)``                se3        cam_from_world: qx qy qz qw tx ty tz
``("frame", frame_id)``                se3        rig_from_world, the same numbers
``("sensor", (rig_id, camera_id))``    se3        sensor_from_rig, the same numbers
``("camera", camera_id)``              euclidean  the camera's parameters, in COLMAP's order
``("point", point_id)``                euclidean  x y z
=====================================  =========  ===========================================

A factor of an image of a rig moves its frame, and its sensor where that is refined.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bundle.errors import InputError, brief
from bundle.graph.factor_graph import FactorGraph
from bundle.graph.factors import Factor
from bundle.graph.variables import Array, Key, as_list
from bundle.problem import Problem
from bundle.problem_keys import ProblemKeys, parameter_names

__all__ = ["ProblemFactors"]

KINDS = ("image", "camera", "point", "frame", "sensor")
_POSES = {"image": "cam_from_world", "frame": "rig_from_world", "sensor": "sensor_from_rig"}


class ProblemFactors:
    """Factors whose variables are those of a problem, checked.

    Raises:
        InputError: these are no factors, a key names nothing of the problem, or a factor does not
            fit its variables.
    """

    def __init__(self, problem: Problem, factors: Iterable[Factor]) -> None:
        self._problem = problem
        self._keys = ProblemKeys(problem, KINDS, "variable")
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
    def factors(self) -> tuple[Factor, ...]:
        """They themselves."""
        return self._graph.factors

    @property
    def locate(self) -> bool:
        """Whether some of them say where images or points are."""
        return any(kind != "camera" for kind, _ in self._places)

    def information(self) -> tuple[list[tuple[str, int, int]], Array]:
        """Return kind, index and tangent size of the variables, and what factors know of them.

        The information matrix (n, n) is in the variables' tangent coordinates, n the sum of their
        sizes; see :meth:`bundle.FactorGraph.information`.
        """
        values = self._graph.values
        variables = [
            (kind, index, 6 if kind in _POSES else len(values[key]))
            for (kind, index), key in zip(self._places, self._graph.keys, strict=True)
        ]
        return variables, self._graph.information()[0]

    def core(self) -> tuple[list[Any], list[Any], list[tuple[str, int]]] | None:
        """Return what ``_core.solve`` takes: variables, factors and what the variables are."""
        if not self._graph.factors:
            return None
        return (*self._graph.core(), self._places)

    def _add(self, name: str, key: Key) -> None:
        kind, index = self._keys.find(name, key)
        if key in self._graph.values:
            return
        value, manifold = self._value(name, kind, index)
        self._graph.add_variable(key, value, manifold)
        self._places.append((kind, index))

    def _value(self, name: str, kind: str, index: int) -> tuple[Array, str]:
        problem = self._problem
        if kind in _POSES:
            pose: Array = getattr(problem, _POSES[kind])[index]
            return pose, "se3"
        if kind == "point":
            return problem.points[index], "euclidean"
        parameters = parameter_names(name, problem, index)
        return problem.camera_params[index, : len(parameters)], "euclidean"
