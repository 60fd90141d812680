"""Classification of wrong Jacobians: signatures of mistakes, from specific to general.

A signature is a hypothesis about the mistake: it predicts the wrong columns from the correct ones.
It is accepted if it leaves at most 1e-5 of the deviation unexplained (``EXPLAINED``). Errors
without a signature are classified by size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.checking import column_signatures as column
from bundle.checking import row_signatures as row
from bundle.checking.evidence import KNOWN, Evidence, Finding
from bundle.checking.jacobian_deviation import Array, JacobianDeviation, norm

# Signatures of two blocks: exchanged Jacobians, and a missing adjoint between two poses.
#
# The residual of a measured relative pose depends on X_i^-1 X_j. If X_i moves by a right
# perturbation d, X_j = X_i B moves relative to it by -Ad(B^-1) d. So J_i = -J_j A with A =
# Ad(X_j^-1 X_i). Where J_j is invertible, A follows from the correct Jacobians alone: A = -J_j^-1
# J_i. Common mistakes are J_i = -J_j, without A, and J_i = -J_j A^-1, with the adjoint of the
# inverse.


WORST_CONDITION = 1e8  # largest condition number of a Jacobian that is inverted


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
    """Find a relative pose's Jacobian that lacks the adjoint, or has the adjoint of the inverse."""
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
    for j, one in enumerate(evidence.columns):
        groups.setdefault(one.group, []).append(j)
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


MISTAKES = (
    "correct",
    "not_finite",
    "stale",
    "zero",
    "sign",
    "factor",
    "degrees",
    "scaled_by_parameter",
    "transposed",
    "swapped",
    "swapped_blocks",
    "quaternion_order",
    "shifted",
    "swapped_rows",
    "order",
    "padded",
    "whitening",
    "logarithm",
    "perturbation",
    "inverse",
    "half_angle",
    "adjoint",
    "frame",
    "row_factor",
    "row_swapped",
    "one_row",
    "missing_term",
    "float_precision",
    "normal",
    "unstable",
    "undecided",
    "small_part",
    "large_part",
)
"""Kinds of findings, from the most specific ("a stale cache") to the most general."""

FINE = 1e-4  # largest error of columns that are wrong in their last digits

SIGNATURES: tuple[Callable[[Evidence], None], ...] = (
    row.conventions,
    row.quaternion_order,
    swapped_blocks,
    adjoint,
    column.swapped,
    column.shifted,
    row.rows,
    column.zeros,
    row.whitening,
    row.logarithm,
    column.column_major,  # zeros make some of its columns constant factors
    column.factors,
    column.transposed,  # the negative of a skew matrix is its transpose: a sign is likelier
    row.rotation_vectors,
    row.turned,
    column.order,
    column.parameter_factors,
    column.varying_factors,
    column.terms_of_a_parameter,
    column.zero_entries,
    row.one_row,
    column.rank_one,
)


def classify(evidence: Evidence) -> list[Finding]:
    """Return findings that together contain every wrong column."""
    bad = [j for j in evidence.wrong if not np.isfinite(evidence.analytic[..., j]).all()]
    if bad:
        evidence.found("not_finite", bad, f"{evidence.names(bad)}: not a finite number")
    with np.errstate(over="ignore", invalid="ignore"):  # a guess that overflows explains nothing
        for signature in SIGNATURES:
            if evidence.wrong:
                signature(evidence)
    if evidence.wrong:
        _by_size(evidence)
    return evidence.findings


def stale(
    deviations: JacobianDeviation, repeated: JacobianDeviation, tolerance: float
) -> Finding | None:
    """Return a finding if Jacobians equal those of points evaluated earlier (a stale cache).

    ``repeated``: deviations at the same points, each evaluated twice in a row.
    """
    wrong = np.flatnonzero(np.any(deviations.error > tolerance, axis=(1, 2)))
    if not len(wrong):
        return None
    error = float(deviations.error.max())
    for words, source in (
        ("the point evaluated just before", np.maximum(wrong - 1, 0)),
        ("the first point evaluated", np.zeros_like(wrong)),
    ):
        moved = source != wrong
        if moved.any() and _hold(deviations, wrong[moved], source[moved]):
            sentence = f"stale cache: the Jacobian is that of {words}"
            return Finding("stale", (), sentence, error)
    still_wrong = np.any(repeated.error[wrong] > tolerance)
    if not still_wrong:
        sentence = (
            "stale cache: the Jacobian depends on what was evaluated before; "
            "a second call at the same point gives another, correct one"
        )
        return Finding("stale", (), sentence, error)
    return None


