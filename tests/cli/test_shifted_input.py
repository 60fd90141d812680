"""A refinement of a model whose pixels are all shifted alike: that is said, and nothing else."""

import json

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.io.formats import nvm
from bundle.model.residuals import residuals
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small
from tests.scenes import make_problem


def findings(run, source, folder, *words):
    report = folder / "r.json"
    run("refine", source, "-o", f"{folder}/out/", "--json", report, "--quiet", *words)
    return json.loads(report.read_text("utf-8"))["findings"]


def test_pixels_from_the_corner_are_named_with_the_command_that_reads_them(run, tmp_path):
    problem = small("SIMPLE_PINHOLE", shared=True)
    params = problem.camera_params.copy()
    params[:, 1:3] = 0.0  # the writer subtracts the principal point
    path = tmp_path / "m.nvm"
    foreign.write_nvm(problem.replace(camera_params=params), path)
    size = ("--image-size", "800,600")
    found = findings(run, path, tmp_path, *size)[0]
    assert found["kind"] == "shifted_pixels" and found["is_problem"]
    assert found["command"].endswith("--pixel-origin corner")
    again = findings(run, path, tmp_path, *size, "--overwrite", "--pixel-origin", "corner")
    assert "shifted_pixels" not in {one["kind"] for one in again}


@pytest.mark.parametrize("shift", [0.0, 500.0])
def test_a_shift_is_named_where_the_format_cannot_hold_the_bent_lenses(
    run, tmp_path, monkeypatch, shift
):
    def write(*_):
        raise InputError("an NVM file cannot hold them")

    monkeypatch.setattr(nvm, "write", write)
    problem = exact(make_problem(num_images=6, num_points=60, model="SIMPLE_RADIAL"))
    moved = problem.replace(observation_xy=problem.observation_xy + np.array([shift, 0.0]))
    bundle.save(moved, tmp_path / "model", "colmap")
    code, _, said = run("refine", tmp_path / "model", "-o", tmp_path / "x.nvm", "--quiet")
    assert code == 2 and said.count("\n") == 1
    assert ("All pixels are shifted alike" in said) == (shift > 0)
    assert "`" not in said  # no command shifts the pixels of a COLMAP model
    assert ("an NVM file cannot hold them" in said) == (shift == 0)
    assert not (tmp_path / "x.nvm").exists()


@pytest.mark.parametrize(("shift", "is_found"), [(9.0, False), (11.0, True)])
def test_the_input_is_judged_and_not_the_bent_result(run, tmp_path, shift, is_found):
    problem = exact(make_problem(num_images=6, num_points=100, model="SIMPLE_PINHOLE"))
    moved = problem.replace(observation_xy=problem.observation_xy + np.array([shift, 0.0]))
    bundle.save(moved, tmp_path / "model", "colmap")
    found = findings(run, tmp_path / "model", tmp_path)
    assert ("shifted_pixels" in {one["kind"] for one in found}) == is_found


def test_a_refined_principal_point_absorbs_the_shift(run, tmp_path):
    problem = exact(make_problem(num_images=6, num_points=100, model="SIMPLE_PINHOLE"))
    moved = problem.replace(observation_xy=problem.observation_xy + np.array([30.0, 0.0]))
    bundle.save(moved, tmp_path / "model", "colmap")
    found = findings(run, tmp_path / "model", tmp_path, "--refine", "poses,points,principal-point")
    assert "shifted_pixels" not in {one["kind"] for one in found}


def exact(problem):
    """Return the problem with observations where its points project."""
    return problem.replace(
        observation_xy=problem.observation_xy + residuals(problem, "algebraic").xy
    )
