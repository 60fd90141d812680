"""`refine`, `info` and `convert` of pose graphs."""

import json

import numpy as np
import pytest

import bundle
from tests.campaigns.triage_faults import wrong_closures
from tests.campaigns.triage_inputs import chain_of_poses
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.chordal_oracle import ring


@pytest.fixture
def source(tmp_path):
    graph = graphs.loop(3, noise=0.01, start_noise=0.3)
    bundle.save(graph, tmp_path / "x.g2o")
    return tmp_path / "x.g2o"


def test_refine_writes_the_graph_and_reports(run, source, tmp_path):
    target, report = tmp_path / "y.g2o.bz2", tmp_path / "report.json"
    done = run("refine", source, "-o", target, "--json", report, "--verbose")
    assert done.code == 0 and "12 poses, 17 edges, 6 closures" in done.out
    assert "6 degrees of freedom: pose 0 held" in done.out and "iteration" in done.err
    found = json.loads(report.read_text())
    expected = bundle.solve(bundle.load(source))
    assert found["command"] == "refine" and found["schema"] == 1
    assert found["input"]["format"] == "g2o" and found["input"]["num_edges"] == 17
    assert found["options"]["error"] == "LOG" and found["options"]["init"] == "LOWER"
    summary = found["summary"]
    for name in ("chi2_initial", "chi2_final", "initial_cost", "final_cost"):
        np.testing.assert_allclose(summary[name], getattr(expected.summary, name), rtol=1e-12)
    np.testing.assert_allclose(summary["final_cost"], summary["chi2_final"] / 2, rtol=1e-12)
    assert summary["termination_type"] == "CONVERGENCE" and summary["num_gauge_freedoms"] == 6
    assert len(found["iterations"]) == len(expected.iterations["cost"])
    times = found["wall_time"]
    assert set(times) == {"load", "build", "solve", "save", "statistics", "total"}
    assert times["statistics"] == 0
    assert found["output"] == {"path": str(target), "format": "g2o"}
    again = bundle.load(target)
    np.testing.assert_array_equal(again.poses, expected.problem.poses)
    np.testing.assert_array_equal(again.information, bundle.load(source).information)


def test_the_advice_on_wrong_closures_finds_them(run, tmp_path):
    clean = bundle.solve(chain_of_poses(1, 60, 60)).problem
    bad = wrong_closures(clean, np.random.default_rng(0))
    source = tmp_path / "wrong.g2o"
    bundle.save(bad, source)
    assert "not at a minimum" in run("diagnose", source).out
    plain = run("refine", source, "-o", tmp_path / "plain.g2o").out
    advice = f"bundle refine {source} -o OUTPUT --loss auto"
    assert advice in " ".join(plain.replace("\\\n", " ").split())
    words = [str(tmp_path / "good.g2o") if w == "OUTPUT" else w for w in advice.split()[1:]]
    said = " ".join(run(*words).out.split())
    loss = bundle.solve(bad, loss="auto").summary.loss.replace("_", "-")
    wanted = f"the loss {loss} rejects {bad.num_edges - clean.num_edges}; chi2 of the others is "
    assert wanted in said
    again = run("diagnose", tmp_path / "good.g2o", "--loss", loss).out  # the loss that is named
    assert "not at a minimum" not in again and "no problem found" in again
    chi2 = float(said.partition(wanted)[2].split(".")[0])
    assert chi2 == pytest.approx(bundle.solve(clean).summary.chi2_final, rel=0.01)


def test_a_solve_at_its_limit_advises_the_search_for_wrong_closures(run, tmp_path):
    clean = chain_of_poses(4, 900, 300)
    given = {"clean": clean, "wrong": wrong_closures(clean, np.random.default_rng(0))}
    for name, graph in given.items():
        bundle.save(graph, tmp_path / f"{name}.g2o")
    words = ["refine", tmp_path / "wrong.g2o", "-o", tmp_path / "o.g2o", "--overwrite"]
    limit = ["--max-iterations", 3]
    page = tmp_path / "page.html"
    said = run(*words, *limit, "--html", page).out
    advice = f"bundle refine {tmp_path / 'wrong.g2o'} -o OUTPUT --loss auto"
    assert said.count("did not reach a minimum") == 1
    assert advice in " ".join(said.replace("\\\n", " ").split())
    assert "did not reach a minimum" in page.read_text()
    for flags in (["--loss", "huber"], ["--consistency"]):  # chi2 has no expectation
        assert "did not reach a minimum" not in run(*words, *limit, *flags).out
    words[1] = tmp_path / "clean.g2o"  # near its minimum, which needs one more step
    assert "--loss auto" not in run(*words, *limit).out


