"""Statistics over many points, and the report of a check made of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.checking.evidence import Finding
from bundle.checking.gradient_report import (
    GradientCheckerSummary,
    GradientReport,
    Offender,
    Undecided,
    Verdict,
)
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.residual_blocks import Column
from bundle.interface.analysis_options import TOLERANCE

EDGES = (0.0, *(10.0**exponent for exponent in range(-14, 2)), np.inf)
"""Limits of the histogram's bins."""

MOST_KEPT = 200  # number of wrong points that is enough to identify a mistake

MOST_WORST = 10
MOST_OF_A_COLUMN = 3


@dataclass(frozen=True)
class Worst:
    """Entry with a large error: its point number, row, column, and values."""

    point: int
    residual: int
    column: int
    analytic: float
    reference: float
    error: float


@dataclass(frozen=True, eq=False)
class Kept:
    """Wrong points for the classifier: their numbers, and their Jacobians."""

    points: NDArray[np.intp]
    deviations: JacobianDeviation


@dataclass(eq=False)
class Tally:
    """Statistics of the columns of one kind of residual."""

    columns: Sequence[Column]
    tolerance: float
    num_points: int = 0
    histogram: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(EDGES) - 1, np.int64))
    worst: list[Worst] = field(default_factory=list)

    def __post_init__(self) -> None:
        count = len(self.columns)
        self.num_wrong = np.zeros(count, np.int64)
        self.num_entries = np.zeros(count, np.int64)
        self.num_undecided = np.zeros(count, np.int64)
        self.num_telling = np.zeros(count, np.int64)
        self.max_error = np.zeros(count)
        self._kept: list[Kept] = []

    def add(self, deviations: JacobianDeviation, points: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Add points with the numbers `points`; return a mask of those that are wrong."""
        if not len(deviations):
            return np.zeros(0, bool)
        error = deviations.error
        wrong = error > self.tolerance
        undecided = (deviations.doubt > self.tolerance) & ~wrong
        self.num_points += len(deviations)
        self.num_wrong += wrong.sum(axis=(0, 1))
        self.num_entries += error.shape[0] * error.shape[1]
        self.num_undecided += undecided.sum(axis=(0, 1))
        # An entry may be certainly zero although the reference is inaccurate for all others.
        is_something = np.abs(deviations.reference) > deviations.uncertainty
        self.num_telling += (undecided | is_something).sum(axis=(0, 1))
        clear = np.where(deviations.doubt <= self.tolerance, deviations.deviation, error)
        self.max_error = np.maximum(self.max_error, clear.max(axis=(0, 1)))
        self.histogram += np.histogram(np.minimum(deviations.deviation, 1e300), EDGES)[0]
        self._note_worst(deviations, points)
        wrong_points = np.asarray(np.any(wrong, axis=(1, 2)))
        kept = sum(len(part.points) for part in self._kept)
        chosen = np.flatnonzero(wrong_points)[: max(MOST_KEPT - kept, 0)]
        if len(chosen):
            self._kept.append(Kept(points[chosen], deviations.take(chosen)))
        return wrong_points

    def is_undecided(self, column: int) -> bool:
        """Return True if most entries of a column are undecided; certain zeros are ignored."""
        return bool(2 * self.num_undecided[column] > self.num_telling[column])

    @property
    def kept(self) -> Kept | None:
        """Wrong points, at most MOST_KEPT; None if all points are correct."""
        if not self._kept:
            return None
        return Kept(
            np.concatenate([part.points for part in self._kept]),
            JacobianDeviation.join([part.deviations for part in self._kept]),
        )

    @property
    def wrong_columns(self) -> list[int]:
        """Indices of the columns with a wrong entry."""
        return [int(j) for j in np.flatnonzero(self.num_wrong)]

    def _note_worst(self, deviations: JacobianDeviation, points: NDArray[np.intp]) -> None:
        score: Array = deviations.error + 1e-6 * np.minimum(deviations.deviation, 1e9)
        rows = score.argmax(axis=1)
        by_column = score.max(axis=1)
        count = min(MOST_OF_A_COLUMN, len(by_column))
        worst = np.argpartition(-by_column, count - 1, axis=0)[:count]
        for j in range(len(self.columns)):
            for k in worst[:, j]:
                row = int(rows[k, j])
                self.worst.append(
                    Worst(
                        int(points[k]),
                        row,
                        j,
                        float(deviations.analytic[k, row, j]),
                        float(deviations.reference[k, row, j]),
                        float(deviations.error[k, row, j]),
                    )
                )
        self.worst.sort(key=lambda entry: -entry.error)
        kept: list[Worst] = []
        for entry in self.worst:
            if sum(other.column == entry.column for other in kept) < MOST_OF_A_COLUMN:
                kept.append(entry)
        self.worst = kept[:MOST_WORST]


def verdicts(tallies: Sequence[Tally]) -> tuple[tuple[Verdict, ...], tuple[Verdict, ...]]:
    """Return verdicts on groups and on parameters; equal names are combined."""
    entries = [(column, tally, j) for tally in tallies for j, column in enumerate(tally.columns)]
    named = [(column.group, tally, j) for column, tally, j in entries]
    return _verdicts(named), _verdicts([(column.name, tally, j) for column, tally, j in entries])


def _verdicts(entries: Sequence[tuple[str, Tally, int]]) -> tuple[Verdict, ...]:
    result = []
    for name in dict.fromkeys(name for name, _, _ in entries):
        own = [(tally, j) for entry, tally, j in entries if entry == name]
        count, wrong, undecided = (
            sum(int(getattr(tally, field)[j]) for tally, j in own)
            for field in ("num_entries", "num_wrong", "num_undecided")
        )
        unknown = sum(tally.is_undecided(j) for tally, j in own)
        verdict = "wrong" if wrong else "undecided" if 2 * unknown > len(own) else "correct"
        largest = max((float(tally.max_error[j]) for tally, j in own), default=0.0)
        result.append(Verdict(name, verdict, count, wrong, undecided, largest))
    return tuple(result)


REASONS = {
    "camera_center": "too close to the camera's center: "
    "the last digits of point and pose change the derivatives",
    "rough": "a kink, a jump or noise there leaves no difference to compare with",
    "no_value": "the residual has no finite value on both sides",
}

SAYS_NOTHING = ("undecided", "unstable")
"""Kinds of findings after which the Jacobians are neither correct nor wrong, but undecided."""

NAMED = 3  # largest number of places listed in a sentence


def make_report(
    *,
    subject: str,
    noun: str,
    tallies: Sequence[Tally],
    findings: Iterable[Finding],
    worst: Iterable[Offender],
    num_checked: int,
    num_skipped: int,
    gradient_checker: GradientCheckerSummary,
    tolerance: float = TOLERANCE,
    undecided: Sequence[Undecided] = (),
) -> GradientReport:
    """Return the report.

    A finding is added for each group of parameters that the reference cannot decide, and if no
    point is decided. A finding without columns (the residual has no value) means that no point is
    decided.
    """
    groups, parameters = verdicts(tallies)
    found = [*findings, *_undecided(groups)]
    if not found and num_checked and sum(entry.count for entry in undecided) >= num_checked:
        found.append(Finding("undecided", (), f"no {noun} could be decided"))
    says_nothing = all(
        finding.kind in SAYS_NOTHING or (finding.kind == "not_finite" and not finding.columns)
        for finding in found
    )
    verdict = "wrong" if not says_nothing else "undecided"
    if not found and num_checked:
        verdict = "correct"
    histogram = sum((tally.histogram for tally in tallies), np.zeros(len(EDGES) - 1, np.int64))
    return GradientReport(
        ok=verdict == "correct",
        verdict=verdict,
        subject=subject,
        noun=noun,
        tolerance=tallies[0].tolerance if tallies else tolerance,
        num_checked=num_checked,
        num_skipped=num_skipped,
        findings=tuple(sorted(found, key=lambda finding: -finding.error)),
        groups=groups,
        parameters=parameters,
        worst=tuple(sorted(worst, key=lambda offender: -offender.error)[:MOST_WORST]),
        histogram=tuple(
            (float(low), float(high), int(count))
            for low, high, count in zip(EDGES[:-1], EDGES[1:], histogram, strict=True)
        ),
        gradient_checker=gradient_checker,
        undecided=tuple(undecided),
    )


def undecided_points(
    noun: str, points: Mapping[str, Sequence[int]], place: Callable[[int], str]
) -> list[Undecided]:
    """Return one entry per reason, the most frequent first."""
    entries = []
    for reason, found in sorted(points.items(), key=lambda item: -len(item[1])):
        if not found:
            continue
        places = tuple(place(point) for point in found[:NAMED])
        named = "; ".join(places) + ("; ..." if len(found) > NAMED else "")
        sentence = f"{plural(len(found), noun)} undecided: {REASONS[reason]} ({named})"
        entries.append(Undecided(reason, len(found), places, sentence))
    return entries


def _undecided(groups: Sequence[Verdict]) -> list[Finding]:
    return [
        Finding(
            "undecided",
            (group.name,),
            f"{group.name}: the residual is too noisy or too rough there for any reference; "
            "nothing can be said",
        )
        for group in groups
        if group.verdict == "undecided"
    ]
