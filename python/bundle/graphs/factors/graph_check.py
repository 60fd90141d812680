"""Factors of a graph for the check of their Jacobians, a sample of each kind."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import bundle._core as _core
from bundle.graphs.factors.contents import GraphContents, factor_name
from bundle.graphs.factors.factor_check import CheckedFactor, check_each
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.function_factor import FunctionFactor
from bundle.graphs.factors.spot_check import code_of
from bundle.graphs.factors.variables import Variable
from bundle.interface.option_fields import number


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
        given = (
            factor.kind,
            name,
            list(range(len(own))),
            factor.loss,
            factor.loss_scale,
            arguments,
        )
        try:
            function = _core.factor_function([variable.core() for variable in own], given)
        except Exception as error:
            error.add_note(name)
            raise
        is_own = isinstance(factor, FunctionFactor)
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
