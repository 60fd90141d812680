"""Checks after the solve of a graph, or of a problem with factors, for its warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bundle import _core
from bundle.errors import InputError
from bundle.graphs.factors.contents import factor_name
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.function_factor import FunctionFactor
from bundle.graphs.factors.solve_notes import (
    about_free_directions,
    about_parts,
    about_priors,
    find_parts,
)
from bundle.graphs.factors.spot_check import Candidate, Kind, code_of, spot_check
from bundle.graphs.factors.variables import Array, Key, Variable
from bundle.interface.solve_record import with_warnings

__all__ = ["Conditioning", "SolvedGraph", "checked", "spot_checked", "time_for_checks"]

Conditioning = tuple[float, float, int, list[int]]
"""The value that ``_core.graph_conditioning`` returns."""

MOST_SECONDS = 0.03
LARGEST_SHARE = 0.015
MOST_COLUMNS = 300
"""Columns of a Jacobian whose QR factorisation takes a few milliseconds."""

ADVICE = "FactorGraph.check_gradients"


@dataclass(frozen=True, eq=False)
class SolvedGraph:
    """A graph as it was solved: its variables at the start, and what the core was given."""

    variables: Mapping[Key, Variable]
    factors: Sequence[Factor]
    core: tuple[list[Any], list[Any]]
    conditioning: Conditioning | None

    @property
    def num_columns(self) -> int:
        """Free coordinates."""
        return sum(len(v.coordinates) - sum(v.held) for v in self.variables.values())


def checked(output: Mapping[str, Any], graph: SolvedGraph) -> dict[str, Any]:
    """Return the fields of a solve's summary with warnings about the graph and its Jacobians."""
    has_bounds = any(len(v.lower) for v in graph.variables.values())
    seconds = time_for_checks(output)
    ends = dict(zip(graph.variables, output["values"], strict=True))
    parts = find_parts(graph.variables, graph.factors)
    sentences = {
        # A projected step misses what its model promised as one by a wrong Jacobian does.
        "suspicious_steps": ""
        if has_bounds
        else _core.watch_convergence(output["iterations"], f"{ADVICE} finds out"),
        "wrong_factor": spot_checked(output, graph.factors, graph.variables, ends, seconds, ADVICE),
        "several_components": about_parts(graph.variables, parts, graph.factors),
        "free_directions": about_free_directions(
            graph.variables, parts, _dependent(output, graph, seconds), graph.factors
        ),
        "prior_spectrum": about_priors(graph.factors),
    }
    return with_warnings(output["summary"], sentences)


def time_for_checks(output: Mapping[str, Any]) -> float:
    """Return the seconds that checks after a solve may take."""
    return max(MOST_SECONDS, LARGEST_SHARE * float(output["solve_time_in_seconds"]))


def spot_checked(
    output: Mapping[str, Any],
    factors: Sequence[Factor],
    variables: Mapping[Key, Variable],
    ends: Mapping[Key, Array],
    seconds: float,
    advice: str,
) -> str:
    """Return the sentence of a spot check of the factors in Python; "" if nothing is wrong.

    Args:
        output: of the solve.
        factors: all of them.
        variables: at the start.
        ends: their values at the end.
        seconds: that it may take.
        advice: the call that names a mistake.
    """
    if output["summary"]["interrupted"]:
        return ""
    kinds: dict[Any, list[tuple[int, FunctionFactor]]] = {}
    for position, factor in enumerate(factors):
        if isinstance(factor, FunctionFactor):
            manifolds = tuple(variables[key].manifold for key in factor.keys)
            code = code_of(factor.function), manifolds
            kinds.setdefault(code, []).append((position, factor))
    if not kinds:
        return ""

    def candidate(member: tuple[int, FunctionFactor]) -> Candidate:
        return _candidate(*member, variables, ends)

    return spot_check([Kind(members, candidate) for members in kinds.values()], seconds, advice)


def _candidate(
    position: int,
    factor: FunctionFactor,
    variables: Mapping[Key, Variable],
    ends: Mapping[Key, Array],
) -> Candidate:
    name = factor_name(position, factor)
    own = [variables[key] for key in factor.keys]
    sizes = tuple(len(variable.coordinates) for variable in own)
    (evaluate,) = factor.core_arguments(name, sizes)
    return Candidate(
        name,
        evaluate,
        [(v.name, v.manifold, v.coordinates) for v in own],
        [[j for j in range(len(v.coordinates)) if not (v.held and v.held[j])] for v in own],
        [[ends[key] for key in factor.keys], [v.value for v in own]],
        factor.seconds_a_call,
    )


def _dependent(output: Mapping[str, Any], graph: SolvedGraph, seconds: float) -> list[Key] | None:
    """Return the variables of columns that depend on others at the end; None if not looked for."""
    if graph.conditioning is not None and not graph.conditioning[3]:
        return []
    is_costly = graph.conditioning is None and (
        graph.num_columns > MOST_COLUMNS or _seconds_to_linearize(output) > seconds
    )
    if is_costly or not graph.num_columns or output["summary"]["interrupted"]:
        return None
    keys = list(graph.variables)
    ends = [
        replace(variable, value=value).core()
        for variable, value in zip(graph.variables.values(), output["values"], strict=True)
    ]
    try:
        found = _core.graph_conditioning(ends, graph.core[1])
    except InputError:  # a factor without a value there, which the solve tells of
        return None
    return [keys[variable] for variable in found[3]]


def _seconds_to_linearize(output: Mapping[str, Any]) -> float:
    summary = output["summary"]
    steps = max(1, summary["num_jacobian_evaluations"])
    return float(3 * output["solve_time_in_seconds"] / steps)
