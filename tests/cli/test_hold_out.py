"""`bundle refine --hold-out` from the outside."""

import json

import numpy as np
import pytest

import bundle
from tests.scenes import make_problem


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "model"
    bundle.save(make_problem(num_images=6, num_points=80, format="colmap"), path)
    return path


def test_json_has_the_errors_of_the_solve(run, folder, tmp_path):
    report, output = tmp_path / "report.json", tmp_path / "out"
    words = ("--hold-out", "10", "--hold-out-seed", "3", "--json", report, "--verbose")
    code, out, _ = run("refine", folder, "-o", output, *words)
    assert code == 0
    assert "held out" in out
    data = json.loads(report.read_text())
    assert (data["options"]["hold_out"], data["options"]["hold_out_seed"]) == (10, 3)
    found = data["held_out"]
    names = {"num_observations", "rmse", "median", "clipped_rmse", "share_clipped", "clip"}
    assert names <= set(found) & {*found["fitted"]}
    expected = bundle.solve(folder, hold_out=10, hold_out_seed=3).held_out
    assert found["clipped_rmse"] == pytest.approx(expected.clipped_rmse, rel=1e-6)
    assert found["num_observations"] == expected.num_observations
    plain = tmp_path / "plain"
    assert run("refine", folder, "-o", plain)[0] == 0
    np.testing.assert_allclose(bundle.load(output).points, bundle.load(plain).points, atol=1e-9)


def test_without_the_flag_there_is_no_record(run, folder, tmp_path):
    report = tmp_path / "report.json"
    run("refine", folder, "-o", tmp_path / "out", "--json", report)
    data = json.loads(report.read_text())
    assert "held_out" not in data
    assert "hold_out" not in data["options"]
