"""Jacobians of factors against finite differences, by the general checker of residuals.

A factor's Jacobian J at X is with respect to the tangent coordinates at X. At each sample X, the
checker gets the residual as a function of s, evaluated at X Exp(s - c) with a constant c. The
Jacobian of this function at s = c is J itself, including any mistake. Euclidean variables are
passed unchanged. For Jacobians in the coordinates of another library, M (s - c) takes the place of
s - c (``variables``).

The checker's first steps are proportional to the size of a parameter, so that a parameter must not
be zero. Therefore c is 1 for an angle. For a translation, c is the length of the variable's
translation, or 1 if this length is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.arrays import as_flag
from bundle.base.records import dataclass
from bundle.checking.function import UserFunction, called
from bundle.checking.residual_blocks import Block, Layout, Manifold, sample
from bundle.checking.sample_check import check_samples
from bundle.checking.step_curve import SamplePoint
from bundle.errors import InputError, brief, check_keywords
from bundle.graphs.factors.contents import GraphContents, factor_name
from bundle.graphs.factors.factor_report import FactorCheck, Member
from bundle.graphs.factors.factors import Factor, FunctionFactor
from bundle.graphs.factors.spot_check import code_of
from bundle.graphs.factors.variables import TANGENTS, Array, Variable, other_coordinates, tangent_of
from bundle.interface.analysis_options import TOLERANCE
from bundle.interface.option_fields import choice, number

_SETTINGS = {
    "num_samples": 3,
    "radius": 0.1,
    "seed": 0,
    "tolerance": TOLERANCE,
    "tangent": "gtsam",
    "details": False,
}
"""Default settings of the check."""

FactorFunction = Callable[[list[Array]], tuple[Array, list[Array]] | None]


@dataclass(frozen=True, eq=False)
class CheckedFactor:
    """Factor to check."""

    name: str  # name of the factor in its graph
    label: str  # name of its kind
    kind: Hashable  # identifier that factors with the same code and the same manifolds share
    variables: Sequence[Variable]  # its variables
    function: FactorFunction  # function of their values
    # True for a function of the user, whose Jacobians are by the tangent coordinates of the
    # settings; the others are by those of a factor graph
    is_own: bool = False


def check_each(
    factors: Iterable[CheckedFactor],
    settings: Mapping[str, Any],
    *,
    num_factors: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> FactorCheck:
    """Check factors of a graph that has ``num_factors``; None: these are all."""
    check_keywords("check_gradients", settings, {name: name for name in _SETTINGS})
    given = dict(_SETTINGS) | dict(settings)
    num_samples = number("num_samples", given["num_samples"], minimum=1, whole=True)
    radius = number("radius", given["radius"], minimum=0)
    seed = number("seed", given["seed"], minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", given["tolerance"], above=0)
    details = as_flag("details", given["details"])
    tangent = choice("tangent", given["tangent"], TANGENTS)
    reports, members = {}, {}
    kinds: dict[Hashable, int] = {}  # numbers, because code cannot be pickled
    for done, factor in enumerate(factors):
        rng = np.random.default_rng(seed)
        values = [[variable.value for variable in factor.variables]]
        for _ in range(num_samples - 1):
            values.append([_sample(variable, radius, rng) for variable in factor.variables])
        by = tangent if factor.is_own else TANGENTS[0]
        layout = _layout(factor.variables, values, by)
        points: list[SamplePoint] = []
        for at in values:
            size = points[0].user.num_residuals if points else 0
            here = _InTangentCoordinates(factor, at, by, size)
            points.append(SamplePoint(UserFunction.at(here, here.origins, size), here.origins))
        reports[factor.name] = check_samples(points, layout, tolerance=tolerance, details=details)
        members[factor.name] = Member(
            kinds.setdefault(factor.kind, len(kinds)),
            factor.label,
            tuple(brief(v.key) for v in factor.variables),
            tuple(
                (column.name, b, column.name.removeprefix(f"{column.group} "))
                for column, b in zip(layout.columns, _owners(factor.variables), strict=True)
            ),
        )
        if progress is not None:
            progress(done + 1)
    return FactorCheck(reports, members, len(reports) if num_factors is None else num_factors)


def _owners(variables: Sequence[Variable]) -> list[int]:
    return [b for b, variable in enumerate(variables) for _ in variable.coordinates]


# Slices of the translation in the value and in the tangent coordinates.
_TRANSLATIONS = {"se2": (slice(0, 2), slice(0, 2)), "se3": (slice(4, 7), slice(3, 6))}


def _sample(variable: Variable, radius: float, rng: np.random.Generator) -> Array:
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


def _order(variable: Variable, tangent: str) -> list[int]:
    if variable.manifold == "euclidean":
        return list(range(len(variable.value)))
    return tangent_of(tangent, variable.manifold).order(variable.manifold)


def _layout(
    variables: Sequence[Variable], values: Sequence[Sequence[Array]], tangent: str
) -> Layout:
    """Return names, and parameter blocks with the other conventions of their coordinates."""
    names = [
        (brief(v.key), [f"{brief(v.key)} {v.coordinates[j]}" for j in _order(v, tangent)])
        for v in variables
    ]
    layout = Layout.make([_origin(v, v.value)[_order(v, tangent)] for v in variables], None, names)
    blocks: list[Block] = []
    for b, (variable, whole) in enumerate(zip(variables, layout.blocks, strict=True)):
        if variable.manifold == "euclidean":
            blocks.append(whole)
            continue
        other = other_coordinates(variable.manifold, np.array([at[b] for at in values]), tangent)
        turns = "tangent" if variable.manifold == "so3" else ""
        blocks.append(replace(whole, rotation=turns, conventions=other))
        if variable.manifold in _TRANSLATIONS:
            part = _TRANSLATIONS[variable.manifold][1]
            begin = whole.start + _order(variable, tangent).index(part.start)
            blocks.append(Block(f"{whole.name} translation", begin, begin + part.stop - part.start))
        if variable.manifold == "se3":
            begin = whole.start + _order(variable, tangent).index(0)
            blocks.append(Block(f"{whole.name} rotation", begin, begin + 3, "tangent"))
    is_step = [v.manifold != "euclidean" for v in variables for _ in v.coordinates]
    return replace(layout, blocks=blocks, is_step=np.array(is_step))


class _InTangentCoordinates:
    """Factor as a function of steps of its variables from given values."""

    def __init__(
        self, factor: CheckedFactor, values: list[Array], tangent: str, num_residuals: int
    ) -> None:
        self.factor, self.values = factor, values
        self.origins = [
            _origin(v, x)[_order(v, tangent)] for v, x in zip(factor.variables, values, strict=True)
        ]
        self.steps = [
            np.eye(len(x))
            if v.manifold == "euclidean"
            else tangent_of(tangent, v.manifold).matrix(v.manifold, x[None])[0]
            for v, x in zip(factor.variables, values, strict=True)
        ]
        self.num_residuals = num_residuals

    def __call__(self, blocks: list[Array]) -> tuple[Array, list[Array]]:
        values = [
            block
            if variable.manifold == "euclidean"
            else _core.retract(variable.manifold, value, step @ (block - origin))
            for variable, value, origin, step, block in zip(
                self.factor.variables, self.values, self.origins, self.steps, blocks, strict=True
            )
        ]
        try:
            answer = self.factor.function(values)
        except Exception as error:
            error.add_note(self.factor.name)
            raise
        if answer is not None:
            self.num_residuals = len(answer[0])
            return answer
        if not self.num_residuals:
            raise InputError(f"{self.factor.name}: the residual has no value at the start")
        shape = self.num_residuals
        return np.full(shape, np.nan), [np.full((shape, len(b)), np.nan) for b in blocks]


def check_graph(
    graph: GraphContents,
    factors: Sequence[Factor],
    most_of_a_kind: int | None,
    progress: Callable[[int], None] | None,
    settings: Mapping[str, Any],
) -> FactorCheck:
    """Check factors of a graph; see :meth:`bundle.FactorGraph.check_gradients`."""
    if most_of_a_kind is not None:
        most_of_a_kind = number("most_of_a_kind", most_of_a_kind, minimum=1, whole=True)
    variables = graph.variables
    kinds = [kind_of(factor, variables) for factor in factors]
    positions = {id(factor): i for i, factor in enumerate(graph.factors)}

    def make(place: int) -> CheckedFactor:
        factor = factors[place]
        name = factor_name(positions[id(factor)], factor)
        own = [variables[key] for key in factor.keys]
        arguments = factor.core_arguments(name, tuple(len(v.coordinates) for v in own))
        is_own = isinstance(factor, FunctionFactor)
        if is_own:
            user, _ = arguments
            user.function = partial(called, name, user.function)
        places = list(range(len(own)))
        given = (factor.kind, name, places, factor.loss, factor.loss_scale, arguments)
        try:
            function = _core.factor_function([variable.core() for variable in own], given)
        except Exception as error:
            error.add_note(name)
            raise
        return CheckedFactor(name, _label(factor), kinds[place], own, function, is_own)

    chosen = choose(kinds, most_of_a_kind)
    return check_each(map(make, chosen), settings, num_factors=len(factors), progress=progress)


def choose(kinds: Sequence[Hashable], most: int | None) -> list[int]:
    """Return positions of at most `most` factors of each kind, evenly distributed; None: all."""
    members: dict[Hashable, list[int]] = {}
    for position, kind in enumerate(kinds):
        members.setdefault(kind, []).append(position)
    chosen = []
    for same in members.values():
        count = len(same) if most is None else min(most, len(same))
        chosen += [same[k * len(same) // count] for k in range(count)]
    return sorted(chosen)


def kind_of(factor: Factor, variables: Mapping[Hashable, Variable]) -> Hashable:
    """Return an identifier that factors with the same code and the same manifolds share."""
    code = code_of(factor.function) if isinstance(factor, FunctionFactor) else type(factor)
    own = [variables[key] for key in factor.keys]
    return code, tuple((variable.manifold, len(variable.value)) for variable in own)


def _label(factor: Factor) -> str:
    if not isinstance(factor, FunctionFactor):
        return type(factor).__name__
    name = getattr(factor.function, "__qualname__", type(factor.function).__name__)
    return f"{type(factor).__name__} {name.rpartition('<locals>.')[2]}"
