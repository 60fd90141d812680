"""`refine --loops`."""

import json

import numpy as np
import pytest

import bundle
from tests.graphs.loops.drift import ate, closures_of, drifted_street


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loops")
    truth, model, scales = drifted_street()
    bundle.save(model, folder / "model", format="colmap")
    bundle.save(closures_of(truth, scales, 8, wrong=2), folder / "x.g2o")
    return folder, truth


def test_refine_closes_loops_first(run, street, tmp_path):
    folder, truth = street
    report = tmp_path / "report.json"
    done = run("refine", folder / "model", "-o", tmp_path / "out", "--loops", folder / "x.g2o",
               "--json", report, "--verbose")  # fmt: skip
    assert done.code == 0 and "6 used, 2 rejected" in done.out
    assert ate(bundle.load(tmp_path / "out"), truth) < 0.05
    found = json.loads(report.read_text())["loops"]
    assert found["num_used"] == 6 and found["num_rejected"] == 2
    assert [closure["used"] for closure in found["closures"]] == [True] * 6 + [False] * 2
    lines = [closure["line"] for closure in found["closures"]]
    assert lines == list(range(lines[0], lines[0] + 8)) and lines[0] > 1
    assert found["cost_after"] < found["cost_before"]
    np.testing.assert_allclose(found["scale_range"], [0.71, 1], atol=0.1)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--loop-loss", "cauchy"), ("--loop-loss", "--loops")),
        (("--loops", "X", "--only-images", "1-3"), ("--loops", "--only-images")),
        (("--loops", "X", "--loop-loss-scale", "0"), ("--loop-loss-scale", "found 0")),
        (("--loops", "BAD"), ("bad.g2o:1", "777")),
        (("--loops", "NONE"), ("none.g2o",)),
        (("--loops", "X", "--json", "X"), ("x.g2o",)),
    ],
)
def test_refused_in_one_line(run, street, tmp_path, flags, words):
    folder, _ = street
    (tmp_path / "bad.g2o").write_text(
        "EDGE_SE3:QUAT 1 777 0 0 0 0 0 0 1 " + "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n"
    )
    named = {"X": folder / "x.g2o", "BAD": tmp_path / "bad.g2o", "NONE": tmp_path / "none.g2o"}
    before = (folder / "x.g2o").read_bytes()
    done = run("refine", folder / "model", "-o", tmp_path / "out", "--quiet",
               *(named.get(word, word) for word in flags))  # fmt: skip
    last = done.err.splitlines()[-1]
    assert (done.code, done.out) == (2, "") and last.startswith("error: ")
    assert all(word in last for word in words), last
    assert not (tmp_path / "out").exists() and (folder / "x.g2o").read_bytes() == before


def test_a_pose_graph_takes_no_loops(run, street, tmp_path):
    folder, _ = street
    done = run("refine", folder / "x.g2o", "-o", tmp_path / "y.g2o", "--loops", folder / "x.g2o")
    assert done.code == 2 and "--loops" in done.err
