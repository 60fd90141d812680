"""The page of a comparison says what the comparison holds, whatever its inputs are called."""

from __future__ import annotations

import dataclasses

import pytest

from bundle.base.words import seconds
from bundle.reports.page.result_pages import write_comparison
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


def test_every_run_is_in_its_tables_or_a_warning_with_its_message(written):
    made = comparison()
    page = written(made)
    usable = [run for run in made.runs if run.is_usable]
    rows = [row for row in page.rows if row[0] in {method.name for method in METHODS}]
    results, times, shares = 3 * [len(usable)]
    predictions, profiles = len(made.runs), 3 * len(METHODS)
    assert len(rows) == results + times + shares + predictions + profiles
    told = {run.outcome: run.message for run in made.runs if not run.is_usable}
    assert set(told) == {"timed_out", "out_of_memory"}
    for run in made.runs:
        assert run.is_usable or f"{run.method.name}: {run.message}" in page.text
    first = usable[0]
    titles = next(row for row in page.rows if row[:2] == ["method", "cost"])
    cells = dict(zip(titles, rows[0], strict=True))
    assert cells["cost"] == f"{first.final_cost:#.7g}" and cells["gap"] == "0"
    assert cells["total [s]"] == seconds(first.total_time_in_seconds)
    assert page.source.count('class="best"') == 2  # the recommended method on each input


def test_names_that_are_markup_stay_text(written):
    page = written(comparison())
    assert HOSTILE in page.text
    assert page.scripts == []


def test_recommendation_leads(written):
    made = comparison()
    page = written(made)
    assert made.recommendation.reason in page.text
    assert made.recommendation.command in page.text
    assert "Interrupted" not in page.text
    lost = written(dataclasses.replace(made, recommendation=None, interrupted=True))
    assert made.recommendation.command not in lost.text
    assert "Interrupted: methods that had not run are missing." in lost.text


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
    assert page.text.count(": killed.") == len(runs)
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
