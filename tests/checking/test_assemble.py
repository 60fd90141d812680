"""Verdict of a report from counts and findings."""

import pytest

from bundle.checking.evidence import Finding
from bundle.checking.gradient_report import GradientCheckerSummary, Undecided
from bundle.checking.tally import make_report, undecided_points


def verdict(num_checked, num_undecided, *findings):
    """Return the verdict of a check without statistics."""
    return make_report(
        subject="",
        noun="sample",
        tallies=[],
        findings=findings,
        worst=[],
        num_checked=num_checked,
        num_skipped=0,
        gradient_checker=GradientCheckerSummary(),
        undecided=[Undecided("rough", num_undecided, (), "")] if num_undecided else [],
    ).verdict


@pytest.mark.parametrize(
    ("checked", "undecided", "expected"),
    [(2, 0, "correct"), (2, 1, "correct"), (2, 2, "undecided"), (0, 0, "undecided")],
)
def test_a_verdict_needs_a_decided_point(checked, undecided, expected):
    assert verdict(checked, undecided) == expected


@pytest.mark.parametrize(
    ("kind", "columns", "expected"),
    [
        ("unstable", (), "undecided"),
        ("undecided", ("x",), "undecided"),
        ("not_finite", (), "undecided"),  # the residual
        ("not_finite", ("x",), "wrong"),  # a Jacobian
        ("sign", ("x",), "wrong"),
    ],
)
def test_some_findings_decide_nothing(kind, columns, expected):
    assert verdict(2, 0, Finding(kind, columns, "")) == expected
    assert verdict(2, 0, Finding("unstable", (), ""), Finding(kind, columns, "")) == expected


@pytest.mark.parametrize(("count", "named"), [(3, "0; 1; 2)"), (4, "0; 1; 2; ...)")])
def test_three_undecided_places_are_named(count, named):
    (entry,) = undecided_points("sample", {"rough": range(count), "no_value": []}, str)
    assert (entry.count, entry.places) == (count, ("0", "1", "2"))
    assert entry.sentence.endswith(f"({named}")
