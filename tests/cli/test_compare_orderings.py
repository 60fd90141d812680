"""`bundle compare --ordering all`: one table of the elimination orders."""

import json

import bundle
from tests.campaigns.triage_inputs import chain_of_poses
from tests.cli.test_bad_input import assert_refused
from tests.graphs.pose_graphs import graphs
from tests.scenes import make_problem, scene


def test_orders_of_a_pose_graph(run, tmp_path):
    graph = chain_of_poses(0, 300, 60)
    bundle.save(graph, tmp_path / "walk.g2o")
    words = (tmp_path / "walk.g2o", "--ordering", "all", "--repeat", 1, "--quiet")
    code, out, _ = run("compare", *words)
    assert code == 0
    for title in ("nnz(L)", "flops", "predicted", "a step", "sigmas"):
        assert title in out
    code, out, _ = run("compare", *words, "--json", "-")
    runs = json.loads(out)["runs"]
    assert [one["ordering"] for one in runs] == ["amd", "metis", "natural"]
    costs = {cost.ordering: cost for cost in bundle.inspect(graph).costs}
    for one in runs:
        assert one["summary"]["factor_flops"] == costs[one["ordering"]].flops
        assert one["summary"]["num_factor_nonzeros"] == costs[one["ordering"]].nnz_factor
        assert one["predicted_time_per_step_in_seconds"] > 0
        assert one["time_per_step_in_seconds"] > 0
        assert one["distance_in_sigmas"] < 1e-3


def test_orders_of_a_model(run, tmp_path):
    bundle.save(make_problem(), tmp_path / "model.txt")
    code, out, _ = run(
        *("compare", tmp_path / "model.txt", "--ordering", "all", "--quiet", "--json", "-"),
        *("--solvers", "dense-schur", "--backends", "ceres", "--repeat", 1, "--threads", 1),
    )
    assert code == 0
    found = {one["method"]["linear_solver_ordering"] for one in json.loads(out)["runs"]}
    assert found == {"POINTS_FIRST", "CAMERAS_FIRST", "AUTOMATIC"}


def test_a_page_of_orders(run, tmp_path):
    bundle.save(chain_of_poses(0, 100, 20), tmp_path / "walk.g2o")
    page = tmp_path / "page.html"
    code, _, _ = run(
        *("compare", tmp_path / "walk.g2o", "--ordering", "all", "--quiet", "--html", page)
    )
    assert code == 0
    assert "nnz(L)" in page.read_text() and "Cost against time" in page.read_text()


def test_a_pose_graph_is_compared_alone(run, tmp_path):
    bundle.save(graphs.loop(2), tmp_path / "x.g2o")
    bundle.save(scene(), tmp_path / "m.txt")
    for inputs in (("m.txt", "x.g2o"), ("x.g2o", "x.g2o")):
        done = run("compare", *(tmp_path / name for name in inputs), "--quiet")
        assert_refused(done, "expected one INPUT with a pose graph, found 2")
