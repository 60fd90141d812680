"""Signatures of two blocks: exchanged Jacobians, and a missing adjoint between two poses.

The residual of a measured relative pose depends on X_i^-1 X_j. If X_i moves by a right perturbation
d, X_j = X_i B moves relative to it by -Ad(B^-1) d. So J_i = -J_j A with A = Ad(X_j^-1 X_i). Where
J_j is invertible, A follows from the correct Jacobians alone: A = -J_j^-1 J_i. Common mistakes are
J_i = -J_j, without A, and J_i = -J_j A^-1, with the adjoint of the inverse.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bundle.checking.evidence import Evidence
from bundle.checking.jacobian_deviation import Array

WORST_CONDITION = 1e8
"""Largest condition number of a Jacobian that is inverted."""


def swapped_blocks(evidence: Evidence) -> None:
    """Find two groups of parameters with exchanged Jacobians."""
    for first, second in _pairs(evidence):
        both = [*first, *second]
        if not {*both} <= set(_changed(evidence, both)):
            continue
        raw = evidence.deviations.reference[..., [*second, *first]]
        if evidence.explains(raw / evidence.deviations.scale[..., both], both):
            names = [evidence.columns[part[0]].group for part in (first, second)]
            evidence.found(
                "swapped_blocks",
                both,
                f"the Jacobians of {names[0]} and {names[1]} are swapped",
            )


def adjoint(evidence: Evidence) -> None:
    """Find a Jacobian of a relative pose without the adjoint, or with that of the inverse."""
    poses = {tuple(block.columns) for block in evidence.blocks if block.conventions}
    for pair in _pairs(evidence):
        for wrong, other in (pair, pair[::-1]):
            if not {tuple(wrong), tuple(other)} <= poses or not set(wrong) & set(evidence.wrong):
                continue
            by_other = evidence.deviations.reference[..., other]
            guesses = [(-by_other, "the adjoint of the relative pose is missing")]
            between = _between(by_other, evidence.deviations.reference[..., wrong])
            if between is not None:
                words = "the adjoint of the inverse relative pose instead of the adjoint"
                guesses.append((-by_other @ np.linalg.inv(between), words))
            scale = evidence.deviations.scale[..., wrong]
            for guess, words in guesses:
                if evidence.explains(guess / scale, wrong):
                    evidence.found("adjoint", wrong, f"{evidence.names(wrong)}: {words}")
                    break


def _pairs(evidence: Evidence) -> Iterator[tuple[list[int], list[int]]]:
    """Yield the columns of two groups of the same size, of which some are wrong."""
    groups: dict[str, list[int]] = {}
    for j, column in enumerate(evidence.columns):
        groups.setdefault(column.group, []).append(j)
    members = [columns for columns in groups.values() if len(columns) > 1]
    for i, first in enumerate(members):
        for second in members[i + 1 :]:
            if len(first) == len(second) and {*first, *second} & set(evidence.wrong):
                yield first, second


def _changed(evidence: Evidence, columns: list[int]) -> list[int]:
    """Return the columns that are wrong, or whose derivative the exchange leaves unchanged."""
    half = len(columns) // 2
    raw = evidence.deviations.reference
    same = [
        np.array_equal(raw[..., j], raw[..., other])
        for j, other in zip(columns, [*columns[half:], *columns[:half]], strict=True)
    ]
    wrong = set(evidence.wrong)
    return [j for j, equal in zip(columns, same, strict=True) if equal or j in wrong]


def _between(by_second: Array, by_first: Array) -> Array | None:
    """Return A (K, n, n) of J_i = -J_j A; None if J_j or A is not invertible."""
    if by_second.shape[1] < by_second.shape[2]:
        return None
    if not (np.linalg.cond(by_second) < WORST_CONDITION).all():
        return None
    between: Array = -np.linalg.pinv(by_second) @ by_first
    return between if (np.linalg.cond(between) < WORST_CONDITION).all() else None
