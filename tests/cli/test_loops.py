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
