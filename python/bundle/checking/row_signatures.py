"""Signatures of mistakes in rows and rotations: the correct Jacobian J times a matrix, A = M J.

- Rows in a wrong order: M is a permutation.
- The square root L^T of the information is applied only to the residual, or only to the Jacobian: M
  is the same at all points and in all columns.
- The residual is a logarithm, r = W Log(E). Its derivative is W J_r^-1(e) times the derivative of
  E, with e = Log(E). If J_r^-1 is missing, M = W J_r(e) W^-1. Since J_r(e) e = e, M r = r for any
  W.
- One row alone is wrong: its derivatives are multiplied by a number that differs from point to
  point, two of them are exchanged, or another formula is there. A deviation in one row always has
  rank one, so rank one does not prove a product of the chain rule.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bundle.checking.evidence import EXPLAINED, Evidence
from bundle.checking.jacobian_deviation import Array
from bundle.checking.residual_blocks import Block
from bundle.model.rigid_motions import cross_matrices

DEGREE = np.pi / 180


def rows(evidence: Evidence) -> None:
    """Find exchanged rows, in all columns or in the columns of a block."""
    num_residuals = evidence.analytic.shape[1]
    if num_residuals < 2:
        return
    every = list(range(len(evidence.columns)))
    for columns in [every, *(list(block.columns) for block in evidence.blocks)]:
        wrong = [j for j in columns if j in evidence.wrong]
        if len(wrong) < 2:
            continue
        source, factor = _sources(
            evidence.deviations.analytic[..., wrong], evidence.deviations.reference[..., wrong]
        )
        moved = np.flatnonzero(source != np.arange(num_residuals))
        if not len(moved) or len(set(source.tolist())) < num_residuals:
            continue
        raw = factor[:, None] * evidence.deviations.reference[:, source][..., wrong]
        if evidence.explains(raw / evidence.deviations.scale[..., wrong], wrong):
            places = ", ".join(f"{row} holds that of {source[row]}" for row in moved)
            what = "swapped" if len(moved) == 2 else "in a wrong order"
            before = "" if np.allclose(factor, 1, atol=1e-3) else ", before the weights"
            evidence.found(
                "swapped_rows",
                wrong,
                f"{evidence.names(wrong)}: the rows are {what}{before}: {places}",
            )


def whitening(evidence: Evidence) -> None:
    """Find a common matrix factor of all columns: weights applied to one side only."""
    analytic, reference = evidence.deviations.analytic, evidence.deviations.reference
    used = [j for j in range(analytic.shape[2]) if reference[..., j].any()]
    if analytic.shape[1] < 2 or len(used) < 2 or not set(used) <= set(evidence.wrong):
        return
    square = (reference[..., used] ** 2).sum(axis=(0, 2))
    products = (analytic[..., used] * reference[..., used]).sum(axis=(0, 2))
    ratios = np.where(square > 0, products / np.where(square > 0, square, 1.0), 1.0)
    if _is_number(np.diag(ratios)):
        return  # a scalar factor is another signature
    everything = np.linalg.norm(analytic[..., used] - reference[..., used])
    off = np.abs(ratios - 1) > EXPLAINED
    left = np.linalg.norm(analytic[..., used] - ratios[:, None] * reference[..., used])
    is_by_rows = left <= EXPLAINED * everything
    sizes = np.abs(ratios)
    from_degrees = np.minimum(np.abs(sizes * DEGREE - 1), np.abs(sizes / DEGREE - 1))
    degrees = np.flatnonzero(off & (from_degrees < 1e-4))
    if is_by_rows and 0 < len(degrees) == off.sum():
        evidence.found(
            "degrees",
            used,
            f"every column: the derivatives of residual {', '.join(map(str, degrees))} are those "
            "of an angle in degrees instead of radians, or the reverse",
        )
        return
    if not is_by_rows or off.sum() < 2:
        if not _is_one_matrix(analytic[..., used], reference[..., used]):
            return
        by = "by one matrix from the left"
    else:
        by = "by " + ", ".join(f"{ratio:.4g}" for ratio in ratios) + " row by row"
    evidence.found(
        "whitening",
        used,
        f"every column is multiplied {by}: the square root of the information, the "
        "weights of the residual, is applied only to the residual or only to the "
        "Jacobians",
    )


def logarithm(evidence: Evidence) -> None:
    """Find columns without the inverse Jacobian of the residual's logarithm."""
    num_residuals = evidence.analytic.shape[1]
    if num_residuals < 2 or evidence.residuals is None:
        return
    every = list(range(len(evidence.columns)))
    for columns in [every, *(list(block.columns) for block in evidence.blocks)]:
        wrong = [j for j in columns if j in evidence.wrong]
        if len(wrong) < num_residuals:
            continue
        for size in (num_residuals, 3):
            if num_residuals % size == 0 and _keeps_residual(evidence, wrong, size):
                evidence.found(
                    "logarithm",
                    wrong,
                    f"{evidence.names(wrong)}: as if the residual were no logarithm: the inverse "
                    "right Jacobian J_r^-1 is missing or wrong",
                )
                break


