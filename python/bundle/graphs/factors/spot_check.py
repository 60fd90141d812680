"""Spot check of the Jacobians of factors in Python, at the start and at the end of a solve.

Jacobians J are compared with differences of the residual r. Along one tangent coordinate e of a
variable X with natural size s (a radian, the length of a translation, the number itself),

    D(h) = (r(X Exp(h s e)) - r(X Exp(-h s e))) / 2 h s,    R = D(h/2) + (D(h/2) - D(h)) / 3,

R = J e + O(h^4), and u = |D(h/2) - D(h)| + n / h s is far above the error of R wherever r is smooth
at the scale of h. n = eps (|r| + sum |J| size) is the rounding error. Rows of a whitened residual
have different sizes. Each row is tested alone; entries below 1e-9 of its size are not. A step is
*conclusive* if u is below a hundredth of |R|. An entry of J agrees with it if

    |J - R| < 1e-3 max(|J|, |R|) + 4 u + |r(+h/2) - 2 r(0) + r(-h/2)| / h s,

where the last term is half the difference of the one-sided slopes; at a kink, any slope between
them is valid. A conclusive step that agrees proves the entry right. Two conclusive steps, at least
100 times apart, that agree with each other and not with J prove the entry wrong. Otherwise the
entry is undecided. The verdict itself could only be wrong for a residual whose differences are
misleading at every scale. Only :meth:`bundle.FactorGraph.check_gradients` finds errors of less than
0.1 %.

Factors with the same code and the same kinds of variables are one kind. One factor of every kind is
checked first, then more factors of each kind, evenly distributed, until the time is used. If a
function is too slow for all columns, one combined direction of all columns is checked.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field
from time import perf_counter
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.graphs.factors.variables import Array

MOVES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-2)
CONCLUSIVE = 0.01
TOLERANCE = 1e-3
SAFETY = 4.0
SAME_DIFFERENCES = 0.02
NEGLIGIBLE = 1e-9
MOST_OF_A_KIND = 12
CONVICTED_SHARE = 0.25
SAME_FACTOR = 0.01

Evaluate = Callable[[list[Array], bool], tuple[Array, Any] | None]


@dataclass(frozen=True, eq=False)
class Candidate:
    """Factor that may be checked."""

    name: str  # name of the factor
    evaluate: Evaluate  # function from values to the residual and, on demand, Jacobians
    variables: Sequence[tuple[str, str, Sequence[str]]]  # name, manifold, tangent names of each
    free: Sequence[Sequence[int]]  # coordinates of each variable that a solve may change
    points: Sequence[list[Array]]  # values of the variables at which to check
    seconds_a_call: float  # duration of a call of its function


@dataclass(eq=False)
class Kind:
    """Factors with the same code, and the verdicts on their columns."""

    members: Sequence[Any]  # the factors
    candidate: Callable[[Any], Candidate]  # function that makes a candidate of a member
    decided: dict[tuple[int, int], int] = field(default_factory=dict)  # by variable and coordinate
    # wrong entries, with the ratio to the correct derivative
    convicted: dict[tuple[int, int], list[tuple[Candidate, float | None]]] = field(
        default_factory=dict
    )

    def is_wrong(self, column: tuple[int, int]) -> bool:
        """Return True if enough of the decided entries are wrong."""
        count = len(self.convicted.get(column, ()))
        return count > 0 and count >= CONVICTED_SHARE * self.decided[column]


def code_of(function: Any) -> Any:
    """Return an identifier of a function's code; closures and methods share it."""
    while isinstance(function, functools.partial):
        function = function.func
    function = getattr(function, "__func__", function)
    return getattr(function, "__code__", type(function))


