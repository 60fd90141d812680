"""Solves in which no observation has a projection: not usable, on either backend."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from tests import scenes


def turned_away(problem, away=50.0):
    poses = problem.cam_from_world.copy()
    poses[:, 6] -= away
    return problem.replace(cam_from_world=poses)


def beyond_the_fold():
    """A division model without an image of any point: even the formula gives none."""
    problem = scenes.make_problem(model="DIVISION", shared=True)
    params = problem.camera_params.copy()
    params[:, -1] = 1e4
    return problem.replace(camera_params=params)


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_RADIAL", "OPENCV", "FOV"])
@pytest.mark.parametrize("settings", [{}, {"loss": "huber"}, {"refine": "points,focal"}])
def test_all_behind_is_no_convergence(solve, model, settings):
    problem = turned_away(scenes.make_problem(model=model))
    result = solve(problem, cheirality="zero", **settings)
    assert not result.summary.is_solution_usable
    assert result.summary.termination_type == "FAILURE"
    assert "no_projection" in result.summary.warning_kinds
    assert "Converged" not in result.outcome
    np.testing.assert_array_equal(result.problem.points, problem.points)


@pytest.mark.parametrize("cheirality", ["zero", "algebraic"])
def test_none_by_the_formula_either(solve, cheirality):
    summary = solve(beyond_the_fold(), cheirality=cheirality).summary
    assert not summary.is_solution_usable
    assert "no_projection" in summary.warning_kinds


def test_one_that_counts_is_enough_to_solve(solve):
    problem = turned_away(scenes.make_problem(num_images=3))
    poses = problem.cam_from_world.copy()
    poses[0, 6] += 50
    kinds = solve(problem.replace(cam_from_world=poses), cheirality="zero").summary.warning_kinds
    assert "no_projection" not in kinds


def test_algebraic_residuals_count_behind(solve):
    result = solve(turned_away(scenes.make_problem()), cheirality="algebraic")
    assert "no_projection" not in result.summary.warning_kinds


def test_the_command_ends_with_1(tmp_path):
    bundle.save(turned_away(scenes.make_problem()), tmp_path / "model")
    report = tmp_path / "report.json"
    command = ["refine", str(tmp_path / "model"), "-o", str(tmp_path / "out")]
    assert main([*command, "--cheirality", "zero", "--json", str(report), "--quiet"]) == 1
    summary = json.loads(report.read_text())["summary"]
    assert summary["is_solution_usable"] is False
    assert "no_projection" in summary["warning_kinds"]
