"""Jacobians of factors against differences, by the checker for any residual.

A factor's Jacobian J at X is by the tangent coordinates at X. The checker is given the residual as
a function of s, the value being X Exp(s - c) with a constant c: its Jacobian there is J times the
right Jacobian of the manifold at s - c. Euclidean variables are given to it as they are.

The checker takes the size of a parameter for its scale: it makes its first steps in proportion, and
finds out what rounding does to a residual by changing the parameter's last digits. A parameter that
is zero has neither. So c is 1 for an angle, and for a translation the length of the variable's own
(1 if that is zero).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bundle import _core
from bundle.checking import GradientReport, check_gradients
from bundle.display import Display, Displayed
from bundle.errors import InputError, brief, check_keywords
from bundle.graph.variables import Array, Variable
from bundle.words import plural

__all__ = ["FactorCheck", "check_factors"]

_SETTINGS = {name: name for name in ("num_samples", "radius", "seed", "tolerance")}
_NUM_SAMPLES = 3

FactorFunction = Callable[[list[Array]], tuple[Array, list[Array]] | None]


@dataclass(frozen=True, eq=False, repr=False)
class FactorCheck(Displayed):
    """What a check of factors found. True if every Jacobian is right.

    Attributes:
        reports: one a factor, by its name in the graph.
    """

    reports: Mapping[str, GradientReport]

    @property
    def ok(self) -> bool:
        """Whether all is well."""
        return all(report.ok for report in self.reports.values())

    def __bool__(self) -> bool:
        return self.ok

    @property
    def wrong(self) -> dict[str, GradientReport]:
        """The reports of the factors with which something is wrong."""
        return {name: report for name, report in self.reports.items() if not report.ok}

    def __str__(self) -> str:
        parts = [repr(self).splitlines()[0]]
        parts += [f"{name}\n{report}" for name, report in self.wrong.items()]
        return "\n\n".join(parts)

    def _display(self) -> Display:
        wrong = self.wrong
        verdict = f"{len(wrong)} with wrong Jacobians" if wrong else "all Jacobians right"
        facts = [
            (name, ", ".join(sorted(report.kinds)) or "wrong")
            for name, report in list(wrong.items())[:10]
        ]
        return Display(
            title=f"FactorCheck: {plural(len(self.reports), 'factor')}, {verdict}",
            facts=tuple(facts),
        )


def check_factors(
    factors: Sequence[tuple[str, list[Variable], FactorFunction]], settings: Mapping[str, Any]
) -> FactorCheck:
    """Check factors, given by name, variables and function of their values.

    Raises:
        InputError: a setting does not exist or is out of range.
    """
    check_keywords("check_gradients", settings, _SETTINGS)
    given = {"num_samples": _NUM_SAMPLES, **settings}
    reports = {}
    for name, variables, function in factors:
        reports[name] = check_gradients(
            _InTangentCoordinates(name, variables, function),
            [_origin(variable) for variable in variables],
            names=[
                (brief(v.key), [f"{brief(v.key)} {coordinate}" for coordinate in v.coordinates])
                for v in variables
            ],
            **given,
        )
    return FactorCheck(reports)


# Of the value and of the tangent coordinates: where the translation is.
_TRANSLATIONS = {"se2": (slice(0, 2), slice(0, 2)), "se3": (slice(4, 7), slice(3, 6))}


def _origin(variable: Variable) -> Array:
    """Return where the checker starts: the value, or the c at which the step is zero."""
    if variable.manifold == "euclidean":
        return variable.value
    origin = np.ones(len(variable.coordinates))
    if variable.manifold in _TRANSLATIONS:
        stored, tangent = _TRANSLATIONS[variable.manifold]
        length = float(np.linalg.norm(variable.value[stored]))
        if length > 0 and np.isfinite(length):
            origin[tangent] = length
    return origin


class _InTangentCoordinates:
    """The factor as a function of the steps that its variables take from their values."""

    def __init__(self, name: str, variables: list[Variable], function: FactorFunction) -> None:
        self.name, self.variables, self.function = name, variables, function
        self.origins = [_origin(variable) for variable in variables]
        self.num_residuals = 0

    def __call__(self, blocks: list[Array]) -> tuple[Array, list[Array]]:
        values: list[Array] = []
        chains: list[Array | None] = []
        for variable, origin, block in zip(self.variables, self.origins, blocks, strict=True):
            if variable.manifold == "euclidean":
                values.append(block)
                chains.append(None)
            else:
                step = block - origin
                values.append(_core.retract(variable.manifold, variable.value, step))
                chains.append(_core.right_jacobian(variable.manifold, variable.value, step))
        answer = self.function(values)
        if answer is None:
            if not self.num_residuals:
                raise InputError(f"{self.name}: the residual has no value at the start")
            shape = self.num_residuals
            return np.full(shape, np.nan), [np.full((shape, len(b)), np.nan) for b in blocks]
        residual, jacobians = answer
        self.num_residuals = len(residual)
        return residual, [
            jacobian if chain is None else jacobian @ chain
            for jacobian, chain in zip(jacobians, chains, strict=True)
        ]
