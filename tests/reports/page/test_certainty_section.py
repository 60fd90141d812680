"""The section on certainty with priors, and without certainty."""

import numpy as np

import bundle
from bundle import InputError
from bundle.reports.page import report_page
from bundle.reports.page.report_page import write_report
from tests.reports.page.reader import Page
from tests.scenes import make_problem

RULE = ("cameras *: f prior 1 %",)


def test_rules_of_the_solve_count(tmp_path):
    problem = make_problem(num_images=5, num_points=40, shared=True)
    solved = bundle.solve(problem, constraints=RULE)
    notes = write_report(solved, tmp_path / "without.html")
    assert any("No covariance" in note for note in notes)
    assert notes[0] in Page(tmp_path / "without.html").text
    assert write_report(solved, tmp_path / "with.html", constraints=RULE) == ()
    cov = bundle.covariance(solved, constraints=RULE, scale="sigma0")
    rows = {row[2]: row[-1] for row in Page(tmp_path / "with.html").rows if len(row) == 6}
    assert float(rows["f"]) == np.float64(f"{np.sqrt(cov.camera(1)[0, 0]):.4g}")


def test_a_refusal_is_computed_once(tmp_path, monkeypatch):
    calls = []

    def refuse(*_, **__):
        calls.append(1)
        raise InputError("cameras: expected something else.")

    monkeypatch.setattr(report_page, "compute_covariance", refuse)
    solved = bundle.solve(make_problem(), max_num_iterations=2)
    (note,) = write_report(solved, tmp_path / "page.html")
    assert len(calls) == 1
    assert note == "No covariance: cameras: expected something else."
    assert note in Page(tmp_path / "page.html").text


def test_a_covariance_of_some_blocks_is_enough(tmp_path):
    """The page shows what there is, and the findings compute what they need."""
    solved = bundle.solve(make_problem(num_images=5, num_points=40, shared=True), constraints=RULE)
    whole, poses, unit = (
        bundle.covariance(solved, constraints=RULE, **settings)
        for settings in ({"scale": "sigma0"}, {"of": "poses", "scale": "sigma0"}, {})
    )
    assert poses.lens_sigmas is None and unit.lens_sigmas is None
    sigmas, sigma0 = whole.lens_sigmas
    assert sigma0 == whole.sigma0
    np.testing.assert_array_equal(sigmas[0], np.sqrt(np.diag(whole.camera(1))))
    path = tmp_path / "page.html"
    assert write_report(solved, path, covariance=poses, constraints=RULE) == ()
    names = " ".join(row[0] for row in Page(path).rows if row)
    assert "position of a camera" in names and "point, worst direction" not in names
