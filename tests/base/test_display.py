"""Displays of public objects: a few lines of text, and HTML with escaped names."""

import dataclasses
from html.parser import HTMLParser

import pytest

import bundle
from bundle.base.display import Display
from bundle.base.tables import render
from bundle.planning.comparison.measured_run import Method
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.screen import laid_out
from tests import scenes
from tests.planning.comparison.fakes import comparison, done, failed
from tests.printed import figures

DENSE = Method(backend="fused", linear_solver_type="dense_schur", num_threads=1)
SPARSE = Method(backend="ceres", linear_solver_type="sparse_schur", num_threads=1)


@pytest.fixture(scope="module")
def problem():
    return scenes.make_problem(num_images=3, num_points=12, shared=True)


@pytest.fixture(scope="module")
def solved(problem):
    return bundle.solve(problem, max_num_iterations=3, loss="huber")


def objects(problem, solved):
    graph = bundle.inspect_graph([(0, 1), (1, 2)], names=["<a>", "b", "c"])
    yield problem
    yield solved
    yield solved.summary
    yield graph
    yield bundle.check_jacobians(problem, samples_per_image=1)
    yield bundle.describe(problem)
    yield bundle.synthesize(num_images=3, num_points=20)
    yield comparison(done(DENSE), failed(SPARSE))
    small = bundle.FactorGraph()
    small.add_variable("<a>", [0.0])
    small.add_factor(bundle.PriorFactor("<a>", [1.0], 4.0))
    yield small
    yield small.factors[0]
    yield small.solve()
    yield small.check_gradients()
    yield done(DENSE)
    yield done(DENSE).measurement
    yield failed(SPARSE)


def is_balanced(markup):
    """Return whether every element that opens is closed, in order."""
    open_tags = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, _):
            open_tags.append(tag)

        def handle_endtag(self, tag):
            assert open_tags.pop() == tag

    Reader().feed(markup)
    return not open_tags


def test_everything_shows_a_few_short_lines_and_html(problem, solved):
    for thing in objects(problem, solved):
        lines = repr(thing).splitlines()
        assert 1 <= len(lines) <= 20, type(thing)
        assert lines[0].startswith(type(thing).__name__), lines[0]
        assert all(line == line.rstrip() and len(line) < 300 for line in lines)
        assert is_balanced(thing._repr_html_()), type(thing)


def test_a_result_shows_outcome_cost_rmse_and_time(solved):
    title, *facts = repr(solved).splitlines()
    before, after = solved.kept.before, solved.kept.after
    expected = [before.rmse, after.rmse, before.median, after.median]
    assert title.startswith("Result: ")
    assert figures(title)[1:5] == [f"{value:.4f}" for value in expected]
    shown = dict(line.split(maxsplit=1) for line in facts)
    summary = solved.summary
    assert shown["cost"] == f"{summary.initial_cost:.6g} -> {summary.final_cost:.6g}"
    assert float(shown["time"].removesuffix(" s")) == pytest.approx(
        solved.build_time_in_seconds + solved.solve_time_in_seconds, abs=1e-3
    )
    assert shown["problem"] == "3 images, 1 camera, 12 points, 36 observations"


def test_a_summary_counts_the_steps_and_not_the_start(solved):
    accepted = solved.iterations["step_is_successful"][1:]
    shown = dict(line.split(maxsplit=1) for line in repr(solved.summary).splitlines()[1:])
    assert shown["steps"] == f"{len(accepted)}, {sum(~accepted.astype(bool))} rejected"


def test_options_show_what_was_changed_and_evaluate_to_themselves():
    options = bundle.SolveOptions(loss="huber", fixed_image_ids=[3, 1])
    assert options.short() == "SolveOptions(loss='huber', fixed_image_ids=(1, 3))"
    assert "\n    loss='huber',  # default: 'trivial'\n    loss_scale=1.0,\n" in repr(options)
    assert eval(repr(options), {"SolveOptions": bundle.SolveOptions}) == options
    assert bundle.SolveOptions().short() == "SolveOptions()"
    assert "#" not in repr(bundle.SolveOptions())
    assert (
        repr(bundle.SolveOptions()).count("\n") == len(dataclasses.fields(bundle.SolveOptions)) + 1
    )


def test_a_comparison_shows_every_run_and_no_nan():
    text = repr(comparison(done(DENSE), failed(SPARSE)))
    assert "timed out" in text
    assert "nan" not in text
    assert DENSE.name in text and SPARSE.name in text


def test_html_escapes_what_users_named():
    display = Display(
        title="<title>", facts=(("<label>", "a & b"),), head=("<head>",), rows=(("<cell>",),)
    )
    markup = display.html()
    for word in ("title", "label", "head", "cell"):
        assert f"&lt;{word}&gt;" in markup
        assert f"<{word}>" not in markup
    assert "a &amp; b" in markup


def test_columns_of_text_are_aligned():
    rows = (("short", "1"), ("a longer one", "22222"))
    text = Display(
        title="T", facts=(("a", "x"), ("bcd", "y")), head=("name", "n"), rows=rows
    ).text()
    assert text.splitlines() == [
        "T",
        "  a    x",
        "  bcd  y",
        "  name              n",
        "  short             1",
        "  a longer one  22222",
    ]


def test_a_comparison_that_was_interrupted_at_once_prints_no_nan():
    never = failed(DENSE, outcome="not_run", message="the comparison was interrupted before")
    stopped = comparison(never, interrupted=True)
    assert "nan" not in repr(stopped).lower()
    assert "nan" not in render(*laid_out(compared(stopped))).lower()


def test_a_notebook_gets_texts_instead_of_what_rich_displays(solved, monkeypatch):
    expected = solved.summary.full_report(), solved.summary.breakdown()
    assert all("total" in text for text in expected)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert (solved.summary.full_report(), solved.summary.breakdown()) == expected


def test_the_first_column_of_a_table_is_text():
    html = Display(title="t", head=("name", "n"), rows=(("a", "1"), ("b", "2"))).html()
    assert html.count('style="text-align:left"') == html.count('style="text-align:right"') == 3
