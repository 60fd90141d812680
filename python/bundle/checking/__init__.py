"""Gradient checking: Jacobians against two references, and a name for what is wrong."""

from bundle.checking.classify import KINDS
from bundle.checking.evidence import Finding
from bundle.checking.gradient_report import (
    GradientCheckerSummary,
    GradientReport,
    Offender,
    Undecided,
    Verdict,
)
from bundle.checking.gradients import check_gradients
from bundle.checking.jacobians import check_jacobians

__all__ = [
    "KINDS",
    "Finding",
    "GradientCheckerSummary",
    "GradientReport",
    "Offender",
    "Undecided",
    "Verdict",
    "check_gradients",
    "check_jacobians",
]
