"""Jacobians of factors against finite differences, by the general checker of residuals.

A factor's Jacobian J at X is with respect to the tangent coordinates at X. At each sample X, the
checker gets the residual as a function of s, evaluated at X Exp(s - c) with a constant c. The
Jacobian of this function at s = c is J itself, including any mistake. Euclidean variables are
passed unchanged.

The checker's first steps are proportional to the size of a parameter, so that a parameter must not
be zero. Therefore c is 1 for an angle. For a translation, c is the length of the variable's
translation, or 1 if this length is zero.

Common mistakes are derivatives with respect to other tangent coordinates. A variable X moves by
delta to X Exp(delta). A derivative with respect to another motion d is J M with delta = M d. With R
and t the rotation and translation of X:

- Exp(d) X: X^-1 Exp(d) X = Exp(Ad(X)^-1 d), so M = Ad(X)^-1;
- t + d, in the frame of the world: M = R^T for the translation, as for Exp(d) R of the rotation;
- translation and rotation in the other order: M is a permutation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.display import Display, Displayed
from bundle.base.words import plural
from bundle.checking.columns import Block
from bundle.checking.function import UserFunction
from bundle.checking.gradient_report import GradientReport
from bundle.checking.manifolds import Manifold
from bundle.checking.residual_blocks import Layout, sample
from bundle.checking.sample_check import SamplePoint, check_samples
from bundle.errors import InputError, brief, check_keywords
from bundle.graphs.factors.variables import Array, Variable
from bundle.interface.check_options import TOLERANCE
from bundle.interface.option_fields import number
from bundle.model.rotations import rotation_matrices

__all__ = ["FactorCheck", "check_each", "other_coordinates"]


Conventions = dict[tuple[str, str], Array]

_LEFT = "left for right perturbation: derivative by d of Exp(d) X, not of X Exp(d)"
_WORLD = "translation in the world frame: t + d instead of t + R d (R is missing)"
_BOTH = (
    "left for right perturbation of rotation and translation: derivative by d of Exp(d) R and t + d"
)
_TURN = "left for right perturbation of the rotation: Exp(d) R instead of R Exp(d)"
_ORDER = "wrong order: {} first"


def other_coordinates(manifold: str, values: Array) -> Conventions:
    """Return kind, description and M (K, d, d) of each wrong convention at the values (K, n)."""
    return _MANIFOLDS[manifold](values) if manifold in _MANIFOLDS else {}


def _so3(values: Array) -> Conventions:
    return {("perturbation", _LEFT): _turned(values)}


def _se3(values: Array) -> Conventions:
    back, t = _turned(values[:, :4]), values[:, 4:]
    one = np.broadcast_to(np.eye(3), back.shape)
    skew = np.cross(t[:, None, :], np.eye(3)).transpose(0, 2, 1)
    left = _blocks(back, back)
    left[:, 3:, :3] = -back @ skew
    plain = {
        ("perturbation", _LEFT): left,
        ("frame", _WORLD): _blocks(one, back),
        ("perturbation", _BOTH): _blocks(back, back),
        ("perturbation", _TURN): _blocks(back, one),
    }
    return _also_reordered(plain, [3, 4, 5, 0, 1, 2], "translation")


def _se2(values: Array) -> Conventions:
    cosine, sine = np.cos(values[:, 2]), np.sin(values[:, 2])
    back = np.array([[cosine, sine], [-sine, cosine]]).transpose(2, 0, 1)
    world = np.zeros((len(values), 3, 3))
    world[:, :2, :2] = back
    world[:, 2, 2] = 1
    left = world.copy()
    across = np.stack([-values[:, 1], values[:, 0]], axis=1)
    left[:, :2, 2] = (back @ across[..., None])[..., 0]
    return _also_reordered(
        {("perturbation", _LEFT): left, ("frame", _WORLD): world}, [2, 0, 1], "angle"
    )


def _also_reordered(plain: Conventions, order: list[int], first: str) -> Conventions:
    """Add the same conventions with reordered columns: new column j is old column order[j]."""
    size = len(order)
    count = len(next(iter(plain.values())))
    words = _ORDER.format(first)
    right = np.broadcast_to(np.eye(size), (count, size, size))
    moved: Conventions = {("order", words): right[..., order]}
    for (kind, what), matrix in plain.items():
        moved[kind, f"{what}; and {words}"] = matrix[..., order]
    return plain | moved


def _turned(quaternions: Array) -> Array:
    """Return R^T (K, 3, 3)."""
    back: Array = rotation_matrices(quaternions).transpose(0, 2, 1)
    return back


def _blocks(first: Array, second: Array) -> Array:
    matrices = np.zeros((len(first), 6, 6))
    matrices[:, :3, :3], matrices[:, 3:, 3:] = first, second
    return matrices


_MANIFOLDS: dict[str, Callable[[Array], Conventions]] = {"so3": _so3, "se2": _se2, "se3": _se3}


_SETTINGS = {"num_samples": 3, "radius": 0.1, "seed": 0, "tolerance": TOLERANCE}
"""Default settings of the check."""

FactorFunction = Callable[[list[Array]], tuple[Array, list[Array]] | None]


@dataclass(frozen=True, eq=False, repr=False)
class FactorCheck(Displayed):
    """Result of a check of factors. True if every Jacobian is right.

    Attributes:
        reports: one report per factor, by its name in the graph.
    """

    reports: Mapping[str, GradientReport]

    @property
    def ok(self) -> bool:
        """True if the verdict is "correct"."""
        return self.verdict == "correct"

    @property
    def verdict(self) -> str:
        """Worst verdict of the factors: "wrong", "undecided" or "correct"."""
        found = {report.verdict for report in self.reports.values()}
        return next((name for name in ("wrong", "undecided") if name in found), "correct")

    def __bool__(self) -> bool:
        return self.ok

    @property
    def wrong(self) -> dict[str, GradientReport]:
        """Reports of the factors with a wrong Jacobian."""
        return self._with_verdict("wrong")

    @property
    def undecided(self) -> dict[str, GradientReport]:
        """Reports of the factors without a verdict."""
        return self._with_verdict("undecided")

    def _with_verdict(self, verdict: str) -> dict[str, GradientReport]:
        return {name: r for name, r in self.reports.items() if r.verdict == verdict}

    def __str__(self) -> str:
        parts = [repr(self).splitlines()[0]]
        for name, report in (self.wrong | self.undecided).items():
            parts.append(f"{name}\n{report}")
        return "\n\n".join(parts)

    def _display(self) -> Display:
        wrong, undecided = self.wrong, self.undecided
        verdict = f"{len(wrong)} with wrong Jacobians" if wrong else "all Jacobians right"
        if undecided:
            verdict = f"{verdict}, " if wrong else ""
            verdict += f"{len(undecided)} undecided"
        facts = [
            (name, ", ".join(sorted(report.kinds)))
            for name, report in list((wrong | undecided).items())[:10]
        ]
        return Display(
            title=f"FactorCheck: {plural(len(self.reports), 'factor')}, {verdict}",
            facts=tuple(facts),
        )


def check_each(
    factors: Sequence[tuple[str, list[Variable], FactorFunction]], settings: Mapping[str, Any]
) -> FactorCheck:
    """Check factors, given by name, variables and function of their values.

    Raises:
        InputError: a setting does not exist or is out of range.
    """
    check_keywords("check_gradients", settings, {name: name for name in _SETTINGS})
    given = dict(_SETTINGS) | dict(settings)
    num_samples = number("num_samples", given["num_samples"], minimum=1, whole=True)
    radius = number("radius", given["radius"], minimum=0)
    seed = number("seed", given["seed"], minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", given["tolerance"], above=0)
    reports = {}
    for name, variables, function in factors:
        rng = np.random.default_rng(seed)
        values = [[variable.value for variable in variables]]
        for _ in range(num_samples - 1):
            values.append([_sample(variable, radius, rng) for variable in variables])
        points: list[SamplePoint] = []
        for at in values:
            size = points[0].user.num_residuals if points else 0
            here = _InTangentCoordinates(name, variables, at, function, size)
            points.append(SamplePoint(UserFunction(here, here.origins, size), here.origins))
        reports[name] = check_samples(points, _layout(variables, values), tolerance=tolerance)
    return FactorCheck(reports)


# Slices of the translation in the value and in the tangent coordinates.
_TRANSLATIONS = {"se2": (slice(0, 2), slice(0, 2)), "se3": (slice(4, 7), slice(3, 6))}


def _sample(variable: Variable, radius: float, rng: np.random.Generator) -> Array:
    """Return a sample near the value of a variable."""
    if variable.manifold == "euclidean":
        return sample(Manifold.parse(None, len(variable.value)), variable.value, radius, rng)
    step = (
        radius * _origin(variable, variable.value) * rng.standard_normal(len(variable.coordinates))
    )
    return _core.retract(variable.manifold, variable.value, step)


def _origin(variable: Variable, value: Array) -> Array:
    """Return the checker's parameters: the value, or the c at which the step is zero."""
    if variable.manifold == "euclidean":
        return value
    origin = np.ones(len(variable.coordinates))
    if variable.manifold in _TRANSLATIONS:
        stored, tangent = _TRANSLATIONS[variable.manifold]
        length = float(np.linalg.norm(value[stored]))
        if length > 0 and np.isfinite(length):
            origin[tangent] = length
    return origin


