"""Page of a check of Jacobians: verdict, wrong entries, and curves against the step size."""

import re

import numpy as np
import pytest

import bundle
from bundle.checking.step_curve import StepCurve
from bundle.figures.evaluation_figures import step_figure
from bundle.reports.page.result_pages import write_check
from tests.scenes import make_problem

CHART = 'role="img"'


def curve(blocks, factor=1.0):
    a, b = blocks[0]
    times = np.array([0.5, 1.0, 2.0])
    e = np.exp(-b * times)
    return a * e, [np.column_stack([e, -factor * a * times * e])]


def page_of(report, tmp_path, name="<b>curve</b>"):
    write_check(report, tmp_path / "check.html", name=name)
    return (tmp_path / "check.html").read_text()


def test_the_page_of_a_wrong_function(tmp_path):
    names = [("p", ["a<", "b"])]
    report = bundle.check_gradients(
        lambda blocks: curve(blocks, 2.0), [[1.2, 0.7]], names=names, details=True
    )
    (details,) = report.details
    assert details.columns == ("a<", "b")
    np.testing.assert_array_equal(details.is_wrong, [[False, True]] * 3)
    assert details.errors[:, 0].max() < 1e-7
    assert details.errors[:, 1].min() > 0.1
    assert [entry.is_wrong for entry in details.curves] == [True, False]
    wrong = details.curves[0]
    assert wrong.residual == details.errors[:, 1].argmax()
    assert wrong.analytic == pytest.approx(2 * wrong.reference, rel=1e-6)
    text = page_of(report, tmp_path)
    assert "&lt;b&gt;curve&lt;/b&gt;" in text
    assert "<b>curve" not in text
    assert "2.000 times too large" in text
    assert "finding problem" in text
    assert text.count(CHART) == 2
    assert len(re.findall(r">x \de[+-]\d\d<", text)) == 3
    assert not re.search(r"https?://", text)


def test_a_right_function_has_a_v_below_the_tolerance():
    report = bundle.check_gradients(curve, [[1.2, 0.7]], details=True)
    (details,) = report.details
    assert not details.is_wrong.any()
    assert report.ok
    for entry in details.curves:
        distance = np.abs(entry.differences - entry.analytic) / entry.scale
        tip = int(np.nanargmin(distance))
        assert distance[tip] < report.tolerance
        assert entry.parameter == "block 0 [0]" or distance[0] > 1e3 * distance[tip]
        assert distance[-1] > 1e3 * distance[tip]


def test_the_curve_of_a_wrong_entry_has_a_floor():
    steps = 2.0 ** -np.arange(40)
    differences = np.cos(1) * np.sin(steps) / steps
    entry = StepCurve("x", "sample 0", 0, 1.1, np.cos(1), 1e-12, 1, True, steps, differences)
    figure = step_figure(entry, 1e-7)
    given, reference, tolerance = figure.marks
    assert given.y.min() == pytest.approx(1.1 - np.cos(1), rel=1e-3)
    assert reference.y.min() < 1e-10
    assert set(tolerance.y) == {1e-7}
    assert figure.x.is_logarithmic
    assert figure.y.is_logarithmic
    right = StepCurve("x", "sample 0", 0, np.cos(1), np.cos(1), 0, 1, False, steps, differences)
    assert len(step_figure(right, 1e-7).marks) == 2
    nothing = StepCurve("x", "sample 0", 0, 1, 1, 0, 1, False, steps, np.full(40, np.nan))
    assert step_figure(nothing, 1e-7).marks


def test_the_page_of_a_graph_shows_one_factor_per_finding(tmp_path):
    graph = bundle.FactorGraph()
    for k in range(3):
        graph.add_variable(k, [1.2, 0.7 + k])
        for factor in (1.0, -1.0):
            graph.add_factor(bundle.FunctionFactor([k], lambda v, f=factor: curve(v, f)))
    report = graph.check_gradients(details=True)
    text = page_of(report, tmp_path)
    assert text.count(CHART) == len(report.reports[report.findings[0].factor].details[0].curves)
    assert report.findings[0].factor.split(",")[0] in text
    right = bundle.FactorGraph()
    right.add_variable("x", [1.2, 0.7])
    right.add_factor(bundle.FunctionFactor(["x"], curve))
    assert "recommended" in page_of(right.check_gradients(details=True), tmp_path)


def test_curves_of_a_problem_are_those_of_its_residuals():
    """At zero and at turned rotations, by another code than the core's."""
    problem = make_problem(model="RADIAL", num_images=3, num_points=30)
    report = bundle.check_jacobians(problem, details=True)
    (details,) = report.details
    assert details.errors.shape == (2, 6 + 5 + 3)
    assert len(details.curves) == 4
    for entry in details.curves:
        distance = np.abs(entry.differences - entry.analytic) / entry.scale
        assert np.nanmin(distance) < 1e-6


def test_ambient_and_tangent_columns(tmp_path):
    def turn(blocks):
        u, w = blocks[0][:3], blocks[0][3]
        return u * w, [np.c_[w * np.eye(3), 2 * u]]

    start = [np.array([0.1, -0.2, 0.3, 0.9]) / np.sqrt(0.95)]
    for ambient, size in ((True, 4), (False, 3)):
        report = bundle.check_gradients(
            turn, start, ["quaternion_xyzw"], ambient=ambient, details=True
        )
        assert report.details[0].errors.shape == (3, size)
        assert "<svg" in page_of(report, tmp_path)


def test_a_report_without_details_is_refused(tmp_path):
    path = tmp_path / "check.html"
    with pytest.raises(bundle.InputError, match="details=True"):
        write_check(bundle.check_gradients(curve, [[1.2, 0.7]]), path)
    with pytest.raises(bundle.InputError, match="found 3"):
        write_check(3, path)
    assert not path.exists()
