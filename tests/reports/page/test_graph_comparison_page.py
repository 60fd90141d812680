"""Page of a comparison on a graph."""

import pytest

import bundle
from bundle.planning.comparison.graph_comparison import compare_graph
from bundle.reports.page.result_pages import write_comparison, write_reported
from bundle.reports.terminal.graph_costs import compared_runs
from tests.graphs.pose_graphs import graphs
from tests.reports.page.reader import Page, check_self_contained


@pytest.fixture(scope="module")
def found():
    graph = graphs.loop(2, num_poses=40, num_closures=20, noise=0.02, start_noise=0.2)
    return compare_graph(graph, max_num_iterations=20)


def page_of(found, path, name="a graph", **how):
    write_reported(compared_runs(found, name, **how), path)
    page = Page(path)
    check_self_contained(page)
    return page


def test_every_run_is_a_row(found, tmp_path):
    page = page_of(found, tmp_path / "a.html", name="<b>x.g2o</b>")
    assert found.reason in page.text and found.command in page.text
    assert "<b>x.g2o</b>" in page.text
    names = [row[0].removesuffix(" *") for row in page.rows]
    for run in found.runs:
        row = page.rows[names.index(run.method.name)]
        assert f"{run.chi2_final:.9g}" in row
    assert "Cost against time" in page.text and "Where the time went" in page.text


def test_orders_have_their_factor(found, tmp_path):
    page = page_of(found, tmp_path / "a.html", orders_only=True)
    assert "nnz(L)" in page.text


def test_a_comparison_without_a_solution_has_no_figures(tmp_path):
    graph = graphs.loop(2, num_poses=40, num_closures=20)
    failed = compare_graph(graph, timeout=1e-9)
    page = page_of(failed, tmp_path / "a.html")
    assert failed.recommended is None
    assert "Cost against time" not in page.text and failed.reason in page.text


def test_factor_graphs_and_the_public_function(tmp_path):
    graph = bundle.FactorGraph()
    for key in range(5):
        graph.add_variable(key, [float(key * key)])
    graph.add_factor(bundle.PriorFactor(0, [0.0], [[1.0]]))
    for key in range(4):
        graph.add_factor(bundle.BetweenFactor(key, key + 1, [1.0], [[4.0]]))
    write_comparison(bundle.compare(graph), tmp_path / "a.html")
    page = Page(tmp_path / "a.html")
    check_self_contained(page)
    assert "dogleg" in page.text
