"""Signatures of mistakes in columns: zeros, constant factors, swapped or transposed blocks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.checking.evidence import EXPLAINED, Evidence
from bundle.checking.jacobian_deviation import Array

DEGREE = np.pi / 180
NEGLIGIBLE = 1e-12


def zeros(evidence: Evidence) -> None:
    """Find columns that are zero by mistake."""
    wrong = [j for j in evidence.wrong if not evidence.analytic[..., j].any()]
    if wrong:
        evidence.found(
            "zero",
            wrong,
            f"{evidence.names(wrong)}: zero, although the residual depends on "
            f"{'it' if len(wrong) == 1 else 'them'}; the derivative is missing",
            0.0,
        )


def factors(evidence: Evidence) -> None:
    """Find columns that are a constant times the correct column, in all rows or in some."""
    by_factor: dict[tuple[float, ...], tuple[list[int], NDArray[np.intp]]] = {}
    where: dict[int, str] = {}
    for j in evidence.wrong:
        points = evidence.points_wrong_in(j)
        analytic, reference = evidence.analytic[points, :, j], evidence.reference[points, :, j]
        if len(points) < len(evidence.points):
            where[j] = f" (at {len(points)} of {len(evidence.points)} wrong points only)"
        rows = _ratios(analytic, reference, axis=0)
        whole = np.full_like(rows, _ratios(analytic, reference, axis=None))
        for guess in (whole, rows):
            off = np.flatnonzero(np.abs(guess - 1) > evidence.tolerance)
            if len(off) and evidence.explains((guess * reference)[..., None], [j], points):
                # Six digits; near 1, three digits of the difference from 1.
                key = tuple(
                    float(f"{ratio:.6g}")
                    if abs(ratio - 1) > 1e-2
                    else 1 + float(f"{ratio - 1:.3g}")
                    for ratio in guess.tolist()
                )
                by_factor.setdefault(key, ([], off))[0].append(j)
                break
    for ratios, (columns, off) in by_factor.items():
        if len(set(ratios)) == 1:
            kind, words = _factor_in_words(ratios[0])
            note = where.get(columns[0], "")
            if kind == "factor" and 1 < len(columns) == evidence.reference.any(axis=(0, 1)).sum():
                alone = "residual" if abs(ratios[0]) < 1 else "Jacobians"
                note += f" (all columns: the weights may multiply only the {alone})"
            sentence = f"{evidence.names(columns)}: {words}{note}"
            evidence.found(kind, columns, sentence, ratios[0])
            continue
        same = len({ratios[row] for row in off}) == 1
        kind, words = _factor_in_words(ratios[off[0]]) if same else ("factor", "scaled")
        rows_text = ", ".join(map(str, off))
        sentence = f"{evidence.names(columns)}: {words}, in residual {rows_text} only"
        evidence.found(kind, columns, sentence, ratios[off[0]] if same else None)


def parameter_factors(evidence: Evidence) -> None:
    """Find columns that equal the correct column times the value of a parameter."""
    for j in list(evidence.wrong):
        analytic, reference = evidence.analytic[..., j], evidence.reference[..., j]
        ratios = _ratios(analytic, reference, axis=1)
        if not evidence.explains((ratios[:, None] * reference)[..., None], [j]):
            continue
        for p, column in enumerate(evidence.columns):
            value = evidence.points[:, p]
            if not value.all() or np.ptp(value) <= 1e-9 * np.abs(value).max():
                continue
            for exponent, verb in ((1, "multiplied"), (-1, "divided")):
                constant = ratios / value**exponent
                mean = float(constant.mean())
                if abs(abs(mean) - 1) > 1e-3 or np.ptp(constant) > 1e-3 * abs(mean):
                    continue
                if j in evidence.wrong:
                    sign = "" if mean > 0 else "minus "
                    evidence.found(
                        "scaled_by_parameter",
                        [j],
                        f"{evidence.columns[j].name}: {verb} by {sign}{column.name}, "
                        "once too often or once too little in the chain rule",
                    )


def varying_factors(evidence: Evidence) -> None:
    """Find blocks that are the correct ones times a number that differs from point to point."""
    groups: dict[str, list[int]] = {}
    for j in evidence.wrong:
        groups.setdefault(evidence.columns[j].group, []).append(j)
    for columns in groups.values():
        reference = evidence.reference[..., columns]
        if np.count_nonzero(reference, axis=(1, 2)).min() < 2:
            continue  # any number is a multiple of another
        products = np.sum(evidence.analytic[..., columns] * reference, axis=(1, 2))
        ratios = products / np.sum(reference * reference, axis=(1, 2))
        if evidence.explains(ratios[:, None, None] * reference, columns):
            evidence.found(
                "factor",
                columns,
                f"{evidence.names(columns)}: {ratios.min():.3g} to {ratios.max():.3g} times as "
                "large from point to point: a factor such as 1 / z is missing, or applied twice",
            )


def terms_of_a_parameter(evidence: Evidence) -> None:
    """Find columns that are correct if a parameter is zero: the terms with it are missing."""
    if not evidence.wrong:
        return
    deviation = np.linalg.norm(
        (evidence.analytic - evidence.reference)[..., evidence.wrong], axis=(1, 2)
    )
    chosen = np.argsort(-deviation, kind="stable")[:3]
    for p in range(len(evidence.columns)):
        wrong = list(evidence.wrong)
        if not wrong or not evidence.points[chosen, p].all():
            continue
        guesses = [evidence.reference_at(int(k), p) for k in chosen]
        if any(guess is None for guess in guesses):
            continue
        guess = np.array(guesses) / evidence.deviations.scale[chosen]
        columns = [j for j in wrong if evidence.explains(guess[..., [j]], [j], chosen)]
        if columns:
            name = evidence.columns[p].name
            evidence.found(
                "missing_term",
                columns,
                f"{evidence.names(columns)}: as if {name} were 0; "
                f"the terms with {name} are missing",
            )


def zero_entries(evidence: Evidence) -> None:
    """Find columns that are correct except for some rows that are zero."""
    for j in list(evidence.wrong):
        analytic, reference = evidence.analytic[..., j], evidence.reference[..., j]
        zero_rows = ~analytic.any(axis=0)
        guess = np.where(zero_rows, 0.0, reference)
        if zero_rows.any() and evidence.explains(guess[..., None], [j]):
            rows = ", ".join(map(str, np.flatnonzero(zero_rows)))
            evidence.found(
                "missing_term",
                [j],
                f"{evidence.columns[j].name}: zero in residual {rows}, which depends on it",
            )


def _ratios(analytic: Array, reference: Array, axis: int | None) -> Array:
    """Return the least-squares factors from reference to analytic along an axis."""
    square = np.sum(reference * reference, axis=axis)
    counts = square > NEGLIGIBLE**2 * np.sum(reference * reference)  # others are rounding
    ratio: Array = np.sum(analytic * reference, axis=axis) / np.where(counts, square, 1.0)
    return np.where(counts, ratio, 1.0)


def _factor_in_words(factor: float) -> tuple[str, str]:
    if abs(factor + 1) < 1e-4:
        return "sign", "the sign is flipped"
    sign = "" if factor > 0 else ", and the sign is flipped"
    size = abs(factor)
    if abs(size * DEGREE - 1) < 1e-4:
        return "degrees", f"{size:.3f} times too large: degrees for radians{sign}"
    if abs(size / DEGREE - 1) < 1e-4:
        return "degrees", f"{1 / size:.3f} times too small: degrees for radians{sign}"
    if size == 0:
        return "zero", "zero"
    large = size >= 1
    times = size if large else 1 / size
    digits = 3 if times > 1.01 else max(6, 2 - round(math.log10(times - 1)))
    return "factor", f"{times:.{digits}f} times too {'large' if large else 'small'}{sign}"


def column_major(evidence: Evidence) -> None:
    """Find oblong blocks stored column by column, although Ceres expects row-major order."""
    _find_transposed(evidence, is_square=False)


def transposed(evidence: Evidence) -> None:
    """Find transposed square blocks."""
    _find_transposed(evidence, is_square=True)


def _find_transposed(evidence: Evidence, *, is_square: bool) -> None:
    for block in evidence.blocks:
        columns = list(block.columns)
        num_points, num_residuals = evidence.analytic.shape[:2]
        if min(num_residuals, block.size) < 2 or not set(columns) & set(evidence.wrong):
            continue
        if is_square != (block.size == num_residuals):
            continue
        raw = evidence.deviations.reference[..., columns]
        guess = raw.transpose(0, 2, 1).reshape(num_points, num_residuals, block.size)
        if evidence.explains(guess / evidence.deviations.scale[..., columns], columns):
            what = (
                "transposed"
                if is_square
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
    """Find blocks with columns shifted by one: each holds the derivative of its neighbour."""
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
                    f"each holds the derivative with respect to the {neighbour} one",
                )


def order(evidence: Evidence) -> None:
    """Find columns that hold the derivative with respect to another parameter."""
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
