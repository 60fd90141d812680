"""A refinement of a model whose pixels are all shifted alike: that is said, and nothing else."""

import json
import shlex

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


def corner_file(path, second=(400.0, 300.0)):
    """Write an NVM file with pixels from the corner, of images whose middles are two in turn."""
    problem = exact(small("SIMPLE_PINHOLE", num_images=6, num_points=100))
    xy = problem.observation_xy
    left = problem.select(observations=(xy < (450.0, 350.0)).all(axis=1)).problem
    middle = np.where(left.observation_image[:, None] % 2, second, (400.0, 300.0))
    params = left.camera_params.copy()
    params[:, 1:3] = 0.0
    moved = left.observation_xy + middle - (400.0, 300.0)
    foreign.write_nvm(left.replace(observation_xy=moved, camera_params=params), path)


@pytest.mark.parametrize("target", ["out/", "out.nvm"])
@pytest.mark.parametrize("origin", [(), ("--pixel-origin", "corner")])
def test_the_command_gives_the_size_that_no_photograph_gives(run, tmp_path, origin, target):
    path, report = tmp_path / "m.nvm", tmp_path / "r.json"
    corner_file(path)
    own = ("--json", report, "--quiet", "--overwrite")
    flags = ("--set", "cameras *: f in [1, 1000000]", "--loss", "soft-l1", "--threads", "1")
    run("refine", path, "-o", f"{tmp_path}/{target}", *own, *flags, *origin)
    first = json.loads(report.read_text("utf-8"))["findings"][0]
    assert first["kind"] == "shifted_pixels"
    words = shlex.split(first["command"])
    assert words[words.index("--image-size") + 1] == "800,600"
    assert [word for word in words if word in flags] == list(flags)
    assert run(*words[1:], *own[:3]).code == 0
    again = json.loads(report.read_text("utf-8"))
    assert "shifted_pixels" not in {one["kind"] for one in again["findings"]}
    assert again["summary"]["termination_type"] == "CONVERGENCE"
    written = bundle.load(tmp_path / target)
    assert np.abs(residuals(written, "algebraic").xy).max() < 1e-3


def test_no_one_size_is_advised_for_images_of_several(run, tmp_path):
    corner_file(tmp_path / "m.nvm", second=(300.0, 400.0))
    found = findings(run, tmp_path / "m.nvm", tmp_path)[0]
    assert found["kind"] == "shifted_pixels" and found["command"] == ""


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
