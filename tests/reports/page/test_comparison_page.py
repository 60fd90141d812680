"""The page of a comparison says what the comparison holds, whatever its inputs are called."""

from __future__ import annotations

import dataclasses

import pytest

from bundle.reports.page.comparison_page import write_comparison
from tests.figures.matplotlib.comparisons import HOSTILE, METHODS, comparison
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page, check_self_contained


@pytest.fixture
def written(tmp_path):
    def write(made):
        path = tmp_path / "comparison.html"
        write_comparison(made, path)
        page = Page(path)
        check_self_contained(page)
        return page

    return write


def test_every_run_is_a_row_with_its_outcome(written):
    made = comparison()
    page = written(made)
    rows = [row for row in page.rows if row[0] in {method.name for method in METHODS}]
    runs, predictions = len(made.runs), len(made.runs)
    assert len(rows) == runs + predictions
    outcomes = [row[-1] for row in rows]
    told = {run.outcome: run.message for run in made.runs if not run.is_usable}
    assert set(told) == {"timed_out", "out_of_memory"}
    for outcome, message in told.items():
        assert any(
            cell.startswith(outcome.replace("_", " ")) and message in cell for cell in outcomes
        )
    first = made.runs[0]
    assert rows[0][1] == f"{first.final_cost:#.7g}" and rows[0][2] == "best"
    assert rows[0][5] == f"{first.total_time_in_seconds:.2f} s"


def test_names_that_are_markup_stay_text(written):
    page = written(comparison())
    assert HOSTILE in page.text
    assert page.scripts == []


def test_recommendation_leads(written):
    made = comparison()
    page = written(made)
    assert made.recommendation.reason in page.text
    assert made.recommendation.command in page.text
    lost = written(dataclasses.replace(made, recommendation=None, interrupted=True))
    assert made.recommendation.command not in lost.text
    assert lost.source.count('class="warn"') == page.source.count('class="warn"') + 1


def test_profiles_need_several_problems(written):
    headings = [written(comparison(count)).source.count("<h2") for count in (1, 2)]
    assert headings == [1, 2 + 1]  # one a problem, and the profiles


def test_a_comparison_of_failures_is_a_page_too(written):
    made = comparison(1)
    runs = tuple(
        dataclasses.replace(run, outcome="died", message="killed.", measurements=())
        for run in made.runs
    )
    page = written(dataclasses.replace(made, runs=runs, recommendation=None))
    assert page.text.count("died: killed.") == len(runs)
    assert 'class="bars"' not in page.source


def test_browser_shows_it_without_asking_for_anything(browser, tmp_path):
    path = tmp_path / "comparison.html"
    write_comparison(comparison(), path)
    browser.open(path)
    assert browser.complaints() == []
    assert browser.requested() == [path.as_uri()]
    assert browser.evaluate("document.title") == "Solvers compared: 2 problems"
    # One curve a run with a trace and problem, and one a method in each of the three profiles.
    assert browser.count("svg[role=img] .curve") == 13 + 3 * len(METHODS)


@pytest.mark.parametrize("width", [1300, 800, 400])
def test_nothing_is_clipped(browser, tmp_path, width):
    path = tmp_path / "comparison.html"
    write_comparison(comparison(), path)
    check_nothing_is_clipped(browser, path, width)