def float_precision(deviations: JacobianDeviation, names: tuple[str, ...]) -> Finding | None:
    """Return a finding if the Jacobians were rounded to single precision."""
    analytic, reference = deviations.analytic, deviations.reference
    single, telling = _singles(analytic)
    telling &= np.abs(reference) > 0
    if telling.sum() < 5 or not single[telling].all():
        return None
    error = np.abs(analytic - reference)[telling] / np.abs(reference)[telling]
    if np.median(error) > 1e-6:
        return None
    return Finding(
        "float_precision",
        names,
        "float precision: every number is one of single precision (float32), 7 digits of 16",
        float(deviations.deviation.max()),
    )


def is_single(residuals: Sequence[Array]) -> bool:
    """Return True if all residuals were computed in single precision."""
    single, telling = _singles(np.concatenate([np.zeros(0), *residuals]))
    return bool(telling.any() and single.all())


def rounds_to_single(values: Callable[[list[Array]], Array], blocks: list[Array]) -> bool:
    """Return True if a function rounds one of its parameters to single precision.

    The values are then constant between the midpoints of neighbouring numbers of single precision,
    and change at these.
    """
    at_point = values(blocks)
    for b, numbers in enumerate(blocks):
        for j, x in enumerate(numbers):
            with np.errstate(over="ignore"):
                single = np.float32(x)
                ends = [np.nextafter(single, np.float32(end)) for end in (-np.inf, np.inf)]
            if not all(0 < abs(end) < np.inf for end in map(float, (single, *ends))):
                continue
            middles = (float(single) + np.array(ends, np.float64)) / 2
            beside = 1e-3 * (middles - float(single))
            moved = []
            for place in (*(middles - beside), *(middles + beside)):
                there = [other.copy() for other in blocks]
                there[b][j] = place
                moved.append(np.array_equal(values(there), at_point))
            if moved == [True, True, False, False]:
                return True
    return False


def _singles(values: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of single-precision numbers, with and without trivial ones (0, 0.5, 1)."""
    with np.errstate(over="ignore", invalid="ignore"):
        single = values.astype(np.float32).astype(np.float64) == values
        plain = np.round(values * 2**10) == values * 2**10
    return single, ~plain & np.isfinite(values)


def _hold(deviations: JacobianDeviation, wrong: np.ndarray, source: np.ndarray) -> bool:
    """Return True if the Jacobians at the wrong points equal those of the source points."""
    scale = deviations.scale[wrong]
    columns = (deviations.error[wrong] > 0).any(axis=(0, 1))
    left = (deviations.analytic[wrong] - deviations.reference[source]) / scale
    deviation = (deviations.analytic[wrong] - deviations.reference[wrong]) / scale
    left, deviation = left[..., columns], deviation[..., columns]
    size = norm(deviation)
    return size < np.inf and norm(left) <= 1e-3 * size


def _by_size(evidence: Evidence) -> None:
    """Add findings for the remaining columns by the size of their typical error.

    Errors of rounding and of numerical differences affect all entries of a column. If most entries
    of a column are exact, errors of the others have another cause.
    """
    sizes = {j: float(np.median(_largest(evidence, j))) for j in evidence.wrong}
    fine = [j for j in evidence.wrong if evidence.deviations.error[..., j].max() <= FINE]
    alone = [j for j in fine if not _is_spread(evidence, j)]
    fine = [j for j in fine if j not in alone]
    small = [j for j, size in sizes.items() if size < 0.3 and j not in (*fine, *alone)]
    large = [j for j in sizes if j not in (*fine, *alone, *small)]
    rows = (evidence.deviations.error[..., alone] > evidence.tolerance).any(axis=(0, 2))
    residuals = ", ".join(map(str, np.flatnonzero(rows)))
    for kind, columns, words in (
        (
            "small_part",
            alone,
            f"wrong in the last digits of residual {residuals} only: a small term, or a "
            "constant with few digits",
        ),
        (
            "float_precision",
            fine,
            "the last digits are wrong without a pattern: computed in float precision, "
            "or by differences",
        ),
        (
            "small_part",
            small,
            "wrong in a small part: a sign or a term of the chain rule is missing there",
        ),
        (
            "large_part",
            large,
            "wrong as a whole: the order of variables, a transpose, or another formula",
        ),
    ):
        if columns:
            evidence.found(kind, columns, f"{evidence.names(columns)}: {words}")


def _is_spread(evidence: Evidence, column: int) -> bool:
    """Return True if most entries of a column (of all columns, if it has one entry) are wrong."""
    points = evidence.points_wrong_in(column)
    reference = evidence.reference[points]
    counts = (reference != 0) & (evidence.doubt[points] <= KNOWN)
    off = counts & (evidence.deviations.error[points] > 0)
    if counts[..., column].any(axis=0).sum() > 1:
        counts, off = counts[..., column], off[..., column]
    return bool(2 * off.sum() > counts.sum())


def _largest(evidence: Evidence, column: int) -> np.ndarray:
    errors: np.ndarray = evidence.deviations.error[..., column].max(axis=1)
    return errors[errors > 0]