def one_row(evidence: Evidence) -> None:
    """Find columns that are wrong in the same row alone."""
    if evidence.analytic.shape[1] < 2:
        return
    by_row: dict[int, list[int]] = {}
    for j in evidence.wrong:
        wrong = np.flatnonzero((evidence.deviations.error[..., j] > evidence.tolerance).any(axis=0))
        if len(wrong) == 1:
            by_row.setdefault(int(wrong[0]), []).append(j)
    for row, columns in by_row.items():
        groups = [[j for j in columns if j in block.columns] for block in evidence.blocks]
        for part in [columns, *groups]:
            if len(part) > 1 and set(part) <= set(evidence.wrong):
                kind, words = _mistake_of_row(evidence, row, part)
                if kind:
                    sentence = f"{evidence.names(part)}: in residual {row} {words}"
                    evidence.found(kind, part, sentence)
        left = [j for j in columns if j in evidence.wrong]
        if len(left) > 1:
            evidence.found(
                "one_row",
                left,
                f"{evidence.names(left)}: wrong in residual {row} alone: another formula there, "
                "such as a wrong term or a wrong power",
            )


def _mistake_of_row(evidence: Evidence, row: int, columns: list[int]) -> tuple[str, str]:
    """Return the kind of the mistake in a row and its description; "" if it is another formula."""
    reference = evidence.reference[..., columns]
    given, right = evidence.analytic[:, row, columns], reference[:, row]

    def explains(guess: Array) -> bool:
        whole = reference.copy()
        whole[:, row] = guess
        return evidence.explains(whole, columns)

    if np.count_nonzero(right, axis=1).min() > 1:  # any number is a multiple of another
        ratios = (given * right).sum(axis=1) / (right * right).sum(axis=1)
        if explains(ratios[:, None] * right):
            return "row_factor", (
                f"{ratios.min():.3g} to {ratios.max():.3g} times as large from point to point: a "
                "factor such as r or 1 / r is missing, or applied twice"
            )
    scale = evidence.deviations.scale[:, row, columns]
    for i in range(len(columns)):
        for j in range(i):
            for signs in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
                guess = right * scale
                guess[:, [i, j]] = guess[:, [j, i]] * signs
                if explains(guess / scale):
                    names = evidence.names([columns[j], columns[i]])
                    turned = "" if signs == (1, 1) else ", with a wrong sign"
                    return "row_swapped", f"the derivatives w.r.t. {names} are swapped{turned}"
    return "", ""


def _keeps_residual(evidence: Evidence, columns: list[int], size: int) -> bool:
    """Return True if A = M J with M r = r, in blocks of `size` rows, at all points."""
    raw = evidence.deviations
    left, deviation = 0.0, 0.0
    assert evidence.residuals is not None
    for k, residual in enumerate(evidence.residuals):
        for first in range(0, len(residual), size):
            part = slice(first, first + size)
            given, right = raw.analytic[k, part][:, columns], raw.reference[k, part][:, columns]
            if np.linalg.norm(given - right) <= EXPLAINED**2 * np.linalg.norm(right):
                continue
            change, _, rank, _ = np.linalg.lstsq(right.T, given.T, rcond=1e-9)
            if rank < size:
                return False
            length = np.linalg.norm(residual[part])
            if length == 0:
                continue
            matrix = change.T
            axis = residual[part] / length
            left += float(np.linalg.norm(matrix @ axis - axis) ** 2)
            left += float((np.linalg.norm(matrix @ right - given) / np.linalg.norm(right)) ** 2)
            deviation += float(np.linalg.norm(matrix - np.eye(size)) ** 2)
    return bool(deviation > 0 and left <= EXPLAINED**2 * deviation)


def _sources(given: Array, right: Array) -> tuple[NDArray[np.intp], Array]:
    """Return, for each row, the correct row of which it is a multiple, and the factor.

    A row that is a multiple of the correct row with the same index is assigned to it.
    """
    products = np.einsum("kin,kjn->ij", given, right)
    square = np.einsum("kjn,kjn->j", right, right)
    factors = products / np.where(square > 0, square, 1.0)
    size = np.linalg.norm(given, axis=(0, 2))
    left = np.linalg.norm(given[:, :, None] - factors[..., None] * right[:, None], axis=(0, 3))
    own = np.arange(len(size))
    source = np.where(np.diag(left) <= EXPLAINED * size, own, left.argmin(axis=1))
    return source, np.where(source == own, 1.0, factors[own, source])


