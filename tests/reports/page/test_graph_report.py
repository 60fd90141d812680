"""The page of a graph: the same from a file and as a FactorGraph, kinds, worst edges, views."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.reports.page.graph_facts import facts_of_factor_graph, facts_of_pose_graph
from bundle.reports.page.graph_report import _drawn, error_kinds
from tests.analysis.uncertainty.test_factor_graph_covariance import landmarks
from tests.graphs.factors import both_ways
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.chordal_oracle import ring
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page, check_self_contained

SECTIONS = ("Trajectory", "Errors by kind", "Worst edges", "Certainty", "Structure")


def loop(dimension, **kinds):
    return graphs.loop(dimension, num_poses=16, num_closures=6, **kinds)


@pytest.fixture(scope="module", params=[2, 3])
def solved(request):
    return bundle.solve(loop(request.param))


@pytest.fixture(scope="module")
def page(solved, tmp_path_factory):
    path = tmp_path_factory.mktemp("graph") / "page.html"
    assert bundle.report(solved, path, name="a <loop> & back.g2o") == ()
    return path, Page(path)


def test_the_page_has_every_part(solved, page):
    path, read = page
    if solved.problem.dimension == 2:  # three.js names addresses, which it does not load
        check_self_contained(read)
    for title in (*SECTIONS, "Convergence"):
        assert title in read.text
    assert "a <loop> & back.g2o: Converged" in read.text and "16 poses" in read.text
    (odometry,) = [row for row in read.rows if row and row[0] == "odometry"]
    assert odometry[1] == "15" and len(odometry) == 6
    is_spatial = solved.problem.dimension == 3
    assert ("scene" in json.loads(read.scripts[0] if read.scripts else "{}")) == is_spatial
    assert [row[0] for row in read.rows if row and row[0] in ("natural", "amd *", "metis")] == [
        "natural", "amd *", "metis",
    ]  # fmt: skip
    assert path.stat().st_size < 1.5e6


def test_expected_chi2_is_the_redundancy(solved):
    facts = facts_of_pose_graph(solved)
    rows = error_kinds(facts)
    diagnosis = bundle.diagnose(solved)
    assert [row["kind"] for row in rows] == ["odometry", "closure"]
    np.testing.assert_allclose(sum(row["chi2"] for row in rows), solved.summary.chi2_final)
    d = solved.problem.tangent_size
    np.testing.assert_allclose(
        sum(row["expected"] for row in rows), diagnosis.edge_redundancy.sum()
    )
    np.testing.assert_allclose(sum(row["expected"] for row in rows), d * (21 - 15), rtol=1e-9)
    away = facts_of_pose_graph(solved.initial_problem)
    assert np.isnan([row["ratio"] for row in error_kinds(away)]).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_factor_graph_has_the_numbers_of_the_file(dimension, tmp_path):
    solved = bundle.solve(loop(dimension)).problem
    solved = solved.replace(fixed=np.arange(16) == 0)
    bundle.save(solved, tmp_path / "x.g2o")
    theirs = facts_of_pose_graph(bundle.load(tmp_path / "x.g2o"))
    ours = facts_of_factor_graph(both_ways.of_pose_graph(solved), None)
    for name in ("positions", "rotations", "chi2", "ends", "sizes"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-9)
    np.testing.assert_allclose(
        ours.diagnosis.edge_redundancy, theirs.diagnosis.edge_redundancy, atol=1e-9
    )
    assert ours.inspection == theirs.inspection
    bundle.report(both_ways.of_pose_graph(solved), tmp_path / "ours.html")
    bundle.report(tmp_path / "x.g2o", tmp_path / "theirs.html")
    rows = [Page(tmp_path / name).rows for name in ("ours.html", "theirs.html")]
    structure = [[row for row in one if row and row[0] in ("amd", "[dense]")] for one in rows]
    assert structure[0] == structure[1]


def test_any_other_factor_graph_has_a_page(tmp_path):
    graph = landmarks()
    bundle.report(graph, tmp_path / "x.html", result=graph.solve())
    read = Page(tmp_path / "x.html")
    kinds = {row[0] for row in read.rows if row}
    assert {"BetweenFactor", "FunctionFactor", "PriorFactor"} <= kinds
    assert "Convergence" in read.text and "10 variables" in read.text


def test_reprojections_have_the_page_of_their_problem(tmp_path):
    problem = bundle.synthesize(bundle.SceneOptions(num_images=5, num_points=30, seed=2)).problem
    bundle.report(both_ways.of_problem(problem, held=(1, 2)), tmp_path / "x.html")
    assert "5 images" in Page(tmp_path / "x.html").text


def test_wrong_arguments_are_one_line(tmp_path):
    graph, path = loop(2), tmp_path / "x.html"
    for given, words in (
        ({"images": "photos"}, r"^images: expected only with a reconstruction"),
        ({"result": 3}, r"^result: expected only with a factor graph"),
    ):
        with pytest.raises(bundle.InputError, match=words):
            bundle.report(graph, path, **given)
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one variable"):
        bundle.report(bundle.FactorGraph(), path)
    assert not path.exists()


def test_the_commands_write_it(tmp_path, capsys):
    bundle.save(loop(2), tmp_path / "x.g2o")
    source, page = str(tmp_path / "x.g2o"), str(tmp_path / "x.html")
    assert main(["report", source, "-o", page, "--quiet", "--json", str(tmp_path / "r.json")]) == 0
    said = json.loads((tmp_path / "r.json").read_text())
    assert said["output"] == {"path": page, "format": "html"} and said["input"]["num_poses"] == 16
    assert (
        "Wrote" in capsys.readouterr().out and "Convergence" not in Page(tmp_path / "x.html").text
    )
    target = str(tmp_path / "y.g2o")
    assert main(["refine", source, "-o", target, "--html", page, "--quiet"]) == 0
    assert "Convergence" in Page(tmp_path / "x.html").text
    assert main(["report", source, "-o", page, "--gps", "exif"]) == 2
    assert capsys.readouterr().err.startswith("error: --gps: valid only with a reconstruction")


@pytest.mark.parametrize("width", [400, 800, 1200])
def test_nothing_is_clipped(page, browser, width):
    check_nothing_is_clipped(browser, page[0], width)


def test_the_view_draws_edges_and_hides_them(browser, tmp_path):
    bundle.report(bundle.solve(loop(3)), tmp_path / "x.html")
    browser.open(tmp_path / "x.html")
    browser.wait_for("Number(document.querySelector('.scene').dataset.drawn) > 0")
    before = int(browser.evaluate("document.querySelector('.scene').dataset.drawn"))
    browser.click('[data-shows="edges"]')
    browser.click('[data-state="before"]')
    browser.wait_for(f"Number(document.querySelector('.scene').dataset.drawn) > {before}")
    assert browser.complaints() == []
    assert all(url.startswith("file:") for url in browser.requested())


def test_a_certificate_has_its_section(browser, tmp_path):
    path = tmp_path / "x.html"
    bundle.report(bundle.solve(loop(2), certify=True), path)
    facts = dict(row for row in Page(path).rows if len(row) == 2)
    assert facts["certificate"] == "certified" and "staircase" not in facts
    assert "globally optimal within" in Page(path).text
    wound = ring(np.random.default_rng(1), 16, 2, turns=1)
    bundle.report(bundle.solve(wound, init="file", certify=True), path)
    facts = dict(row for row in Page(path).rows if len(row) == 2)
    assert facts["certificate"] == "not-certified"
    assert facts["staircase"].startswith("certified at rank ")
    assert "The first minimum" in Page(path).text
    for width in (400, 1200):
        check_nothing_is_clipped(browser, path, width)
    bundle.report(bundle.solve(loop(2)), path)
    assert "Certificate" not in Page(path).text


@pytest.mark.parametrize("count", [16, 300])
def test_inspect_writes_the_page_of_a_structure(count, tmp_path, capsys):
    graph = graphs.loop(2, num_poses=count, num_closures=6)
    bundle.save(graph, tmp_path / "x.g2o")
    page = str(tmp_path / "x.html")
    assert main(["inspect", str(tmp_path / "x.g2o"), "--html", page, "--quiet"]) == 0
    read = Page(tmp_path / "x.html")
    check_self_contained(read)
    found = bundle.inspect(graph)
    (row,) = [row for row in read.rows if row and row[0].removesuffix(" *") == "metis"]
    cost = next(cost for cost in found.costs if cost.ordering == "metis")
    assert row[1] == str(cost.nnz_factor) and row[7].split()[1] in ("µs", "ms")
    assert "Matrix and factor" in read.text
    # small graphs can be stepped through in every order
    assert ("Elimination step by step" in read.text) == (count <= 120)
    if count <= 120:
        orders = json.loads(read.scripts[0])["elimination"]
        assert "nesdis" in json.dumps(orders) and "minimum" in json.dumps(orders)
    capsys.readouterr()


def test_the_page_of_a_structure_is_not_clipped(browser, tmp_path):
    bundle.save(loop(3), tmp_path / "x.g2o")
    assert main(["inspect", str(tmp_path / "x.g2o"), "--html", str(tmp_path / "x.html")]) == 0
    for width in (400, 1200):
        check_nothing_is_clipped(browser, tmp_path / "x.html", width)
    assert browser.complaints() == []


def test_the_trajectory_is_the_odometry_in_any_order_of_poses():
    graph = graphs.loop(2, num_closures=0)
    shuffled = np.random.default_rng(2).permutation(graph.num_poses)
    moved = graph.replace(
        poses=graph.poses[np.argsort(shuffled)],
        ids=10 * np.argsort(shuffled),
        edges=shuffled[graph.edges],
    )
    for one in (graph, moved):
        drawn = _drawn(facts_of_pose_graph(one))
        assert len(drawn.path) == graph.num_edges and len(drawn.others) == 0


def test_the_top_has_the_answer_and_what_to_do(solved, tmp_path):
    """Away from a minimum the command that finds one; at it, what chi2 says of the information."""
    graph = solved.initial_problem
    moved = graph.poses.copy()
    moved[5, :2] += 0.3
    start = graph.replace(poses=moved)
    for source in (start, solved):
        path = tmp_path / "page.html"
        bundle.report(source, path, name="a b.g2o")
        above, _, below = Page(path).text.partition("From above")
        refine = "bundle refine 'a b.g2o' -o OUTPUT"
        assert (refine in above) == (source is start) and refine not in below
        assert ("Not at a minimum" in above) == (source is start)
    weak = bundle.solve(graph.replace(information=1e4 * graph.information))
    bundle.report(weak, path, name="a b.g2o")
    assert "too optimistic" in Page(path).text.partition("From above")[0]
