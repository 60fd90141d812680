"""Signatures of several columns: their order, a transpose, a missing product."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.checking.evidence import EXPLAINED, Evidence

__all__ = ["order", "rank_one", "shifted", "swapped", "transposed"]


def transposed(evidence: Evidence) -> None:
    """Find blocks written column by column that Ceres reads row by row."""
    for block in evidence.blocks:
        columns = list(block.columns)
        num_points, num_residuals = evidence.analytic.shape[:2]
        if min(num_residuals, block.size) < 2 or not set(columns) & set(evidence.wrong):
            continue
        raw = evidence.deviations.reference[..., columns]
        guess = raw.transpose(0, 2, 1).reshape(num_points, num_residuals, block.size)
        if evidence.explains(guess / evidence.deviations.scale[..., columns], columns):
            what = (
                "transposed"
                if block.size == num_residuals
                else "transposed in memory: written column by column, to be read row by row"
            )
            evidence.found(
                "transposed",
                columns,
                f"the {num_residuals} x {block.size} block of {block.name} is {what}",
            )


def swapped(evidence: Evidence) -> None:
    """Find pairs of exchanged columns."""
    matches = _matches(evidence)
    for i in list(evidence.wrong):
        for j in list(evidence.wrong):
            if i < j and {i, j} <= set(evidence.wrong) and matches[i, j] and matches[j, i]:
                names = evidence.names([i, j])
                evidence.found("swapped", [i, j], f"the columns of {names} are swapped")


def shifted(evidence: Evidence) -> None:
    """Find blocks whose columns each hold the derivative by the next or the previous parameter."""
    matches = _matches(evidence)
    for block in evidence.blocks:
        columns = [j for j in block.columns if j in evidence.wrong]
        for step in (1, -1):
            if len(columns) < 2 or not set(columns) <= set(evidence.wrong):
                continue
            sources = [block.start + (j - block.start + step) % block.size for j in columns]
            hits = [bool(matches[j, s]) for j, s in zip(columns, sources, strict=True)]
            edge = block.stop - 1 if step == 1 else block.start
            missed = [j for j, hit in zip(columns, hits, strict=True) if not hit]
            if sum(hits) >= 2 and set(missed) <= {edge}:
                neighbour = "next" if step == 1 else "previous"
                evidence.found(
                    "shifted",
                    columns,
                    f"the columns of {block.name} are shifted by one parameter: "
                    f"each holds the derivative by the {neighbour} one",
                )


def order(evidence: Evidence) -> None:
    """Find columns that hold the derivative by some other parameter."""
    matches = _matches(evidence)
    columns = [j for j in evidence.wrong if matches[j].any()]
    if columns:
        pairs = [
            f"{evidence.columns[j].name} holds that of {evidence.columns[int(i)].name}"
            for j, i in zip(columns, (np.argmax(matches[j]) for j in columns), strict=True)
        ]
        evidence.found("order", columns, f"columns in a wrong order: {', '.join(pairs)}")


def rank_one(evidence: Evidence) -> None:
    """Find blocks whose error is a column times a row: one term of the chain rule."""
    for block in evidence.blocks:
        columns = [j for j in block.columns if j in evidence.wrong]
        if len(columns) < 2 or evidence.analytic.shape[1] < 2:
            continue
        raw = (evidence.deviations.analytic - evidence.deviations.reference)[..., columns]
        size = np.linalg.svd(raw, compute_uv=False)
        doubt = np.linalg.norm(evidence.deviations.uncertainty[..., columns], axis=(1, 2))
        clear = size[:, 0] > 1e3 * doubt
        if clear.sum() >= 2 and (size[clear, 1] <= EXPLAINED * size[clear, 0]).all():
            evidence.found(
                "missing_term",
                columns,
                f"{evidence.names(columns)}: what is missing is the product of a column and a row: "
                "one term of the chain rule is left out or has a wrong sign",
            )


def _matches(evidence: Evidence) -> NDArray[np.bool_]:
    """Return (N, N): True if wrong column i equals the correct column j."""
    count = len(evidence.columns)
    matches = np.zeros((count, count), bool)
    raw = evidence.deviations.reference
    for i in evidence.wrong:
        for j in range(count):
            if i != j and raw[..., j].any():
                guess = raw[..., [j]] / evidence.deviations.scale[..., [i]]
                matches[i, j] = evidence.explains(guess, [i])
    return matches
