"""Signatures of mistakes in rows: the correct Jacobian J multiplied from the left, A = M J.

- Rows in a wrong order: M is a permutation.
- The square root L^T of the information is applied only to the residual, or only to the Jacobian: M
  is the same at all points and in all columns.
- The residual is a logarithm, r = W Log(E). Its derivative is W J_r^-1(e) times the derivative of
  E, with e = Log(E). If J_r^-1 is missing, M = W J_r(e) W^-1. Since J_r(e) e = e, M r = r for any
  W.
- One row alone is wrong: its derivatives are multiplied by a number that differs from point to
  point, two of them are exchanged, or another formula is there. A deviation in one row has rank
  one, which therefore says nothing about a product of the chain rule.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.checking.evidence import EXPLAINED, Evidence
from bundle.checking.jacobian_deviation import Array

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
    ratios = _row_ratios(analytic[..., used], reference[..., used])
    if _is_number(np.diag(ratios)):
        return  # a scalar factor is another signature
    everything = np.linalg.norm(analytic[..., used] - reference[..., used])
    off = np.abs(ratios - 1) > EXPLAINED
    left = np.linalg.norm(analytic[..., used] - ratios[:, None] * reference[..., used])
    is_by_rows = left <= EXPLAINED * everything
    degrees = np.flatnonzero(off & _are_degrees(ratios))
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
                    f"{evidence.names(wrong)}: as if the residual were no logarithm: its inverse "
                    "right Jacobian J_r^-1 is missing, or another one is there",
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
                    return "row_swapped", f"the derivatives by {names} are swapped{turned}"
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


def _are_degrees(ratios: Array) -> NDArray[np.bool_]:
    """Return the mask of factors from degrees to radians, or the reverse."""
    sizes = np.abs(ratios)
    off = np.minimum(np.abs(sizes * DEGREE - 1), np.abs(sizes / DEGREE - 1))
    are: NDArray[np.bool_] = off < 1e-4
    return are


def _row_ratios(given: Array, right: Array) -> Array:
    square = (right * right).sum(axis=(0, 2))
    ratios: Array = (given * right).sum(axis=(0, 2)) / np.where(square > 0, square, 1.0)
    return np.where(square > 0, ratios, 1.0)


def _is_number(matrix: Array) -> bool:
    mean = np.trace(matrix) / len(matrix)
    return bool(np.linalg.norm(matrix - mean * np.eye(len(matrix))) <= EXPLAINED * abs(mean))


def _is_one_matrix(given: Array, right: Array) -> bool:
    """Return True if an M that is fitted without a column also gives A = M J in that column.

    Columns without which M is not determined tell nothing, as those of a row that depends on one
    parameter alone. Two others, and half of all, are to be predicted.
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
