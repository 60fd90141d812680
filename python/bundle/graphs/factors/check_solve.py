"""Checks after the solve of a graph, or of a problem with factors, and their warnings.

Warnings are about disconnected parts, undetermined directions, wrong Jacobians of functions in
Python, and priors in poor numerical condition.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.contents import connected, factor_name
from bundle.graphs.factors.factors import Factor, FunctionFactor
from bundle.graphs.factors.linear_prior import AnchoredFactor
from bundle.graphs.factors.spot_check import Candidate, Kind, code_of, spot_check
from bundle.graphs.factors.variables import Array, Key, Variable
from bundle.interface.solve_record import with_warnings

RELATIVE = {"between", "relative_pose", "reprojection"}
"""Kinds of factors that are invariant under a motion of everything."""

LARGE = 300
"""Largest number of columns of a prior for which the spectrum takes a millisecond or two."""


def about_parts(
    variables: Mapping[Key, Variable], parts: Mapping[Key, Key], factors: Sequence[Factor]
) -> str:
    """Return a warning if components are disconnected and not all are anchored; "" otherwise.

    A component is anchored if it has a fixed coordinate, a factor of a single variable, or a prior.
    """
    sizes = Counter(parts.values())
    large = [key for key, size in sizes.items() if size > 1]
    placed = {parts[key] for key, variable in variables.items() if any(variable.held)}
    placed |= {
        parts[factor.keys[0]]
        for factor in factors
        if len(factor.keys) == 1 or isinstance(factor, AnchoredFactor)
    }
    if len(large) < 2 or placed >= set(large):
        return ""
    named = ", ".join(f"{plural(sizes[key], 'variable')} with {brief(key)}" for key in large[:3])
    return (
        f"The graph has {len(large)} disconnected parts "
        f"({named}{', ...' if len(large) > 3 else ''}): their relative placement is "
        "undetermined."
    )


def about_free_directions(
    variables: Mapping[Key, Variable],
    parts: Mapping[Key, Key],
    dependent: Sequence[Key] | None,
    factors: Sequence[Factor],
) -> str:
    """Return a warning about undetermined directions, or ""; ``dependent`` None: not computed."""
    if dependent is None:
        free = Counter(_floating(variables, parts, factors))
        least = "at least "
    else:
        free, least = Counter(parts[key] for key in dependent), ""
    if not free:
        return ""
    sizes = Counter(parts.values())
    where = ", ".join(
        f"{count} in the part of {plural(sizes[key], 'variable')} with {brief(key)}"
        for key, count in list(free.items())[:3]
    )
    columns = sum(len(v.coordinates) - sum(v.held) for v in variables.values())
    total = sum(free.values())
    return (
        f"No factor determines {least}{total} of {plural(columns, 'direction')} "
        f"({where}{', ...' if len(free) > 3 else ''}): only the damping limits them. Fix "
        "a variable, or add a prior."
    )


def _floating(
    variables: Mapping[Key, Variable], parts: Mapping[Key, Key], factors: Sequence[Factor]
) -> list[Key]:
    """Return the components that are certainly not anchored, each once per free direction."""
    kinds: dict[Key, set[str]] = {}
    for factor in factors:
        for key in factor.keys[:1]:
            kinds.setdefault(parts[key], set()).add(factor.kind)
    held = {parts[key] for key, variable in variables.items() if any(variable.held)}
    ways = Counter[Key]()
    for key, variable in variables.items():
        size = len(variable.coordinates)
        ways[parts[key]] = max(ways[parts[key]], size if variable.manifold != "euclidean" else 0)
    return [
        part
        for part, found in kinds.items()
        if found <= RELATIVE and part not in held
        for _ in range(ways[part])
    ]


def about_priors(factors: Sequence[Factor]) -> str:
    """Return a warning if the spectrum of a prior is suspicious; "" otherwise."""
    found = [
        (factor_name(position, factor), alarm)
        for position, factor in enumerate(factors)
        if isinstance(factor, AnchoredFactor) and (alarm := factor.alarm(LARGE))
    ]
    if not found:
        return ""
    name, warning = found[0]
    more = f" ({len(found)} priors in all)" if len(found) > 1 else ""
    return f"The prior {name} is unreliable: {warning}{more}."


Conditioning = tuple[float, float, int, list[int]]
"""Result of ``_core.graph_conditioning``."""

MOST_SECONDS = 0.03
LARGEST_SHARE = 0.015
MOST_COLUMNS = 300
"""Largest number of columns of a Jacobian whose QR factorisation takes a few milliseconds."""

ADVICE = "FactorGraph.check_gradients"


@dataclass(frozen=True, eq=False)
class SolvedGraph:
    """Solved graph: its variables at the start, and the arguments of the core."""

    variables: Mapping[Key, Variable]
    factors: Sequence[Factor]
    core: tuple[list[Any], list[Any]]
    conditioning: Conditioning | None

    @property
    def num_columns(self) -> int:
        """Number of free tangent coordinates."""
        return sum(len(v.coordinates) - sum(v.held) for v in self.variables.values())


def checked(output: Mapping[str, Any], graph: SolvedGraph) -> dict[str, Any]:
    """Return the fields of a solve's summary with warnings about the graph and its Jacobians."""
    has_bounds = any(len(v.lower) for v in graph.variables.values())
    seconds = time_for_checks(output)
    ends = dict(zip(graph.variables, output["values"], strict=True))
    first: dict[int, Key] = {}
    labels = connected(graph.variables, graph.factors)
    parts = {key: first.setdefault(label, key) for key, label in labels.items()}
    sentences = {
        # A step projected onto bounds may miss the model's prediction, as if a Jacobian were wrong.
        "suspicious_steps": ""
        if has_bounds
        else _core.watch_convergence(output["iterations"], f"test it with {ADVICE}"),
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
    """Return the warning of a spot check of the factors in Python; "" without a finding."""
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
    evaluate, _ = factor.core_arguments(name, sizes)
    return Candidate(
        name,
        evaluate,
        [(v.name, v.manifold, v.coordinates) for v in own],
        [[j for j in range(len(v.coordinates)) if not (v.held and v.held[j])] for v in own],
        [[ends[key] for key in factor.keys], [v.value for v in own]],
        factor.seconds_a_call,
    )


def _dependent(output: Mapping[str, Any], graph: SolvedGraph, seconds: float) -> list[Key] | None:
    """Return the variables of linearly dependent columns at the solution; None: not computed."""
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
    except InputError:  # a factor has no value there; the solve reports it
        return None
    return [keys[variable] for variable in found[3]]


def _seconds_to_linearize(output: Mapping[str, Any]) -> float:
    summary = output["summary"]
    steps = max(1, summary["num_jacobian_evaluations"])
    return float(3 * output["solve_time_in_seconds"] / steps)
