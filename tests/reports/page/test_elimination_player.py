"""The slider, moved in a real browser: every step shows what the elimination did."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bundle.planning.inspection.graph_inspection import inspect_graph
from bundle.reports.page.elimination_player import MOST_VARIABLES
from bundle.reports.page.inspection_page import write_inspection
from tests.reports.page.reader import Page, check_self_contained

CYCLE = [(i, (i + 1) % 6) for i in range(6)]
HOSTILE = "</script><img src=x onerror=alert(1)>"


def loops(num_variables):
    """A chain that comes back to itself."""
    chain = [(i, i + 1) for i in range(num_variables - 1)]
    return [*chain, (0, num_variables - 1), (2, num_variables // 2)]


@pytest.fixture
def page_of(tmp_path):
    def write(*graphs):
        path = tmp_path / "graph.html"
        write_inspection(graphs[0] if len(graphs) == 1 else graphs, path)
        check_self_contained(Page(path))
        return path

    return write


@pytest.fixture
def cycle(browser, page_of) -> Path:
    """The six-cycle in natural order, open in the browser: fill 3, 44 flops."""
    path = page_of(inspect_graph(CYCLE, 6))
    browser.open(path)
    return path


def shown(browser):
    """Return (steps done, eliminated nodes, fill edges, fill cells, the bill) as displayed."""
    return (
        browser.text("#where"),
        browser.count("#graph .node.eliminated"),
        browser.count("#graph .fill.shown"),
        browser.count("#matrix .cell.filled.shown"),
        browser.text("#total-fill"),
        browser.text("#total-flops"),
    )


def test_page_starts_before_the_first_step(browser, cycle):
    assert shown(browser) == ("0 of 6", 0, 0, 0, "0", "0")
    assert "3 fill edges and costs 44 flops" in browser.text("#sentence")
    assert browser.requested() == [cycle.as_uri()]
    assert browser.complaints() == []


def test_mouse_on_the_slider_moves_the_elimination(browser, cycle):  # noqa: ARG001
    browser.click("#step", 0.999)
    assert shown(browser) == ("6 of 6", 6, 3, 6, "3", "44")
    browser.click("#step", 0.5)
    assert shown(browser)[0] == "3 of 6"
    browser.click("#step", 0.001)
    assert shown(browser) == ("0 of 6", 0, 0, 0, "0", "0")


@pytest.mark.parametrize("focused", [True, False], ids=["slider focused", "nothing focused"])
def test_keys_step_and_jump(browser, cycle, focused):  # noqa: ARG001
    browser.click("#step" if focused else "h1", 0.001)
    seen = [browser.text("#where")]
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "End", "ArrowRight", "Home", "ArrowLeft"):
        browser.press(key)
        seen.append(browser.text("#where"))
    assert seen == [f"{step} of 6" for step in (0, 1, 2, 1, 6, 6, 0, 0)]


@pytest.mark.parametrize("ordering", ["natural", "minimum_degree"])
def test_every_step_shows_what_was_eliminated(browser, page_of, ordering):
    graph = inspect_graph(loops(11), 11, ordering=ordering)
    browser.open(page_of(graph))
    for done, step in enumerate(graph.steps, 1):
        browser.click("#forward")
        fill = step.total_fill
        bill = (f"{step.total_fill:,}", f"{step.total_flops:,}")
        assert shown(browser) == (f"{done} of 11", done, fill, 2 * fill, *bill)
        assert browser.count("#graph .fill.fresh") == len(step.fill)
        assert browser.count("#graph .node.touched") == len(step.neighbours)
        assert browser.text("#graph .node.pivot title") == graph.names[step.variable]
        assert graph.names[step.variable] in browser.text("#sentence")
    browser.click("#back")
    assert browser.text("#where") == "10 of 11"


def test_matrix_has_a_cell_for_every_nonzero(browser, page_of):
    graph = inspect_graph(loops(11), 11)
    browser.open(page_of(graph))
    assert browser.count("#matrix .cell:not(.filled)") == graph.nnz
    browser.press("End")
    lower = "[...document.querySelectorAll('#matrix .cell')].filter(c => +c.getAttribute('x') <= "
    lower += "+c.getAttribute('y') && getComputedStyle(c).visibility === 'visible').length"
    assert browser.evaluate(lower) == graph.nnz_factor


def test_play_runs_to_the_end_and_stops(browser, cycle):  # noqa: ARG001
    browser.press("End")
    browser.press("ArrowLeft")
    browser.click("#play")
    assert browser.text("#play") == "Pause"
    browser.wait_for("document.querySelector('#where').textContent === '6 of 6'")
    assert browser.text("#play") == "Play"
    browser.click("h1")
    browser.press(" ")  # from the end it begins anew
    assert shown(browser)[0] == "0 of 6" and browser.text("#play") == "Pause"
    browser.press(" ")
    assert browser.text("#play") == "Play"


def test_orders_of_one_graph_can_be_chosen(browser, page_of):
    graphs = [inspect_graph(loops(11), 11, ordering=name) for name in ("natural", "minimum_degree")]
    assert graphs[0].flops != graphs[1].flops
    browser.open(page_of(*graphs))
    browser.press("End")
    for index, graph in enumerate(graphs):
        browser.evaluate(
            f"run.value = {index}; run.dispatchEvent(new Event('change', {{bubbles: true}}))"
        )
        assert shown(browser)[-1] == f"{graph.flops:,}"
        assert browser.count("#graph .fill.shown") == graph.fill


def test_names_are_text_wherever_they_stand(browser, page_of):
    path = page_of(inspect_graph([(0, 1)], 2, names=[HOSTILE, "b"]))
    assert json.loads(Page(path).scripts[0])["elimination"]["names"] == [HOSTILE, "b"]
    browser.open(path)
    browser.press("ArrowRight")
    assert browser.text("#sentence").startswith(f"Eliminating {HOSTILE} costs 4 flops")
    assert browser.count("img[onerror]") == 0
    assert browser.complaints() == []


@pytest.mark.parametrize("width", [320, 390, 1300])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_fits_its_window_in_the_scheme_asked_for(browser, cycle, width, scheme):
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width, height=800, deviceScaleFactor=1, mobile=width < 500,
    )  # fmt: skip
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.call("Emulation.setEmulatedMedia", features=[feature])
    browser.open(cycle)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    paper = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") == (scheme == "light")
    browser.call("Emulation.clearDeviceMetricsOverride")
    browser.call("Emulation.setEmulatedMedia", features=[])


def test_table_of_steps_needs_no_script(page_of):
    graph = inspect_graph(CYCLE, 6)
    rows = Page(page_of(graph)).rows
    steps = [row for row in rows if len(row) == 7 and row[1].isdigit()]
    assert [int(row[4]) for row in steps[:6]] == [step.flops for step in graph.steps]
    assert steps[5][5:] == ["3", "44"]


def test_one_order_is_compared_to_others(page_of):
    hub_first = inspect_graph([(0, leaf) for leaf in range(1, 7)], 7)
    page = Page(page_of(hub_first))
    flops = {row[0]: row[5] for row in page.rows if len(row) == 9}
    assert flops == {"order": "flops", "natural": "154", "minimum degree": "24"}
    leaves_first = inspect_graph([(0, leaf) for leaf in range(1, 7)], 7, [1, 2, 3, 4, 5, 6, 0])
    page = Page(page_of(leaves_first))
    orders = [run["ordering"] for run in json.loads(page.scripts[0])["elimination"]["runs"]]
    assert orders[:2] == ["given", "natural"]


def test_a_graph_too_large_to_draw_says_so(page_of):
    count = MOST_VARIABLES + 1
    page = Page(page_of(inspect_graph(loops(count), count)))
    assert "up to 120 variables are drawn step by step" in page.text
    assert page.scripts == []


@pytest.mark.parametrize("count", [0, 1])
def test_next_to_nothing_can_be_stepped(browser, page_of, count):
    browser.open(page_of(inspect_graph([], count)))
    assert browser.complaints() == []
    browser.press("End")
    assert browser.text("#where") == f"{count} of {count}"