def _layout(variables: Sequence[Variable], values: Sequence[Sequence[Array]]) -> Layout:
    """Return names, and parameter blocks with the other conventions of their coordinates."""
    names = [
        (brief(v.key), [f"{brief(v.key)} {coordinate}" for coordinate in v.coordinates])
        for v in variables
    ]
    layout = Layout.make([_origin(v, v.value) for v in variables], None, names)
    blocks: list[Block] = []
    for b, (variable, whole) in enumerate(zip(variables, layout.blocks, strict=True)):
        if variable.manifold == "euclidean":
            blocks.append(whole)
            continue
        other = other_coordinates(variable.manifold, np.array([at[b] for at in values]))
        turns = "tangent" if variable.manifold == "so3" else ""
        blocks.append(replace(whole, rotation=turns, conventions=other))
        if variable.manifold in _TRANSLATIONS:
            part = _TRANSLATIONS[variable.manifold][1]
            begin, end = whole.start + part.start, whole.start + part.stop
            blocks.append(Block(f"{whole.name} translation", begin, end))
        if variable.manifold == "se3":
            blocks.append(Block(f"{whole.name} rotation", whole.start, whole.start + 3, "tangent"))
    is_step = [v.manifold != "euclidean" for v in variables for _ in v.coordinates]
    return replace(layout, blocks=blocks, is_step=np.array(is_step))


class _InTangentCoordinates:
    """Factor as a function of steps of its variables from given values."""

    def __init__(
        self,
        name: str,
        variables: list[Variable],
        values: list[Array],
        function: FactorFunction,
        num_residuals: int,
    ) -> None:
        self.name, self.variables, self.values, self.function = name, variables, values, function
        self.origins = [_origin(v, x) for v, x in zip(variables, values, strict=True)]
        self.num_residuals = num_residuals

    def __call__(self, blocks: list[Array]) -> tuple[Array, list[Array]]:
        values = [
            block
            if variable.manifold == "euclidean"
            else _core.retract(variable.manifold, value, block - origin)
            for variable, value, origin, block in zip(
                self.variables, self.values, self.origins, blocks, strict=True
            )
        ]
        answer = self.function(values)
        if answer is not None:
            self.num_residuals = len(answer[0])
            return answer
        if not self.num_residuals:
            raise InputError(f"{self.name}: the residual has no value at the start")
        shape = self.num_residuals
        return np.full(shape, np.nan), [np.full((shape, len(b)), np.nan) for b in blocks]
