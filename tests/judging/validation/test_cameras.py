"""Cameras of candidates: distances, standard deviations, and domes that hardly show in pixels."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.judging.findings.larger_lens import Step
from bundle.judging.validation.judgement import _distance
from bundle.judging.validation.known_positions import certainty
from bundle.solving.executors import solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from tests.judging.findings.test_larger_lens import flight


def test_a_dome_is_not_kept_though_its_pixels_are_as_good():
    dome = flight("SIMPLE_PINHOLE", -0.022, images=16, points=400)
    found = bundle.validate(
        dome, camera_models="SIMPLE_PINHOLE,SIMPLE_RADIAL", share="size", num_threads=1
    )
    small = [one.camera_model for one in found.candidates].index("SIMPLE_PINHOLE")
    share = found.candidates[small].difference / found.candidates[found.best].score
    assert 0 < share < 0.01  # not relevant in pixels
    assert found.candidates[found.recommended].camera_model == "SIMPLE_RADIAL"
    assert found.verdict == "better"


def test_distance_is_that_of_the_centres_after_a_similarity():
    rng = np.random.default_rng(2)
    centers = rng.standard_normal((30, 3))
    turn = Rotation.from_rotvec([0.4, 0.1, -0.7])
    moved = 3.0 * turn.apply(centers) + [5.0, -2.0, 1.0]
    assert _distance(centers, moved) == pytest.approx(0.0, abs=1e-12)
    noise = 0.01 * rng.standard_normal((30, 3))
    wanted = 0.01 * np.sqrt(3 * (1 - 7 / 90))
    assert _distance(centers + noise, centers) == pytest.approx(wanted, rel=0.15)
    assert np.isnan(_distance(None, centers)) and np.isnan(_distance(centers, None))
    line = np.outer(np.arange(30.0), [1.0, 2.0, 3.0])
    assert np.isnan(_distance(line, line + noise))


def test_standard_deviation_of_the_cameras_of_a_fit():
    problem = flight("SIMPLE_RADIAL", images=8, points=80)
    options = bundle.SolveOptions(num_threads=1)
    prepared = prepare(SolveRequest(problem=problem, options=options))
    full = solve_prepared(prepared, None)
    wanted = Step(full.problem, options).position_sigma()
    assert certainty(prepared, full).camera_sigma == pytest.approx(wanted, rel=1e-6)
    ruled = prepare(
        SolveRequest(problem=problem, options=options, constraints=["cameras *: k fixed"])
    )
    assert np.isnan(certainty(ruled, solve_prepared(ruled, None)).camera_sigma)
