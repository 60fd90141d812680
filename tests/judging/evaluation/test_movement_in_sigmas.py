"""Movement in sigmas of the covariance that fits the solve of A."""

import numpy as np
import pytest

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.interface.options import SolveOptions
from bundle.judging.evaluation.movement_in_sigmas import _check_scale, movement_in_sigmas
from tests.rig_scenes import rig_problem

DEFAULT = ("poses", "points", "focal", "extra")
EXACT = {"function_tolerance": 1e-12, "max_num_iterations": 300, "num_threads": 1}


def orbit(seed, shift=0.0):
    made = bundle.synthesize(
        scene="orbit",
        num_images=14,
        num_points=500,
        seed=seed,
        pixel_noise=0.5,
    )
    problem = made.problem.replace(format="colmap")
    parameters = problem.camera_params.copy()
    parameters[:, 1] += shift
    return problem.replace(camera_params=parameters), made.ground_truth


def compared(problem, truth, said=("loss", "loss_scale"), **options):
    solved = bundle.solve(problem, **{**EXACT, **options}).problem
    rows = np.arange(truth.num_images)
    told = SolveOptions(**{name: options[name] for name in said if name in options})
    movement = movement_in_sigmas(solved, truth, rows, rows, told)
    found = bundle.evaluate(solved, truth, loss=told.loss, loss_scale=told.loss_scale)
    return movement, next(one for one in found.headline if "sigmas" in one)


@pytest.mark.parametrize("tolerance", [1e-12, 1e-6])
@pytest.mark.parametrize("seed", [1, 5])
def test_a_refined_principal_point_is_recognised(seed, tolerance):
    refine = (*DEFAULT, "principal_point")
    found, sentence = compared(*orbit(seed), refine=refine, function_tolerance=tolerance)
    assert found.median < 1.2 and found.assumed == ""
    assert any("principal point" in note for note in found.notes)
    assert "explains" not in sentence and "constant" not in sentence


def test_a_held_one_is_an_assumption_that_is_said():
    right, sentence = compared(*orbit(2), refine=DEFAULT)
    assert right.median < 1.2 and not any("principal" in note for note in right.notes)
    assert "constant" not in sentence
    wrong, sentence = compared(*orbit(2, shift=8), refine=DEFAULT)
    assert wrong.median > 10 and wrong.assumed == "the principal point"
    assert "more than the uncertainty of A explains, with the principal point constant" in sentence


def test_a_model_off_its_minimum_has_no_measure():
    options = {"refine": DEFAULT, "loss": "cauchy", "loss_scale": 0.2}
    found, sentence = compared(*orbit(1), said=(), **options)
    assert not found.is_minimum and "least squares" in sentence and "--loss" in sentence
    found, sentence = compared(*orbit(1), said=("loss",), **options)  # with a scale of 1 px
    assert not found.is_minimum and "minimum of the cauchy loss" in sentence


def test_sigmas_under_a_loss_are_those_of_the_truth():
    """Monte Carlo of the mean of m^2, 1.2 here: the scale of the weighted residuals gives 2.9."""
    squares = []
    for seed in range(5):
        made = bundle.synthesize(
            scene="orbit", num_images=8, num_points=120, seed=seed, pixel_noise=0.5,
            outlier_share=0.02 * (seed % 2),
        )  # fmt: skip
        found, sentence = compared(
            made.problem.replace(format="colmap"), made.ground_truth,
            refine=DEFAULT, loss="cauchy", loss_scale=0.5, function_tolerance=1e-6,
        )  # fmt: skip
        assert found.is_minimum and found.loss == "cauchy" and "no measure" not in sentence
        squares.append(np.mean(found.sigmas**2))
    assert 0.6 < np.mean(squares) < 1.8


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_sensors_on_rigs_that_were_refined_are_recognised(seed):
    settings = {"num_frames": 6, "num_points": 200, "seed": seed, "model": "SIMPLE_RADIAL"}
    truth = rig_problem(perturbation=0.0, **settings)
    start = rig_problem(**settings)
    turned = start.sensor_from_rig.copy()
    turned[:, 4:] *= 1.05  # a baseline that was not calibrated
    start = start.replace(sensor_from_rig=turned)
    refined, sentence = compared(start, truth, refine=DEFAULT, refine_sensor_from_rig=True)
    assert refined.median < 1.5 and "explains" not in sentence
    held, sentence = compared(start, truth, refine=DEFAULT)
    assert held.median > 3 and held.assumed == "principal point and sensors on rigs"
    assert "more than the uncertainty of A explains, with principal" in sentence


@pytest.mark.parametrize(
    ("factor", "is_one"), [(1.19, True), (1 / 1.19, True), (1.21, False), (1 / 1.21, False)]
)
def test_models_on_rigs_have_one_scale(factor, is_one):
    a = rig_problem(num_points=5)
    b = moved(a, Similarity(factor, np.eye(3), np.ones(3)))
    rows = np.arange(a.num_images)
    if is_one:
        _check_scale(a, b, rows, rows)
    else:
        with pytest.raises(bundle.InputError, match="lengths of A and B differ"):
            _check_scale(a, b, rows, rows)
