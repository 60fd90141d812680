"""Size of the matrix that a solve of a factor graph factorises, and the alarm of its ordering.

Two variables have a block in Lambda = J^T J if a factor joins them. Ceres does not report its
factor: it is counted after the solve, in CHOLMOD's AMD order of these blocks, as for
reconstructions. A dense factor has n (n + 1) / 2 entries. METIS is compared if the factorisations
take about a second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import Key, Variable
from bundle.interface.ordering_alarm import BestOrder, with_ordering_alarm

LEAST_FLOPS = 2e9
"""Flops of all factorisations, about a second, of which a look takes a small share."""


class FreePattern(NamedTuple):
    """Lower triangle of Lambda over the free variables, by block columns."""

    sizes: NDArray[np.int32]
    begin: NDArray[np.int64]
    rows: NDArray[np.int32]


def with_counts(
    summary: Mapping[str, Any], variables: Mapping[Key, Variable], factors: Sequence[Factor]
) -> dict[str, Any]:
    """Return the fields of a summary with the size of the factor and the alarm of its order."""
    begun = perf_counter()
    pattern = free_pattern(variables, factors)
    wide = pattern.sizes.astype(np.int64)
    columns = int(wide.sum())
    pairs = wide[pattern.rows] * np.repeat(wide, np.diff(pattern.begin))
    fields = {**summary, "num_information_nonzeros": int(2 * pairs.sum() - (wide**2).sum())}
    kind = fields["linear_solver_type_used"]
    if kind == "SPARSE_NORMAL_CHOLESKY":
        best = _count(pattern, "amd")
    elif kind == "DENSE_NORMAL_CHOLESKY":
        c = np.arange(columns, dtype=float)
        flops, entries = float((c * c + 3 * c).sum()), columns * (columns + 1) / 2
        best = BestOrder(ordering="natural", flops=flops, nonzeros=entries)
    else:  # by QR or conjugate gradients
        return fields
    fields |= {
        "num_factor_columns": columns,
        "num_reduced_nonzeros": (
            columns**2 if kind.startswith("DENSE") else fields["num_information_nonzeros"]
        ),
        "num_factor_nonzeros": int(best.nonzeros),
        "factor_flops": best.flops,
        "factor_ordering": best.ordering,
        "symbolic_time_in_seconds": perf_counter() - begun,
    }

    def look() -> BestOrder:
        return min(best, _count(pattern, "metis"), key=lambda one: one.flops)

    is_sparse = kind.startswith("SPARSE")
    return with_ordering_alarm(
        fields, lambda: pattern, look if is_sparse else None, least_flops=LEAST_FLOPS
    )


def _count(pattern: FreePattern, name: str) -> BestOrder:
    counts = _core.count_factor(*pattern, _core.order_blocks(*pattern, name))
    return BestOrder(ordering=name, flops=counts["flops"], nonzeros=counts["entries"])


def free_pattern(variables: Mapping[Key, Variable], factors: Sequence[Factor]) -> FreePattern:
    """Return the pattern of Lambda over the variables with a free coordinate."""
    sizes = {key: len(v.coordinates) - sum(v.held) for key, v in variables.items()}
    place = {key: k for k, key in enumerate(key for key, size in sizes.items() if size)}
    count = len(place)
    groups: dict[int, list[list[int]]] = {}
    for factor in factors:
        joined = [place[key] for key in factor.keys if key in place]
        groups.setdefault(len(joined), []).append(joined)
    codes = [np.arange(count) * (count + 1)]
    for number, members in groups.items():
        if number > 1:
            table = np.sort(np.array(members, np.int64), axis=1)
            first, second = np.triu_indices(number, 1)
            codes.append(np.unique(table[:, first] * count + table[:, second]))
    columns, rows = np.divmod(np.unique(np.concatenate(codes)), max(count, 1))
    begin = np.searchsorted(columns, np.arange(count + 1)).astype(np.int64)
    free = np.array([size for size in sizes.values() if size], np.int32)
    return FreePattern(free, begin, rows.astype(np.int32))
