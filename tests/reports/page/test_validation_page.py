"""Page of a validation: what it holds, as text."""

import numpy as np
import pytest
from scipy import stats

from bundle.figures.evaluation_figures import (
    difference_figure,
    distribution_figure,
    error_figure,
    image_figure,
)
from bundle.reports.page.result_pages import write_reported
from bundle.reports.terminal.judged import validated
from tests.judging.validation.validations import LENSES, validation
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page, check_self_contained


def write_page(path):
    write_reported(validated("<b>garden</b>", *validation(), {}), path)


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.html"
    write_page(path)
    return Page(path)


def test_page_begins_with_the_verdict_and_has_a_row_per_candidate(page):
    check_self_contained(page)
    _, found = validation()
    text = " ".join(page.text.split())
    assert found.headline[0] in text
    assert found.command in text
    assert text.index(found.command) < text.index("held out")
    titles = next(row for row in page.rows if row[0] == "  lens")
    names = {one[0] for one in LENSES}
    rows = [row for row in page.rows if len(row) == len(titles) and row[0][2:] in names]
    for row, one in zip(rows, found.candidates, strict=True):
        cells = dict(zip(titles, row, strict=True))
        assert cells["free"] == str(one.num_intrinsics)
        assert cells["note"] == (one.error or one.vetoed)
    for name in ("held_out_error", "difference", "distribution", "images"):
        assert f'data-figure="{name}"' in page.source
    assert "expected <b>one</b> size" in text
    assert "<b>garden</b>" in text


@pytest.mark.parametrize("width", [1400, 800, 400])
def test_nothing_is_clipped(browser, tmp_path, width):
    path = tmp_path / "page.html"
    write_page(path)
    check_nothing_is_clipped(browser, path, width)


def test_figures_have_the_numbers_of_the_validation():
    _, found = validation()
    marks = error_figure(found).marks
    lines = {mark.label: mark for mark in marks if getattr(mark, "label", "")}
    assert lines["shared, held out"].x.tolist() == [2, 6]
    expected = [found.candidates[k].held_out_rmse for k in (0, 1)]
    assert lines["shared, held out"].y.tolist() == expected
    bars = difference_figure(found).marks[0]
    order = np.argsort(found.decision.scores)[:4]
    np.testing.assert_array_equal(bars.y, found.decision.differences[order])
    limit = stats.t.isf(stats.norm.sf(2.0), len(set(found.image.tolist())) - 1)
    np.testing.assert_allclose(bars.error, limit * found.decision.standard_errors[order])
    assert f"with {limit:.1f} standard errors" in difference_figure(found).title
    assert difference_figure(found).y.low <= (bars.y - bars.error).min()
    for curve in distribution_figure(found).marks:
        k = next(k for k, one in enumerate(found.candidates) if one.name == curve.label)
        at = np.searchsorted(curve.x, 0.9)
        assert curve.y[at] == pytest.approx(np.mean(found.errors[k] >= curve.x[at]), abs=1e-9)
    dots = image_figure(found).marks[1].xy
    assert dots.shape == (20, 2)
    first = found.errors[found.recommended][found.image == 0]
    assert dots[0, 0] == pytest.approx(np.sqrt(np.mean(first**2)))
