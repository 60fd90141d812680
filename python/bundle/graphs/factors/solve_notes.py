"""Notes on the solve of a graph: parts, free directions, priors that lost their digits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from bundle.base.words import plural
from bundle.errors import brief
from bundle.graphs.factors.anchored import AnchoredFactor
from bundle.graphs.factors.contents import factor_name
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import Key, Variable

__all__ = ["about_free_directions", "about_parts", "about_priors", "find_parts"]

RELATIVE = {"between", "relative_pose", "reprojection"}
"""Kinds of factors that a movement of everything leaves as they are."""

LARGE = 300
"""Columns of a prior whose spectrum takes longer than a millisecond or two."""


def find_parts(variables: Mapping[Key, Variable], factors: Sequence[Factor]) -> dict[Key, Key]:
    """Return for each variable the first one of its part: those that factors join."""
    parent = {key: key for key in variables}

    def root(key: Key) -> Key:
        while parent[key] != key:
            parent[key] = parent[parent[key]]
            key = parent[key]
        return key

    order = {key: i for i, key in enumerate(variables)}
    for factor in factors:
        roots = {root(key) for key in factor.keys}
        first = min(roots, key=order.__getitem__)
        for other in roots:
            parent[other] = first
    return {key: root(key) for key in variables}


def about_parts(
    variables: Mapping[Key, Variable], parts: Mapping[Key, Key], factors: Sequence[Factor]
) -> str:
    """Return a sentence if no factor joins parts of the graph, and not all have a place; "" else.

    A part has one where something is held, or known of one variable alone or by a prior.
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
        f"The graph has {len(large)} parts that no factor joins ({named}"
        f"{', ...' if len(large) > 3 else ''}): where they are to each other is not known."
    )


def about_free_directions(
    variables: Mapping[Key, Variable],
    parts: Mapping[Key, Key],
    dependent: Sequence[Key] | None,
    factors: Sequence[Factor],
) -> str:
    """Return a sentence if factors leave directions free; "" else.

    Args:
        variables: of the graph.
        parts: of ``find_parts``.
        dependent: the variables of columns that depend on others; None if nobody looked.
        factors: of the graph.
    """
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
        f"No factor says anything of {least}{total} of {plural(columns, 'direction')} ({where}"
        f"{', ...' if len(free) > 3 else ''}): the damping alone holds them. Hold a variable, or "
        "add a prior."
    )


def _floating(
    variables: Mapping[Key, Variable], parts: Mapping[Key, Key], factors: Sequence[Factor]
) -> list[Key]:
    """Return parts that certainly float, each as often as it has ways to."""
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
    """Return a sentence if the spectrum of a prior alarms; "" else."""
    found = [
        (factor_name(position, factor), alarm)
        for position, factor in enumerate(factors)
        if isinstance(factor, AnchoredFactor) and (alarm := factor.alarm(LARGE))
    ]
    if not found:
        return ""
    name, warning = found[0]
    more = f" ({len(found)} priors in all)" if len(found) > 1 else ""
    return f"A prior should not be trusted, {name}: {warning}{more}."
