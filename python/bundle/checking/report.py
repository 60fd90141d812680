"""What a check of Jacobians found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bundle.checking.evidence import Finding

__all__ = ["GradientCheckerSummary", "GradientReport", "Offender", "Verdict"]


@dataclass(frozen=True)
class Verdict:
    """What is to be said of a parameter, or of a group of them.

    Attributes:
        name: "camera RADIAL k1", "rotation".
        verdict: "correct", "wrong", or "undecided" where the reference is not good enough for half
            of the entries.
        num_entries: entries of the Jacobians compared.
        num_wrong: those beyond the tolerance.
        num_undecided: those whose reference is less certain than the tolerance.
        max_error: the largest relative error; of entries that are undecided, only the part that
            the reference's uncertainty does not explain.
    """

    name: str
    verdict: str
    num_entries: int
    num_wrong: int
    num_undecided: int
    max_error: float


@dataclass(frozen=True)
class Offender:
    """One entry of a Jacobian.

    Attributes:
        place: where in words: "image IMG_17.jpg, point 12", "sample 3".
        parameter: the column: "camera 3 k1", "image IMG_17.jpg rotation y".
        residual: the row.
        analytic: as given.
        reference: as it should be.
        error: relative, near-zero-safe (``Comparison.scale``), less what the reference does not
            know.
        details: the same for programs: image_id, image_name, camera_id, model, point_id, or sample.
    """

    place: str
    parameter: str
    residual: int
    analytic: float
    reference: float
    error: float
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GradientCheckerSummary:
    """How ceres::GradientChecker fared at the same points.

    Attributes:
        num_probes: how often it was asked.
        num_agreed: it found nothing wrong.
        num_false_alarms: it complained of Jacobians that the second reference finds correct.
        num_gave_up: it stepped on a point without a value.
        num_overlooked: it was content with Jacobians that are wrong.
    """

    num_probes: int = 0
    num_agreed: int = 0
    num_false_alarms: int = 0
    num_gave_up: int = 0
    num_overlooked: int = 0


@dataclass(frozen=True, eq=False)
class GradientReport:
    """What a check found. True if nothing is wrong; printing it explains.

    Attributes:
        ok: nothing is wrong, and something was checked.
        subject: what was checked, in words.
        noun: what a point is: "sample", "observation".
        tolerance: relative error from which on an entry is wrong.
        num_checked: points (observations) checked.
        num_skipped: points left out: no finite residual there, or one that does not count.
        findings: what is wrong, worst first.
        groups: a verdict on each group of parameters.
        parameters: a verdict on each parameter.
        worst: the entries with the largest errors, worst first.
        histogram: (low, high, count) of the relative errors of all entries, by decades.
        gradient_checker: how ceres::GradientChecker fared.
    """

    ok: bool
    subject: str
    noun: str
    tolerance: float
    num_checked: int
    num_skipped: int
    findings: tuple[Finding, ...]
    groups: tuple[Verdict, ...]
    parameters: tuple[Verdict, ...]
    worst: tuple[Offender, ...]
    histogram: tuple[tuple[float, float, int], ...]
    gradient_checker: GradientCheckerSummary

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of all findings; {"correct"} if there are none."""
        return frozenset(finding.kind for finding in self.findings) or frozenset({"correct"})

    def __bool__(self) -> bool:
        return self.ok

    def __str__(self) -> str:
        from bundle.report.check import explanation
        from bundle.report.text import render

        return render(*explanation(self)).rstrip("\n")

    def __repr__(self) -> str:
        return f"<GradientReport: {'correct' if self.ok else 'wrong'}>\n{self}"
