"""Projection uncertainty on the report page: what is drawn is what the page holds."""

import json

import numpy as np
import pytest

import bundle
from bundle.figures.projection_uncertainty import projection_uncertainty
from bundle.reports.page.report_page import write_report
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page
from tests.scenes import make_problem


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    problem = make_problem(num_images=6, num_points=100, shared=True, seed=4)
    solved = bundle.solve(problem, max_num_iterations=20)
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(solved, path)
    return solved, path, Page(path)


def test_every_cell_and_contour_is_that_of_the_numbers(page, browser):
    solved, path, read = page
    cov = bundle.covariance(solved, scale="sigma0")
    known = projection_uncertainty(solved.problem, 0, cov.camera(1), sigma=cov.sigma0)
    (held,) = json.loads(read.scripts[0])["projection"]
    rows, columns = held["rows"], held["columns"]
    maps = {
        "uncertainty at infinity": ("infinity", known.sigma()),
        "uncertainty at the median distance": ("at_distance", known.sigma(known.distance)),
    }
    assert held["count"] == known.count.ravel().tolist()
    assert sum(held["count"]) == 600
    browser.open(path)
    drawn = browser.evaluate(
        "Object.fromEntries([...document.querySelectorAll('.contours')].map((g) =>"
        " [g.ownerSVGElement.ariaLabel, {"
        "  cells: [...g.ownerSVGElement.querySelectorAll('.heat rect')].map((r) => "
        "   [+r.dataset.cell, +r.getAttribute('fill-opacity'), +r.getAttribute('x'),"
        "    +r.getAttribute('y'), r.textContent]),"
        "  lines: [...g.querySelectorAll('path')].map((p) => [+p.dataset.level,"
        "   p.getAttribute('d')]), texts: [...g.querySelectorAll('text')].map((t) =>"
        "   +t.textContent)}]))"
    )
    both = np.array([held["infinity"], held["at_distance"]], float)
    assert held["top"] == pytest.approx(np.quantile(both, 0.98), rel=1e-4)
    width, height = 400.0 / columns, 300.0 / rows
    for label, (name, expected) in maps.items():
        values = np.array(held[name], float)
        np.testing.assert_allclose(values, expected.ravel(), rtol=1e-5)
        assert [cell[0] for cell in drawn[label]["cells"]] == list(range(rows * columns))
        for cell, opacity, x, y, title in drawn[label]["cells"]:
            assert opacity == pytest.approx(min(values[cell] / held["top"], 1.0), abs=6e-4)
            row, column = divmod(cell, columns)
            assert (x, y) == pytest.approx((2 + column * width, 2 + row * height), abs=0.06)
            assert float(title.split()[0]) == pytest.approx(values[cell], rel=6e-3)
        grid = values.reshape(rows, columns)
        assert drawn[label]["lines"]
        assert drawn[label]["texts"] == [level for level, _ in drawn[label]["lines"]]
        for level, path_data in drawn[label]["lines"]:
            assert values.min() < level < values.max()
            ends = np.array(
                [
                    [float(v) for v in end.split()]
                    for part in path_data.split("M")[1:]
                    for end in part.split("L")
                ]
            )
            at = (ends - 2) / (width, height) - 0.5  # in middles of cells
            low = np.clip(np.floor(at).astype(int), 0, (columns - 2, rows - 2))
            share, (i, j) = at - low, low.T
            mean = (
                grid[j, i] * (1 - share[:, 0]) * (1 - share[:, 1])
                + grid[j, i + 1] * share[:, 0] * (1 - share[:, 1])
                + grid[j + 1, i] * (1 - share[:, 0]) * share[:, 1]
                + grid[j + 1, i + 1] * share[:, 0] * share[:, 1]
            )
            steps = np.abs(np.diff(grid)).max()
            np.testing.assert_allclose(mean, level, atol=0.02 * steps)  # drawn to 0.1 px
    assert browser.complaints() == []
    for name, values in known.by_distance().items():
        np.testing.assert_allclose(held["curves"][name], values, rtol=1e-5)


def test_it_fits_in_narrow_windows(page, browser):
    for width in (1200, 390):
        check_nothing_is_clipped(browser, page[1], width)


def test_held_intrinsics_and_panoramas_have_no_map(tmp_path):
    problem = make_problem(num_images=4, num_points=50, shared=True)
    solved = bundle.solve(problem, refine=("poses", "points"), max_num_iterations=5)
    write_report(solved, tmp_path / "held.html")
    assert "projection" not in json.loads(Page(tmp_path / "held.html").scripts[0])
    panorama = make_problem(num_images=4, num_points=50, shared=True, model="EQUIRECTANGULAR")
    write_report(panorama, tmp_path / "panorama.html")
    read = Page(tmp_path / "panorama.html")
    assert "projection" not in json.loads(read.scripts[0])
    assert "sigma0" in read.text
