"""Signatures of mistakes in rotations: another perturbation, frame, or order of coordinates.

If a rotation vector w changes by d, then Exp(w + d) = Exp(J_l(w) d) Exp(w). The derivative by w is
therefore the derivative by a left perturbation times J_l(w). It is also the derivative by a right
perturbation times J_r(w) = J_l(-w). In any Lie algebra J_l = sum ad^k / (k + 1)!, where ad is the
matrix of the bracket with w. A block of six numbers is a rotation vector and a translation, in
either order, or an element of se(3). All layouts are tested, at any position of a longer block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bundle.checking.evidence import EXPLAINED, Evidence
from bundle.checking.jacobian_deviation import Array
from bundle.checking.residual_blocks import Block

BY_LEFT = "the derivative by d of Exp(d) Exp(w), not by w: J_l is missing"
BY_RIGHT = "the derivative by d of Exp(w) Exp(d), not by w: J_r is missing"


def conventions(evidence: Evidence) -> None:
    """Find derivatives by other tangent coordinates of the manifold than the required ones."""
    for block in evidence.blocks:
        columns = list(block.columns)
        for (kind, words), changes in block.conventions.items():
            if not set(columns) & set(evidence.wrong) or evidence.numbers is None:
                break
            right = evidence.deviations.reference[..., columns] @ changes[evidence.numbers]
            if evidence.explains(right / evidence.deviations.scale[..., columns], columns):
                evidence.found(kind, columns, f"{evidence.names(columns)}: {words}")


def quaternion_order(evidence: Evidence) -> None:
    """Find derivatives by a quaternion with its real part at the other end."""
    for block in evidence.blocks:
        columns = list(block.columns)
        if block.rotation != "quaternion" or not set(columns) & set(evidence.wrong):
            continue
        raw = evidence.deviations.reference[..., columns]
        for step, words in ((1, "the last column first"), (-1, "the first column last")):
            guess = np.roll(raw, step, axis=2) / evidence.deviations.scale[..., columns]
            if evidence.explains(guess, columns):
                evidence.found(
                    "quaternion_order",
                    columns,
                    f"{evidence.names(columns)}: another order of the quaternion, {words}: "
                    "w x y z and x y z w are confused",
                )
                break


def rotation_vectors(evidence: Evidence) -> None:
    """Find derivatives by a perturbation of the rotation instead of by the rotation vector."""
    for columns, left, what in _algebras(evidence):
        if not set(columns) & set(evidence.wrong):
            continue
        right = np.array([_left_jacobian(-ad) for ad in left])
        left = np.array([_left_jacobian(ad) for ad in left])
        raw = evidence.deviations.reference[..., columns]
        for change, words in (
            (np.linalg.inv(left), BY_LEFT),
            (np.linalg.inv(right), BY_RIGHT),
            (np.linalg.solve(left, right), f"the right Jacobian of {what} instead of the left"),
            (np.linalg.solve(right, left), f"the left Jacobian of {what} instead of the right"),
        ):
            guess = raw @ change / evidence.deviations.scale[..., columns]
            if evidence.explains(guess, columns):
                names = evidence.names(columns)
                evidence.found(
                    "perturbation", columns, f"{names}: left for right perturbation; it is {words}"
                )
                break


def turned(evidence: Evidence) -> None:
    """Find three columns that are a rotation of the correct ones.

    For A' = A Q with any rotation Q, A' A'^T = A A^T. Three of the four columns of a quaternion are
    not tested, because they are not a rotation vector.
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
                    f"{names}: right in size, but rotated: left for right perturbation, R Exp(d) "
                    "for Exp(d) R",
                )
            else:
                evidence.found(
                    "frame",
                    columns,
                    f"{names}: right in size, but rotated: in the wrong frame, R (or its "
                    "transpose) is missing or applied once too often",
                )


def _algebras(evidence: Evidence) -> Iterator[tuple[list[int], Array, str]]:
    """Yield columns of a possible Lie algebra, and ad (K, n, n) of their values."""
    for block in evidence.blocks:
        if block.rotation == "vector":
            columns = list(block.columns)
            yield columns, _skew(evidence.points[:, columns]), "SO(3)"
    for block in evidence.blocks:
        if block.rotation:
            continue
        for columns in _windows(block, 3):
            w = evidence.points[:, columns]
            if _turns(w):
                yield columns, _skew(w), "SO(3)"
        for columns in _windows(block, 6):
            for turn, move in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
                twist = evidence.points[:, columns]
                if not _turns(twist[:, turn]):
                    continue
                ad = np.zeros((len(twist), 6, 6))
                ad[:, turn, turn] = ad[:, move, move] = _skew(twist[:, turn])
                ad[:, move, turn] = _skew(twist[:, move])
                yield columns, ad, "SE(3)"


def _turns(w: Array) -> bool:
    """Return True if vectors (K, 3) may be rotation vectors: less than a turn, and nonzero."""
    return bool(w.any() and np.linalg.norm(w, axis=1).max() < 6)


def _windows(block: Block, size: int) -> list[list[int]]:
    return [list(range(j, j + size)) for j in range(block.start, block.stop - size + 1)]


def _skew(w: Array) -> Array:
    """Return [w]x (K, 3, 3)."""
    matrices: Array = np.cross(w[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return matrices


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


def _left_jacobian(ad: Array) -> Array:
    """Return the left Jacobian J_l = sum ad^k / (k + 1)!."""
    term, total = np.eye(len(ad)), np.eye(len(ad))
    for k in range(1, 60):
        term = term @ ad / (k + 1)
        total = total + term
    return total