def test_flags_of_pose_graphs(run, source, tmp_path):
    flags = ["--error", "g2o", "--init", "chordal", "--information", "isotropic"]
    flags += ["--trust-region", "gauss-newton", "--loss", "huber", "--loss-on", "all"]
    flags += ["--backend", "fused", "--pose-ordering", "natural", "--threads", "1"]
    done = run("refine", source, "-o", tmp_path / "y.g2o", "--json", "-", "--quiet", *flags)
    assert done.code == 0 and done.err == ""
    found = json.loads(done.out)
    options = {"error": "G2O", "init": "CHORDAL", "information": "ISOTROPIC", "loss": "HUBER"}
    options |= {"trust_region_strategy_type": "GAUSS_NEWTON", "loss_on": "ALL"}
    assert found["options"].items() >= options.items()
    assert found["summary"]["init"] == "chordal"
    assert found["summary"]["factor_ordering"] == "natural"


def test_a_solve_that_does_not_end_is_a_result(run, source, tmp_path):
    done = run("refine", source, "-o", tmp_path / "y.g2o", "--max-iterations", 1, "--quiet")
    assert done.code == 0 and "Not converged" in done.out


@pytest.mark.parametrize("name", ["y.txt", "y.txt.gz"])
def test_the_name_of_another_format_is_refused(run, source, tmp_path, name):
    for arguments in (
        ("refine", source, "-o", tmp_path / name),
        ("convert", source, tmp_path / name),
    ):
        done = run(*arguments)
        assert done.code == 2 and "BAL" in done.err and not (tmp_path / name).exists()


def test_bad_information_is_one_line_with_file_and_line(run, source, tmp_path):
    lines = source.read_text().splitlines()
    words = lines[15].split()
    words[-1] = "-1e9"
    lines[15] = " ".join(words)
    source.write_text("\n".join(lines))
    done = run("refine", source, "-o", tmp_path / "y.g2o", "--quiet")
    assert done.code == 2 and done.err.count("\n") == 1
    assert done.err.startswith(f"error: {source}:16: edge 3 4: information: expected ")
    done = run("info", source, "--json", "-")
    found = json.loads(done.out)
    assert found["num_bad_information"] == 1 and found["bad_information"][0]["line"] == 16
    assert set(found["chi2"].values()) == {None}
    assert "1 edge has no valid information" in run("info", source).out


def test_info_and_convert(run, source, tmp_path):
    found = json.loads(run("info", source, "--json", "-", "--quiet").out)
    graph = bundle.load(source)
    assert found["input"]["num_poses"] == 12 and found["num_components"] == 1
    assert found["degrees_of_freedom"] == 6 * (17 - 11) and found["bad_information"] == []
    for error in ("log", "g2o"):
        expected = graphs.chi2_by_matrices(graph, error).sum()
        np.testing.assert_allclose(found["chi2"][error], expected, rtol=1e-9)
    assert "Its poses do not fit its edges yet" in run("info", source).out
    bundle.save(bundle.solve(graph).problem, tmp_path / "fits.g2o")
    assert "Nothing looks wrong" in run("info", tmp_path / "fits.g2o").out
    done = run("convert", source, tmp_path / "z.g2o.gz", "--json", "-", "--quiet")
    assert done.code == 0 and json.loads(done.out)["lost"] == []
    np.testing.assert_array_equal(bundle.load(tmp_path / "z.g2o.gz").poses, graph.poses)
    mixed = run("info", source, source, "--json", "-", "--quiet")
    assert len(json.loads(mixed.out)["reports"]) == 2


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_trajectory_has_the_poses_at_the_times_of_their_ids(run, tmp_path, dimension):
    graph = bundle.solve(graphs.loop(dimension, noise=0.01)).problem
    order = np.random.default_rng(0).permutation(graph.num_poses)
    ids = 7 + 3 * order
    bundle.save(graph.replace(ids=ids), tmp_path / "x.g2o")
    done = run("convert", tmp_path / "x.g2o", tmp_path / "x.tum", "--json", "-", "--quiet")
    (lost,) = json.loads(done.out)["lost"]
    assert lost.startswith("17 edges") and "seconds" in lost
    assert json.loads(done.out)["output"]["format"] == "tum"
    written = bundle.load_poses(tmp_path / "x.tum")
    assert written.timestamps_ns.tolist() == (np.sort(ids) * 10**9).tolist()
    found = bundle.evaluate(graph.replace(ids=ids), bundle.load_poses(tmp_path / "x.tum"))
    assert found.verdict == "identical" and len(found.association) == 12
    (lost,) = bundle.save(graph.replace(ids=ids + 10**18), tmp_path / "stamps.TUM")
    stamps = bundle.load_poses(tmp_path / "stamps.TUM").timestamps_ns
    assert "nanoseconds" in lost and stamps.tolist() == np.sort(ids + 10**18).tolist()
    done = run("refine", tmp_path / "x.g2o", "-o", tmp_path / "y.tum", "--quiet")
    assert done.code == 0 and bundle.load_poses(tmp_path / "y.tum").format == "tum"


