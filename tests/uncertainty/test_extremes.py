"""Covariances of problems with next to nothing in them: a stated result, or one clear line."""

import re

import numpy as np
import pytest

import bundle
from tests.scenes import make_problem

OBSERVATIONS = tuple(f"observation_{name}" for name in ("image", "point", "xy", "keypoint"))


def scene(**settings):
    return make_problem(**{"num_points": 30, "seed": 1, "perturbation": 0, **settings})


def observed(problem, which):
    return problem.replace(**{name: getattr(problem, name)[which] for name in OBSERVATIONS})


def without_points():
    nothing = {"points": np.zeros((0, 3)), "point_ids": np.zeros(0, int)}
    problem = scene()
    return observed(problem, problem.observation_image < 0).replace(**nothing)


@pytest.mark.parametrize("gauge", ["inner", "two_cameras"])
@pytest.mark.parametrize("robust", ["weights", "sandwich"])
def test_without_observations_nothing_is_known(gauge, robust):
    for problem in (observed(scene(), slice(0, 0)), without_points()):
        cov = bundle.covariance(problem, gauge=gauge, robust=robust)
        assert cov.dof == 0
        assert np.isnan(cov.sigma0)
        assert np.isnan(cov.point_covariance).all()
        with pytest.raises(bundle.InputError, match=r"^scale: "):
            bundle.covariance(problem, scale="sigma0")
        assert "no observations" in bundle.diagnose(problem).findings[0].sentence


@pytest.mark.parametrize(
    "problem",
    [
        scene(num_images=1),
        scene(num_points=1),
        observed(scene(), slice(0, 1)),
        observed(scene(), slice(0, 3)),
    ],
    ids=["one image", "one point", "one observation", "three observations"],
)
@pytest.mark.parametrize("settings", [{}, {"gauge": "two_cameras"}, {"robust": "sandwich"}])
def test_what_observations_cannot_determine_is_refused(problem, settings):
    with pytest.raises(bundle.InputError, match=r"^problem: ") as refused:
        bundle.covariance(problem, **settings)
    assert "\n" not in str(refused.value)
    assert any(finding.is_problem for finding in bundle.diagnose(problem).findings)


def test_two_pieces_of_a_world_are_refused():
    problem = scene(num_images=6, num_points=40)
    apart = (problem.observation_image < 3) == (problem.observation_point < 20)
    with pytest.raises(bundle.InputError, match=r"^problem: .*rank"):
        bundle.covariance(observed(problem, apart))


@pytest.mark.parametrize("apart", [1, 2, 4])
def test_a_refusal_accuses_no_image_that_is_well_known(apart):
    """A dense S is held along the gauge, which spreads what is not known over all images."""
    problem = scene(num_images=6, num_points=60)
    lost = (problem.observation_image == apart) & (problem.observation_point % 30 > 0)
    with pytest.raises(bundle.InputError, match=r"^problem: .*rank") as refused:
        bundle.covariance(observed(problem, ~lost))
    said = re.search(r"image (\d+)", str(refused.value))
    assert said is None or int(said[1]) == problem.image_ids[apart]


def test_an_image_beside_itself_does_not_move():
    cov = bundle.covariance(scene(), relative=[(2, 2)])
    assert np.abs(cov.relative(2, 2)).max() < 1e-9 * cov.pose_covariance.max()


def test_everything_held_has_no_covariance():
    problem = scene()
    cov = bundle.covariance(problem, refine=("poses",), fixed_image_ids=range(1, 6))
    assert (cov.pose_covariance == 0).all()
    assert cov.dof == 2 * problem.num_observations


def test_a_point_in_very_many_images():
    problem = scene(num_images=150, num_points=8, shared=True)
    cov = bundle.covariance(problem)
    assert (np.linalg.eigvalsh(cov.point_covariance) > 0).all()
    assert np.isfinite(cov.pose_covariance).all()
