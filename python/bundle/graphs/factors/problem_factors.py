"""Factors of a reconstruction in addition to its observations, with keys for its variables.

=====================================  =========  ===========================================
key                                    manifold   value
=====================================  =========  ===========================================
``("image", image_id)``                se3        cam_from_world: qx qy qz qw tx ty tz
``("frame", frame_id)``                se3        rig_from_world, the same numbers
``("sensor", (rig_id, camera_id))``    se3        sensor_from_rig, the same numbers
``("camera", camera_id)``              euclidean  the camera's parameters, in COLMAP's order
``("point", point_id)``                euclidean  x y z
``("twist", image_id)``                euclidean  motion per frame height of a rolling shutter
``("readout", camera_id)``             euclidean  readout of a rolling shutter
=====================================  =========  ===========================================

A factor of an image of a rig constrains its frame, and its sensor if that is refined.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_type
from bundle.errors import InputError, brief
from bundle.graphs.factors.check_solve import spot_checked, time_for_checks
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import Array, Key, as_list
from bundle.model.estimates import POSE_WIDTH, SHUTTER, estimates, kinds, variable_of
from bundle.model.problem import Problem
from bundle.model.problem_keys import ProblemKeys, parameter_names

_WITHOUT_SCALE = ("twist_tie", "direction", "rotation", "heading")
"""Kinds of factors whose cost does not rise if the scale changes."""

ADVICE = "bundle.check_factors(problem, factors)"


def check_factors(problem: Problem, factors: Iterable[Factor], **settings: Any) -> FactorCheck:
    """Check the Jacobians of factors of :func:`bundle.solve` as ``check_gradients`` does.

    Args:
        problem: problem at whose values to check; not modified.
        factors: factors as in :func:`bundle.solve`.
        **settings: settings of :meth:`bundle.FactorGraph.check_gradients`.

    Returns:
        Report that is true if all Jacobians are right, and readable when printed.

    Raises:
        InputError: the argument is not a list of factors, a key is not in the problem, a factor
            does not fit its variables, or a function returns wrong shapes.
    """
    check_type("problem", problem, Problem)
    return ProblemFactors(problem, factors).graph.check_gradients(**settings)


def wrong_factor(start: Problem, factors: Iterable[Factor], output: Mapping[str, Any]) -> str:
    """Return a warning about a function whose Jacobian is wrong; "" without any."""
    factors = list(factors)
    known = ProblemFactors(start, [factor for factor in factors if factor.kind == "function"])
    if not known.factors:
        return ""
    ends = known.values_in(output)
    variables = {
        key: variable.holding(_stayed(variable.value, ends[key], variable.manifold))
        for key, variable in known.graph.variables.items()
    }
    if output["summary"]["num_successful_steps"] <= 1:  # no step was accepted
        variables = dict(known.graph.variables)
    seconds = time_for_checks(output)
    return spot_checked(output, factors, variables, ends, seconds, ADVICE)


def _stayed(start: Array, end: Array, manifold: str) -> NDArray[np.bool_]:
    """Return the mask of numbers that a solve held constant and that must not be checked."""
    same = np.abs(end - start) <= 1e-12 * np.abs(start).max(initial=1e-300)
    return same if manifold == "euclidean" else np.full(6, same.all())


class ProblemFactors:
    """Checked factors whose variables are those of a problem."""

    def __init__(self, problem: Problem, factors: Iterable[Factor]) -> None:
        self._problem, self._values = problem, estimates(problem)
        known = kinds() if problem.rolling_shutter is None else (*kinds(), *kinds(SHUTTER))
        self._keys = ProblemKeys(problem, known, "variable")
        self.graph = FactorGraph()  # factors and variables, at the problem's values
        self._places: list[tuple[str, int]] = []
        for position, factor in enumerate(as_list("factors", "factors", factors)):
            if not isinstance(factor, Factor):
                raise InputError(
                    f"factors: expected factors such as PriorFactor, found {brief(factor)} "
                    f"at [{position}]"
                )
            for key in factor.keys:
                self._add(f"factor {position}, {factor.name}", key)
            self.graph.add_factor(factor)

    def values_in(self, output: Mapping[str, Any]) -> dict[Key, Array]:
        """Return the values of the variables in the output of the core's solver, by key."""
        return {
            key: np.atleast_1d(np.asarray(output[variable_of(kind).name])[index])[: len(value)]
            for (kind, index), (key, value) in zip(
                self._places, self.graph.values.items(), strict=True
            )
        }

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Factors in the order given."""
        return self.graph.factors

    @property
    def locate(self) -> bool:
        """True if some factors determine positions of images or points, or their rotations."""
        return any(kind != "twist_tie" for kind in self._kinds_on_scene())

    @property
    def holds_scale(self) -> bool:
        """True if factors may determine the scale: others than attitudes, ties and one position."""
        kinds = [kind for kind in self._kinds_on_scene() if kind not in _WITHOUT_SCALE]
        return len(kinds) > 1 or (len(kinds) == 1 and kinds != ["position"])

    def _kinds_on_scene(self) -> list[str]:
        """Return the kinds of the factors that depend on more than cameras."""
        kinds: dict[Key, str] = {
            key: kind for key, (kind, _) in zip(self.graph.keys, self._places, strict=True)
        }
        return [
            factor.kind
            for factor in self.factors
            if any(kinds[key] != "camera" for key in factor.keys)
        ]

    def information(self) -> tuple[list[tuple[str, int, int]], Array]:
        """Return kind, index and tangent size of the variables, and the factors' information.

        The information matrix (n, n) is in the variables' tangent coordinates, n the sum of their
        sizes; see :meth:`bundle.FactorGraph.information`.
        """
        values = self.graph.values
        variables = [
            (kind, index, variable_of(kind).tangent or len(values[key]))
            for (kind, index), key in zip(self._places, self.graph.keys, strict=True)
        ]
        return variables, self.graph.information()[0]

    def core(self) -> tuple[list[Any], list[Any], list[tuple[str, int]]] | None:
        """Return arguments of ``_core.solve``: variables, factors, and ids of the variables."""
        if not self.graph.factors:
            return None
        return (*self.graph.core(), self._places)

    def _add(self, name: str, key: Key) -> None:
        kind, index = self._keys.find(name, key)
        if key in self.graph.values:
            return
        value, manifold = self._value(name, kind, index)
        self.graph.add_variable(key, value, manifold)
        self._places.append((kind, index))

    def _value(self, name: str, kind: str, index: int) -> tuple[Array, str]:
        of = variable_of(kind)
        value = np.atleast_1d(self._values[of.name][index])
        if kind == "camera":
            value = value[: len(parameter_names(name, self._problem, index))]
        return value, "se3" if of.width == POSE_WIDTH else "euclidean"
