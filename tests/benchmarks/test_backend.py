"""Tables and targets of pose graphs, preintegration and windows, from runs that are made up."""

import pytest
from benchmarks.problems import ROOT
from benchmarks.results import Results

from benchmarks import backend, measure, pose_graphs, targets


def solve(seconds):
    return {"seconds": seconds, "solves": 7.0, "chi2": 123.5}


def graphs(theirs):
    return {
        backend.OURS: [solve(1.0), solve(3.0), solve(2.0)],
        backend.CERES: [solve(8.0)],
        backend.GTSAM: [solve(theirs)] if theirs else [],
        backend.G2O: [solve(3.0)] if theirs else [],
    }


GRAPHS = {"intel": graphs(12.0), "M3500": graphs(9.0), "sphere2500": graphs(6.0)}
INERTIAL = {"bundle": {"10": [0.3, 0.1, 0.2], "50": [0.1]}, "gtsam": {"10": [2.0], "50": [1.5]}}
WINDOWS = {
    "keyframes": 121,
    "landmarks": 20,
    "observations": 300,
    "runs": {
        backend.OURS: [{"seconds": 0.5, "cost": 10.25, "steps": 9}],
        backend.GTSAM: [{"seconds": 2.0, "cost": 10.5, "steps": 8}],
    },
}


def cells(text):
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]


def test_tables():
    ours, ceres, gtsam, g2o = cells(backend.graphs_table({"intel": graphs(None)}))
    assert ours == ["intel", "bundle", "2 s (1 s-3 s)", "1.00x (0.50x-1.50x)", "7", "123.5"]
    assert (ceres[1], ceres[3]) == ("Ceres", "4.00x")
    assert gtsam == ["intel", "GTSAM", "no result", "", "", ""]
    assert g2o == ["intel", "g2o", "no result", "", "", ""]
    assert cells(backend.inertial_table(INERTIAL)) == [
        ["bundle", "0.200", "0.100"],
        ["gtsam", "2.000", "1.500"],
    ]
    first, second = cells(backend.windows_table(WINDOWS))
    assert first == ["bundle", "0.5 s", "1.00x", "10.2500", "9"]
    assert second[2:] == ["4.00x", "10.5000", "8"]
    assert backend.graphs_table({}) == backend.inertial_table({}) == backend.windows_table({}) == ""


def test_targets():
    many = {backend.MANY: graphs(30.0)}
    results = Results(
        {}, "", {"threads": 2}, {}, [], {},
        pose_graphs=GRAPHS | many, inertial=INERTIAL, windows=WINDOWS,
    )  # fmt: skip
    found = [(goal.value, goal.limit, goal.met) for goal in targets.of(results)]
    assert found == [
        (pytest.approx(4.5), 5.0, False),  # GTSAM on M3500
        (pytest.approx(4.0), 3.0, True),
        (pytest.approx(1.5), 2.0, False),  # g2o
        (pytest.approx(3.0), 4.0, False),  # sphere2500
        (pytest.approx(4.0), 2.0, True),
        (pytest.approx(2.0), 2.5, True),  # seconds of the synthetic graph
        (pytest.approx(0.1), 0.2, True),  # in the longest batch
        (pytest.approx(4.0), 5.0, False),
    ]


def test_a_set_that_a_solver_could_not_do_has_no_target():
    results = Results({}, "", {"threads": 2}, {}, [], {}, pose_graphs={"CSAIL": graphs(None)})
    gtsam, ceres, g2o = targets.of(results)
    assert (gtsam.value, ceres.value, g2o.value) == (None, pytest.approx(4.0), None)


@pytest.mark.usefixtures("bundle_data")
def test_solvers_of_pose_graphs_end_at_one_minimum():
    found = pose_graphs.measured(["smallGrid3D"], 1, 1, 0)["smallGrid3D"]
    assert set(found) == {backend.OURS, backend.CERES, backend.GTSAM, backend.G2O}
    of_log = [runs for solver, runs in found.items() if solver != backend.G2O]
    ends = [run["chi2"] for runs in of_log for run in runs]
    assert len(ends) >= 2
    assert ends == pytest.approx([ends[0]] * len(ends), rel=1e-5)


def test_a_module_that_fails_is_a_line(capsys, tmp_path):
    env = measure.environment(ROOT, 1)
    assert measure.run_module("benchmarks.no_such", [], env, 20) is None
    assert "benchmarks.no_such: not measured" in capsys.readouterr().err
    (tmp_path / "answers.py").write_text(
        "import pathlib, sys\npathlib.Path(sys.argv[-1]).write_text('[1, 2]')\n"
    )
    env = measure.environment(tmp_path, 1)
    assert measure.run_module("answers", ["--repeat", "1"], env, 20) == [1, 2]
