"""`bundle validate` from the outside, and the commands that it recommends."""

import json
import shlex

import numpy as np
import pytest

import bundle
from bundle.judging.validation.candidate_fits import refine_command
from bundle.judging.validation.candidates import Candidate, default_candidates, with_cameras
from tests.judging.validation.test_candidates import two_sizes
from tests.judging.validation.test_validate import photographs
from tests.scenes import make_problem, scene

QUICK = ("--folds", "3", "--camera-models", "SIMPLE_RADIAL,OPENCV", "--quiet")


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "model"
    bundle.save(photographs(format="colmap"), path)
    return path


def test_report_begins_with_the_verdict_and_a_command_that_runs(run, folder, tmp_path):
    report = tmp_path / "report.json"
    code, out, _ = run("validate", folder, *QUICK, "--json", report)
    assert code == 0
    data = json.loads(report.read_text())
    first = "".join(" ".join(out.splitlines()[:6]).split())
    assert "".join(data["headline"][0].split()) in first
    assert "--share-camerassize" in first
    assert data["command"].startswith(f"bundle refine {folder} -o OUTPUT")
    words = shlex.split(data["command"])
    assert run(*words[1:4], tmp_path / "out", *words[5:], "--quiet")[0] == 0
    assert bundle.load(tmp_path / "out").num_cameras == 1


def test_json_against_the_contract(run, folder, tmp_path):
    report = tmp_path / "report.json"
    run("validate", folder, *QUICK, "--seed", "2", "--json", report)
    data = json.loads(report.read_text())
    expected = bundle.validate(
        folder, num_folds=3, seed=2, camera_models="SIMPLE_RADIAL,OPENCV", num_threads=2
    )
    names = {"camera_model", "share", "loss", "num_parameters", "fitted_rmse", "held_out_rmse"}
    names |= {"held_out_median", "difference", "standard_error", "aic", "bic", "vetoed"}
    assert len(data["candidates"]) == len(expected.candidates) == 6
    for found, one in zip(data["candidates"], expected.candidates, strict=True):
        assert names <= set(found)
        assert found["held_out_rmse"] == pytest.approx(one.held_out_rmse, rel=1e-9)
        assert found["standard_error"] == pytest.approx(one.standard_error, rel=1e-6)
    assert data["recommended"] == expected.recommended
    assert (data["options"]["num_folds"], data["options"]["seed"]) == (3, 2)
    assert data["num_held_out"] == len(expected.observations)
    assert {"fires", "shear", "anisotropy"} <= set(data["row_test"])
    assert data["findings"] == []


def test_lists_of_losses_and_of_refined_sets(run, folder, tmp_path):
    report = tmp_path / "report.json"
    sets = "poses,points,focal,extra/poses,points,focal,principal-point,extra"
    words = ("--losses", "trivial,soft-l1", "--share", "size", "--refine", sets)
    code, out, _ = run(
        "validate", folder, "--folds", "2", "--camera-models", "OPENCV", *words, "--json", report
    )
    assert code == 0
    data = json.loads(report.read_text())
    found = [(one["loss"], "principal_point" in one["refine"]) for one in data["candidates"]]
    assert sorted(found) == [(loss, both) for loss in ("soft_l1", "trivial") for both in (0, 1)]
    free = {one["num_intrinsics"] for one in data["candidates"]}
    assert free == {6, 8}
    assert "soft-l1" in out
    command = data["candidates"][-1]["command"]
    assert "principal-point" in command


def test_too_few_observations_are_one_line(run, tmp_path):
    bundle.save(make_problem(num_images=6, num_points=60, track=2, format="colmap"), tmp_path / "m")
    code, _, err = run("validate", tmp_path / "m", "--quiet")
    assert code == 2
    assert err.startswith("error: ")
    assert "at least 50 observations that can be held out" in err


def test_pose_graphs_have_no_lenses(run, tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    code, _, err = run("validate", path, "--quiet")
    assert code == 2
    assert "pose graph" in err


@pytest.mark.parametrize("share", ["each", "focal", "size", "all", "input"])
@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV"])
def test_command_gives_the_cameras_of_the_candidate(run, share, model, tmp_path):
    """Run the command on the saved input: the same number of free lens parameters, same cost."""
    problem = two_sizes(model="SIMPLE_RADIAL", format="colmap")
    if share == "all":
        problem = make_problem(num_images=6, num_points=60, format="colmap")
    path = tmp_path / "in"
    bundle.save(problem, path)
    candidate = Candidate(camera_model=model, share=share, loss="huber")
    command = refine_command(problem, candidate, bundle.SolveOptions(), str(path), "OUT")
    words = shlex.split(command)
    assert words[:5] == ["bundle", "refine", str(path), "-o", "OUT"]
    assert run(*words[1:4], tmp_path / "out", *words[5:])[0] == 0
    edited, rules = with_cameras(problem, candidate)
    tight = {"function_tolerance": 1e-13, "max_num_iterations": 300}
    expected = bundle.solve(edited, loss="huber", constraints=rules, **tight)
    refined = bundle.load(tmp_path / "out")
    again = bundle.solve(refined, loss="huber", max_num_iterations=0)
    assert again.summary.initial_cost == pytest.approx(expected.summary.final_cost, rel=1e-3)
    focal = refined.camera_params[refined.image_camera, 0]
    groups = {"size": 2, "all": 1}.get(share, 6)
    assert len(np.unique(np.round(focal, 6))) == groups


def test_command_for_bal_writes_a_format_that_holds_the_model(run, tmp_path):
    path = tmp_path / "in.txt"
    bundle.save(scene(num_images=4, num_points=40), path)
    problem = bundle.load(path)
    for candidate in default_candidates(problem):
        words = shlex.split(refine_command(problem, candidate, bundle.SolveOptions(), str(path)))
        out = tmp_path / candidate.camera_model
        assert run(*words[1:3], "-o", out, *words[5:])[0] == 0
        assert set(bundle.load(out).camera_models) == {candidate.camera_model}


def test_a_candidate_without_a_fit_has_no_numbers(run, folder, tmp_path):
    report = tmp_path / "report.json"
    code, out, _ = run(
        "validate", folder, "--folds", "3", "--camera-models", "SIMPLE_RADIAL,SIMPLE_PINHOLE",
        "--set", "cameras *: k fixed", "--quiet", "--verbose", "--json", report,
    )  # fmt: skip
    rows = [line.split() for line in out.splitlines() if line.startswith("SIMPLE_PINHOLE")]
    assert code == 0 and rows and "nan" not in out
    assert all(row[-6:] == ["0", "-", "-", "-", "-", "0"] for row in rows)
    data = json.loads(report.read_text())
    fitted = [line.split() for line in out.splitlines() if line.startswith("SIMPLE_RADIAL")]
    shares = [100 * one["share_clipped"] for one in data["candidates"] if not one["error"]]
    assert any(shares)
    assert [float(row[-2]) for row in fitted] == pytest.approx(shares, abs=6e-4)
    assert f"{data['sigma']:.4g} px per coordinate" in out