def _is_number(matrix: Array) -> bool:
    mean = np.trace(matrix) / len(matrix)
    return bool(np.linalg.norm(matrix - mean * np.eye(len(matrix))) <= EXPLAINED * abs(mean))


def _is_one_matrix(given: Array, right: Array) -> bool:
    """Return True if an M that is fitted without a column also gives A = M J in that column.

    If M is undetermined without a column, this column is no evidence: for example that of a row
    that depends on one parameter. At least two others, and half of all, must be predicted.
    """
    num_residuals, num_columns = given.shape[1:]

    def stacked(matrices: Array, columns: list[int]) -> Array:
        rows: Array = matrices[..., columns].transpose(1, 0, 2).reshape(num_residuals, -1)
        return rows

    left = deviation = 0.0
    predicted = 0
    for column in range(num_columns):
        others = [j for j in range(num_columns) if j != column]
        change, _, rank, _ = np.linalg.lstsq(
            stacked(right, others).T, stacked(given, others).T, rcond=1e-9
        )
        if rank < num_residuals:
            continue
        predicted += 1
        own = stacked(right, [column])
        left += float(np.linalg.norm(change.T @ own - stacked(given, [column])) ** 2)
        deviation += float(np.linalg.norm(own - stacked(given, [column])) ** 2)
    return predicted >= max(2, num_columns / 2) and left <= EXPLAINED**2 * deviation


# Signatures of mistakes in rotations: another perturbation, frame, or order of coordinates.
#
# If a rotation vector w changes by d, then Exp(w + d) = Exp(J_l(w) d) Exp(w). The derivative w.r.t.
# w is therefore the derivative w.r.t. a left perturbation times J_l(w), and that w.r.t. a right
# perturbation times J_r(w) = J_l(-w). In any Lie algebra J_l = sum ad^k / (k + 1)!, where ad is the
# matrix of the bracket with w. A block of six numbers is a rotation vector and a translation, in
# either order, or an element of se(3). All layouts are tested, at any position of a longer block.

BY_LEFT = "the derivative of Exp(d) Exp(w) w.r.t. d, not w.r.t. w: J_l is missing"
BY_RIGHT = "the derivative of Exp(w) Exp(d) w.r.t. d, not w.r.t. w: J_r is missing"


def conventions(evidence: Evidence) -> None:
    """Find derivatives w.r.t. other tangent coordinates of the manifold than the required ones."""
    for block in evidence.blocks:
        columns = list(block.columns)
        for (kind, words), changes in block.conventions.items():
            if not set(columns) & set(evidence.wrong) or evidence.numbers is None:
                break
            right = evidence.deviations.reference[..., columns] @ changes[evidence.numbers]
            if evidence.explains(right / evidence.deviations.scale[..., columns], columns):
                evidence.found(kind, columns, f"{evidence.names(columns)}: {words}")


def quaternion_order(evidence: Evidence) -> None:
    """Find derivatives with respect to a quaternion with its real part at the other end."""
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
    """Find derivatives w.r.t. a perturbation of the rotation instead of the rotation vector."""
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
                evidence.found("perturbation", columns, f"{names}: another perturbation: {words}")
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
                    f"{names}: right in size, but rotated: perturbed as R Exp(d) instead of "
                    "Exp(d) R",
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
            yield columns, cross_matrices(evidence.points[:, columns]), "SO(3)"
    for block in evidence.blocks:
        if block.rotation:
            continue
        for columns in _windows(block, 3):
            w = evidence.points[:, columns]
            if _turns(w):
                yield columns, cross_matrices(w), "SO(3)"
        for columns in _windows(block, 6):
            for turn, move in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
                twist = evidence.points[:, columns]
                if not _turns(twist[:, turn]):
                    continue
                ad = np.zeros((len(twist), 6, 6))
                ad[:, turn, turn] = ad[:, move, move] = cross_matrices(twist[:, turn])
                ad[:, move, turn] = cross_matrices(twist[:, move])
                yield columns, ad, "SE(3)"


def _turns(w: Array) -> bool:
    """Return True if vectors (K, 3) may be rotation vectors: less than a turn, and nonzero."""
    return bool(w.any() and np.linalg.norm(w, axis=1).max() < 6)


def _windows(block: Block, size: int) -> list[list[int]]:
    return [list(range(j, j + size)) for j in range(block.start, block.stop - size + 1)]


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
