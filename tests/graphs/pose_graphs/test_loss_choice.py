"""The choice of a loss by ``auto``, and its explanation."""

import importlib
import json

import numpy as np
import pytest

import bundle
from bundle.base.tails import ONE_IN_2000
from bundle.graphs.pose_graphs.edge_weights import weighted_graph
from bundle.graphs.pose_graphs.truncated_search import choose_loss, loss_cost, truncated_cost
from bundle.interface.pose_graph_options import PoseGraphOptions
from tests.graphs.pose_graphs.test_wrong_closures import certain_loop, with_wrong_closures

DOUBTED = np.array([False, True, True, True])


def outputs(**chi2):
    """A solve that returns fixed errors by the name of the loss, and the losses asked for."""
    asked = []

    def solve(options):
        asked.append(options.loss)
        found, interrupted = np.array(chi2[options.loss], float), options.loss == chi2.get("stop")
        return {"chi2_after": found, "summary": {"interrupted": interrupted}}

    return solve, asked


def chosen(**chi2):
    solve, asked = outputs(**chi2)

    def doubts(found):
        beyond = int((DOUBTED & (found["chi2_after"] > 10)).sum())
        return f"{beyond} edge has a chi2 above 10" if beyond else ""

    options, output, reason = choose_loss(
        solve, DOUBTED, PoseGraphOptions(loss="auto"), 10.0, doubts
    )
    return options.loss, output["chi2_after"].tolist(), asked, reason


def test_the_truncated_cost_spares_trusted_edges():
    assert truncated_cost(np.array([50.0, 4, 30, 11]), DOUBTED, 10.0) == (50 + 4 + 10 + 10) / 2


@pytest.mark.parametrize("loss", ["trivial", "huber", "cauchy", "geman_mcclure", "dcs", "gnc_tls"])
def test_the_cost_of_a_loss_is_that_of_a_solve(loss):
    graph = with_wrong_closures(certain_loop(2, num_poses=12, num_closures=6, noise=0.05), 2)
    options = PoseGraphOptions(loss=loss, loss_scale=1.0 if loss == "trivial" else 1.7)
    chi2 = np.array(bundle.pose_graph_chi2(graph))
    doubted = graph.is_closure & (loss != "trivial")
    found = loss_cost(chi2, doubted, options, 1.7**2 * ONE_IN_2000[3])
    solved = bundle.solve(graph, options, init="file", max_num_iterations=0)
    assert found == pytest.approx(solved.summary.initial_cost, rel=1e-12)


def test_nothing_is_tried_where_nothing_is_to_be_doubted():
    loss, _, asked, reason = chosen(trivial=[99, 1, 10, 2])  # the trusted edge does not count
    assert loss == "trivial" and asked == ["trivial"] and reason.startswith("No loss")


def test_the_least_truncated_cost_wins():
    dcs, gnc = [1, 1, 1, 500], [1, 1, 99, 99]
    loss, found, asked, reason = chosen(trivial=[9, 9, 9, 90], dcs=dcs, gnc_tls=gnc)
    assert loss == "dcs" and found == dcs and asked == ["trivial", "dcs", "gnc_tls"]
    assert "1 edge has" in reason and reason.startswith("dcs: ")
    assert chosen(trivial=[9, 9, 9, 90], dcs=gnc, gnc_tls=dcs)[0] == "gnc_tls"
    assert chosen(trivial=[1, 0, 0, 11], dcs=gnc, gnc_tls=gnc)[0] == "trivial"


@pytest.mark.parametrize("stop", ["trivial", "dcs"])
def test_a_user_who_stops_it_gets_what_is_there(stop):
    _, _, asked, _ = chosen(trivial=[9, 9, 9, 90], dcs=[1, 1, 1, 50], gnc_tls=[0] * 4, stop=stop)
    assert asked == ["trivial", "dcs"][: ["trivial", "dcs"].index(stop) + 1]


def test_a_clean_graph_is_solved_as_without_a_loss():
    graph = certain_loop(2, num_poses=20, num_closures=10, noise=0.005)
    plain, auto = bundle.solve(graph), bundle.solve(graph, loss="auto")
    np.testing.assert_array_equal(auto.problem.poses, plain.problem.poses)
    assert auto.summary.loss == "trivial" and auto.rejected == () and auto.options.loss == "auto"
    assert plain.summary.loss == "trivial" and plain.summary.loss_choice == ""


@pytest.mark.parametrize("dimension", [2, 3])
def test_wrong_closures_are_rejected_and_no_right_one_is(dimension):
    graph = certain_loop(dimension, num_poses=40, num_closures=40, noise=0.005)
    result = bundle.solve(with_wrong_closures(graph, 8), loss="auto")
    assert sorted(result.rejected) == list(
        range(79, 87)
    ) and result.summary.loss in result.summary.loss_choice.replace("-", "_")
    assert bundle.diagnose(result).ok  # with the weights of the loss that was taken
    assert bundle.covariance(result).dof > 0
    for call in (bundle.diagnose, bundle.covariance, bundle.compare):
        with pytest.raises(bundle.InputError, match=r"^loss: "):
            call(graph, loss="auto")


def test_the_command(tmp_path, capsys):
    from bundle.cli.main import main

    graph = with_wrong_closures(certain_loop(2, num_poses=30, num_closures=20, noise=0.005), 4)
    bundle.save(graph, tmp_path / "x.g2o")
    words = ["refine", str(tmp_path / "x.g2o"), "-o", str(tmp_path / "y.g2o"), "--quiet"]
    assert main([*words, "--verbose", "--loss", "auto", "--json", str(tmp_path / "r.json")]) == 0
    assert "truncated cost" in capsys.readouterr().out
    found = json.loads((tmp_path / "r.json").read_text())
    assert found["options"]["loss"] == "AUTO" and len(found["rejected_edges"]) == 4
    assert found["summary"]["loss"] in ("dcs", "gnc_tls") and found["summary"]["loss_choice"]


def test_auto_hands_over_what_dcs_leaves_in_and_the_consistent_set(monkeypatch):
    module = importlib.import_module("bundle.graphs.pose_graphs.solve_pose_graph")
    gnc = importlib.import_module("bundle.graphs.pose_graphs.gnc_solve")
    handed = []
    solve = gnc.solve_gnc
    monkeypatch.setattr(gnc, "solve_gnc", lambda *given: handed.extend(given[-1]) or solve(*given))
    graph = with_wrong_closures(certain_loop(2, num_poses=40, num_closures=40, noise=0.005), 8)
    bundle.solve(graph, loss="auto")
    assert [np.flatnonzero(~used & graph.is_closure).tolist() for used, _ in handed] == [
        list(range(79, 87))
    ] * 2
    monkeypatch.setattr(module, "MOST_CHECKED", 10)
    handed.clear()
    bundle.solve(graph, loss="auto")
    assert len(handed) == 1


def test_weights_of_the_truncated_loss_have_its_scale():
    graph = certain_loop(2)
    chi2 = np.array(bundle.pose_graph_chi2(graph))
    edge = int(np.flatnonzero(graph.is_closure)[0])
    information = graph.information.copy()
    information[edge] *= 3 * ONE_IN_2000[3] / chi2[edge]
    graph = graph.replace(information=information)
    for scale, weight in ((1.0, 0), (1.6, 0), (1.8, 1), (2.0, 1)):
        found = weighted_graph(graph, None, {"loss": "gnc_tls", "loss_scale": scale}, "covariance")
        assert found.weights[edge] == weight