def spot_check(kinds: Sequence[Kind], seconds: float, advice: str) -> str:
    """Return a sentence about the first kind of factor with wrong Jacobians; "" without any."""
    end = perf_counter() + seconds
    for turn in range(MOST_OF_A_KIND):
        for kind in kinds:
            count = min(len(kind.members), MOST_OF_A_KIND)
            if turn >= count:
                continue
            candidate = kind.candidate(kind.members[turn * len(kind.members) // count])
            for values in candidate.points:
                try:
                    _check(kind, candidate, values, end - perf_counter())
                except KeyboardInterrupt:  # the solve is complete: keep its result
                    return _sentence(kinds, advice)
                except Exception:  # the user's function may fail at points off the solver's path
                    continue
        if perf_counter() > end:
            break
    return _sentence(kinds, advice)


def _check(kind: Kind, candidate: Candidate, values: list[Array], left: float) -> None:
    columns = [(b, j) for b, free in enumerate(candidate.free) for j in free]
    if (1 + 4 * len(columns)) * candidate.seconds_a_call > left:
        columns = [_ALL]
    if 5 * candidate.seconds_a_call > left or not columns:
        return
    answer = candidate.evaluate([value.copy() for value in values], True)
    if answer is None:
        return
    residual, jacobians = answer[0], [np.asarray(matrix) for matrix in answer[1]]
    line = _Line(candidate, values, residual, jacobians, perf_counter() + left)
    for column in columns:
        agrees, convicted, factor = line.compare(column)
        if not agrees and not convicted:
            continue
        kind.decided[column] = kind.decided.get(column, 0) + 1
        if convicted:
            kind.convicted.setdefault(column, []).append((candidate, factor))


_ALL = (-1, -1)  # pseudo column: one combined direction of all columns


class _Line:
    """Factor at given values; compares its Jacobian's columns with differences of its residual."""

    def __init__(
        self,
        candidate: Candidate,
        values: list[Array],
        residual: Array,
        jacobians: list[Array],
        end: float,
    ) -> None:
        self.end = end
        self.candidate, self.values = candidate, values
        self.residual, self.jacobians = residual, jacobians
        self.sizes = [
            _sizes(manifold, value)
            for (_, manifold, _), value in zip(candidate.variables, values, strict=True)
        ]
        self.moved = sum(
            (np.abs(matrix) @ size for matrix, size in zip(jacobians, self.sizes, strict=True)),
            np.abs(residual),
        )
        self.noise = np.finfo(float).eps * self.moved

    def compare(self, column: tuple[int, int]) -> tuple[bool, bool, float | None]:
        """Return flags for a correct and for a wrong column, and the ratio to the right value."""
        step = self._step(column)
        claimed = np.zeros_like(self.residual)
        for matrix, part in zip(self.jacobians, step, strict=True):
            if part.any():
                claimed += matrix @ part
        acquitted = np.zeros(len(claimed), bool)
        convicted = np.zeros(len(claimed), bool)
        suspicious = np.full(len(claimed), np.nan)
        found = np.zeros_like(claimed)
        for move in MOVES:
            if perf_counter() > self.end:
                break
            differences = self._differentiate(step, move)
            if differences is None:
                continue
            right, doubt, fold = differences
            larger = np.maximum(np.abs(claimed), np.abs(right))
            error = np.abs(claimed - right)
            conclusive = doubt < CONCLUSIVE * np.abs(right)
            agrees = error < TOLERANCE * larger + SAFETY * doubt + fold
            acquitted |= (conclusive & agrees) | (larger == 0)
            with np.errstate(invalid="ignore"):
                again = np.abs(right - suspicious) < SAME_DIFFERENCES * np.abs(right)
            against = conclusive & ~agrees
            convicted |= against & again
            found[against] = right[against]
            suspicious[against] = right[against]
            small = larger < NEGLIGIBLE * self.moved
            if (acquitted | small).all():
                break
        convicted &= ~acquitted
        if not convicted.any():
            return bool(acquitted.any()), False, None
        return False, True, _factor(claimed, np.where(convicted, found, claimed), convicted)

    def _step(self, column: tuple[int, int]) -> list[Array]:
        """Return a step of natural size along a column, for each variable."""
        step = [np.zeros_like(size) for size in self.sizes]
        if column != _ALL:
            variable, coordinate = column
            step[variable][coordinate] = self.sizes[variable][coordinate]
            return step
        signs = np.random.default_rng(0)
        effects = [
            np.linalg.norm(matrix, axis=0) * size
            for matrix, size in zip(self.jacobians, self.sizes, strict=True)
        ]
        typical = np.median(np.concatenate([e[e > 0] for e in effects] or [np.ones(1)]))
        for b, free in enumerate(self.candidate.free):
            for j in free:
                share = min(1.0, typical / effects[b][j]) if effects[b][j] > 0 else 1.0
                step[b][j] = signs.choice((-1.0, 1.0)) * self.sizes[b][j] * share
        return step

    def _differentiate(self, step: list[Array], move: float) -> tuple[Array, Array, Array] | None:
        """Return R, u and the kink term; None if the residual has no value."""
        coarse, fine = self._both_sides(step, move), self._both_sides(step, move / 2)
        if coarse is None or fine is None:
            return None
        by_coarse = (coarse[0] - coarse[1]) / (2 * move)
        by_fine = (fine[0] - fine[1]) / move
        change = by_fine - by_coarse
        fold = np.abs((fine[0] - self.residual) + (fine[1] - self.residual)) / move
        return by_fine + change / 3, np.abs(change) + self.noise / move, fold

    def _both_sides(self, step: list[Array], move: float) -> tuple[Array, Array] | None:
        sides = []
        for sign in (move, -move):
            values = [
                value.copy()
                if not part.any()
                else value + sign * part
                if manifold == "euclidean"
                else _core.retract(manifold, value, sign * part)
                for (_, manifold, _), value, part in zip(
                    self.candidate.variables, self.values, step, strict=True
                )
            ]
            answer = self.candidate.evaluate(values, False)
            if answer is None:
                return None
            sides.append(answer[0])
        return sides[0], sides[1]


def _sizes(manifold: str, value: Array) -> Array:
    if manifold == "euclidean":
        length = float(np.linalg.norm(value))
        return np.where(value != 0, np.abs(value), length if length > 0 else 1.0)
    if manifold in ("so2", "so3"):
        return np.ones(1 if manifold == "so2" else 3)
    stored, turn = (value[:2], 1) if manifold == "se2" else (value[4:], 3)
    length = float(np.linalg.norm(stored))
    along = np.full(len(stored), length if length > 0 else 1.0)
    parts = (along, np.ones(turn)) if manifold == "se2" else (np.ones(turn), along)
    return np.concatenate(parts)


def _factor(claimed: Array, found: Array, convicted: Array) -> float | None:
    """Return the common ratio of the wrong rows to the differences, if there is one."""
    right, given = found[convicted], claimed[convicted]
    factor = float(given @ right / (right @ right))
    same = np.abs(given - factor * right) <= SAME_FACTOR * np.abs(given).max()
    return factor if same.all() else None


def _sentence(kinds: Sequence[Kind], advice: str) -> str:
    for kind in kinds:
        wrong = [column for column in kind.convicted if kind.is_wrong(column)]
        columns = [column for column in wrong if column != _ALL] or wrong
        if columns:
            return _about(kind, columns, advice)
    return ""


def _about(kind: Kind, columns: list[tuple[int, int]], advice: str) -> str:
    convicted = [entry for column in columns for entry in kind.convicted[column]]
    candidate = convicted[0][0]
    factors = {None if factor is None else f"{factor + 0.0:.3g}" for _, factor in convicted}
    (first, *others) = factors
    if others or first is None:
        how = "differ from differences of the residual"
    else:
        how = f"are {first} times the differences of the residual"
    others_like = len(kind.members) - 1
    alike = f", possibly also in {plural(others_like, 'other')} of its code" if others_like else ""
    return (
        f"A Jacobian is wrong: the derivatives of {candidate.name} by "
        f"{'; '.join(_names(candidate, columns))} {how}{alike}; {advice} identifies the "
        "mistake."
    )


def _names(candidate: Candidate, columns: list[tuple[int, int]]) -> Iterator[str]:
    if _ALL in columns:
        yield "its variables"
        return
    for b, (name, _, coordinates) in enumerate(candidate.variables):
        own = [coordinates[j] for variable, j in columns if variable == b]
        if own:
            yield f"{name} ({', '.join(own)})"
