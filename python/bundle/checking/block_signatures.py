"""Signatures that involve several columns: their order, their frame, a product that is missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.checking.evidence import EXPLAINED, Evidence
from bundle.checking.jacobian_deviation import Array

__all__ = ["order", "rank_one", "rotation_vectors", "shifted", "swapped", "transposed", "turned"]


def transposed(evidence: Evidence) -> None:
    """Blocks written column by column where Ceres reads row by row."""
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
    """Pairs of columns that stand in each other's place."""
    matches = _matches(evidence)
    for i in list(evidence.wrong):
        for j in list(evidence.wrong):
            if i < j and {i, j} <= set(evidence.wrong) and matches[i, j] and matches[j, i]:
                names = evidence.names([i, j])
                evidence.found("swapped", [i, j], f"the columns of {names} are swapped")


def shifted(evidence: Evidence) -> None:
    """Blocks whose columns each hold the derivative by the next parameter, or the last one."""
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
    """Columns that hold the derivative by some other parameter."""
    matches = _matches(evidence)
    columns = [j for j in evidence.wrong if matches[j].any()]
    if columns:
        pairs = [
            f"{evidence.columns[j].name} holds that of {evidence.columns[int(i)].name}"
            for j, i in zip(columns, (np.argmax(matches[j]) for j in columns), strict=True)
        ]
        evidence.found("order", columns, f"columns in a wrong order: {', '.join(pairs)}")


def rotation_vectors(evidence: Evidence) -> None:
    """Columns of a rotation vector that belong to another perturbation of the rotation."""
    for block in evidence.blocks:
        columns = list(block.columns)
        if block.rotation != "vector" or not set(columns) & set(evidence.wrong):
            continue
        left = np.array([_left_jacobian(w) for w in evidence.points[:, columns]])
        right = left.transpose(0, 2, 1)  # J_r(w) = J_l(-w)
        raw = evidence.deviations.reference[..., columns]
        for change, words in (
            (np.linalg.inv(left), "the derivative by d of Exp(d) Exp(w), not by w: J_l is missing"),
            (np.linalg.inv(right), "the derivative by d of Exp(w) Exp(d), not by w"),
            (np.linalg.solve(left, right), "the right Jacobian of SO(3) where the left belongs"),
            (np.linalg.solve(right, left), "the left Jacobian of SO(3) where the right belongs"),
        ):
            guess = raw @ change / evidence.deviations.scale[..., columns]
            if set(columns) & set(evidence.wrong) and evidence.explains(guess, columns):
                names = evidence.names(columns)
                evidence.found(
                    "perturbation", columns, f"{names}: left for right perturbation; it is {words}"
                )


def turned(evidence: Evidence) -> None:
    """Three columns that are a rotation of what they should be.

    A' = A Q with a rotation Q keeps A A^T, whatever Q is. Three of four columns of a quaternion are
    nothing that turns.
    """
    quaternions = {j for b in evidence.blocks if b.rotation == "quaternion" for j in b.columns}
    for block in evidence.blocks:
        for start in range(block.start, block.stop - 2):
            columns = list(range(start, start + 3))
            if len(set(columns) & set(evidence.wrong)) < 2 or set(columns) & quaternions:
                continue
            if not _same_gram(evidence, columns):
                continue
            names = evidence.names(columns)
            if block.rotation:
                evidence.found(
                    "perturbation",
                    columns,
                    f"{names}: right in size, turned by the rotation: "
                    "left for right perturbation, R Exp(d) for Exp(d) R",
                )
            else:
                evidence.found(
                    "frame",
                    columns,
                    f"{names}: right in size, turned by a rotation: in the wrong frame, "
                    "R (or its transpose) is missing or applied once too often",
                )


def rank_one(evidence: Evidence) -> None:
    """Blocks whose error is the product of a column and a row: one term of the chain rule."""
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
    """Return (N, N): whether wrong column i holds what belongs into column j."""
    count = len(evidence.columns)
    matches = np.zeros((count, count), bool)
    raw = evidence.deviations.reference
    for i in evidence.wrong:
        for j in range(count):
            if i != j and raw[..., j].any():
                guess = raw[..., [j]] / evidence.deviations.scale[..., [i]]
                matches[i, j] = evidence.explains(guess, [i])
    return matches


def _same_gram(evidence: Evidence, columns: list[int]) -> bool:
    analytic = evidence.deviations.analytic[..., columns]
    reference = evidence.deviations.reference[..., columns]
    size = np.linalg.norm(reference, axis=(1, 2), keepdims=True)
    size = np.where(size > 0, size, 1.0)
    analytic, reference = analytic / size, reference / size
    left = np.linalg.norm(_gram(analytic) - _gram(reference))
    return bool(left <= EXPLAINED * np.linalg.norm(analytic - reference))


def _gram(matrices: Array) -> Array:
    gram: Array = matrices @ matrices.transpose(0, 2, 1)
    return gram


def _left_jacobian(w: Array) -> Array:
    """Return J_l(w) of SO(3) by its power series, sum of [w]x^k / (k + 1)!."""
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ skew / (k + 1)
        total = total + term
    return total
