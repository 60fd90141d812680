"""The notebooks of docs/tutorials run, without a kernel, and end where their text says."""

import json
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials"


@pytest.fixture
def ran(monkeypatch):
    """Run the cells of a notebook in one namespace, which is returned."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    monkeypatch.chdir(FOLDER)

    def run(name):
        notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
        cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        names: dict = {}
        for number, cell in enumerate(cells):
            exec(compile("".join(cell["source"]), f"{name}, cell {number}", "exec"), names)
        return names

    yield run
    matplotlib.pyplot.close("all")


def test_first_refinement(ran):
    names = ran("first_refinement")
    plain, robust = names["plain"], names["robust"]
    assert plain.reprojection_error_after.median > 3 > 1 > robust.reprojection_error_after.median
    assert names["result"].reprojection_error_after.rmse < 1
    assert names["sigma"] < 1  # of a focal length of 1024 pixels


def test_a_pose_graph(ran):
    names = ran("pose_graph")
    graph, robust = names["graph"], names["robust"]
    assert [tuple(graph.edges[k].tolist()) for k in robust.rejected] == [(5, 45)]
    off = {
        name: np.linalg.norm(poses[:, :2] - names["truth"][:, :2], axis=1).max()
        for name, poses in {
            "bent": names["bent"].problem.poses,
            "robust": robust.problem.poses,
        }.items()
    }
    assert off["robust"] < 1 < off["bent"]


def test_a_window(ran):
    names = ran("window")
    assert np.abs(names["all_kept"] - names["exact"]).max() < 1e-6
    assert np.abs(names["all_kept"] - names["dropped"]).max() > 0.1
    nullities = [{r.nullity for r in names[run].keyframes} for run in ("result", "current")]
    assert nullities == [{4}, {3}]


def test_learned_sigmas(ran):
    pytest.importorskip("torch", reason="PyTorch, the extra torch, is not installed")
    names = ran("learned_sigmas")
    assert set(np.argsort(names["sigmas"])[-2:]) == {3, 6}
    assert names["sigmas"][[3, 6]].min() > 2
    assert names["history"][-1] < 0.7 * names["history"][0]
    assert names["learned"] < names["equal"]


def test_notebooks_are_kept_without_outputs():
    for path in FOLDER.glob("*.ipynb"):
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs") and cell.get("execution_count") is None, path.name