def test_a_report_never_replaces_a_graph(run, source, tmp_path):
    before = source.read_bytes()
    done = run("info", tmp_path / "x.g2o", "--json", source)
    assert done.code == 2 and source.read_bytes() == before
    bundle.save(graphs.loop(2), tmp_path / "other.g2o")
    done = run("info", source, "--json", tmp_path / "other.g2o")
    assert done.code == 2 and "a pose graph" in done.err


@pytest.mark.parametrize("command", ["refine", "info", "diagnose", "inspect", "covariance"])
def test_a_graph_that_is_not_there_is_said_to_be_missing(run, tmp_path, command):
    flags = {"refine": ["--init", "auto", "-o", tmp_path / "y.g2o"]}
    flags["covariance"] = ["-o", tmp_path / "y.npz"]
    done = run(command, tmp_path / "x.g2o", *flags.get(command, []))
    assert done.code == 2
    assert done.err.strip().endswith(f"error: {tmp_path / 'x.g2o'}: No such file or directory")
    assert list(tmp_path.iterdir()) == []


def test_certify_states_verdict_gap_and_bound(run, source, tmp_path):
    report = tmp_path / "report.json"
    done = run("refine", source, "-o", tmp_path / "y.g2o", "--certify", "--json", report)
    found = json.loads(report.read_text())
    certificate = found["certificate"]
    assert done.code == 0 and certificate["verdict"] == "certified"
    assert certificate["staircase"] is None and abs(certificate["min_eigenvalue"]) < 1e-9
    assert 0 <= certificate["gap"] < 1e-6 * certificate["cost"]
    expected = bundle.certify(bundle.solve(bundle.load(source)))
    np.testing.assert_allclose(certificate["cost"], expected.cost, rtol=1e-9)
    assert certificate["chi2_lower_bound"] <= found["summary"]["chi2_final"]
    assert "globally optimal within" in " ".join(found["headline"])
    # without the flag nothing is said
    run("refine", source, "-o", tmp_path / "z.g2o", "--json", report)
    assert "certificate" not in json.loads(report.read_text())


def test_certify_leaves_a_local_minimum(run, tmp_path):
    wound = ring(np.random.default_rng(1), 16, 2, turns=1)
    bundle.save(wound, tmp_path / "x.g2o")
    report, target = tmp_path / "report.json", tmp_path / "y.g2o"
    command = ("refine", tmp_path / "x.g2o", "-o", target, "--certify", "--init", "file")
    assert run(*command, "--json", report).code == 0
    found = json.loads(report.read_text())
    first, stairs = found["certificate"], found["certificate"]["staircase"]
    assert first["verdict"] == "not-certified" and first["min_eigenvalue"] < -1
    assert stairs["verdict"] == "certified" and stairs["cost"] < 0.01 * first["cost"]
    assert found["summary"]["init"] == "staircase"
    assert found["summary"]["chi2_final"] < 1.01 * stairs["cost"]
    # OUTPUT has the better poses
    np.testing.assert_allclose(
        bundle.pose_graph_chi2(bundle.load(target)).sum(), found["summary"]["chi2_final"], rtol=1e-9
    )


def test_certify_refuses_losses_and_pieces_in_one_line(run, source, tmp_path):
    target = tmp_path / "y.g2o"
    done = run("refine", source, "-o", target, "--certify", "--loss", "cauchy", "--quiet")
    assert done.code == 2 and done.err.count("\n") == 1
    assert done.err.startswith("error: --certify: expected no loss, found cauchy")
    graph = bundle.load(source)
    pieces = graph.replace(
        edges=graph.edges[:5],
        measurements=graph.measurements[:5],
        information=graph.information[:5],
        edge_lines=graph.edge_lines[:5],
    )
    bundle.save(pieces, tmp_path / "pieces.g2o")
    done = run("refine", tmp_path / "pieces.g2o", "-o", target, "--certify")
    assert done.code == 2 and "expected a connected graph, found 7 components" in done.err
    assert not target.exists()
