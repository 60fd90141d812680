"""Covariances of problems with next to nothing in them: a stated result, or one clear line."""

import re

import numpy as np
import pytest

import bundle
from bundle import _core
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


def turned_away():
    """Every point behind every camera."""
    problem = scene()
    poses = problem.cam_from_world.copy()
    poses[:, 6] -= 50
    return problem.replace(cam_from_world=poses)


@pytest.mark.parametrize(
    "settings",
    [
        *({"gauge": gauge, "robust": "sandwich"} for gauge in ("inner", "two_cameras", "none")),
        *({"of": part} for part in ("poses", "points", "intrinsics")),
        {"scale": "sigma0"},
    ],
)
def test_without_observations_nothing_is_known(settings):
    for problem in (observed(scene(), slice(0, 0)), without_points()):
        with pytest.raises(bundle.InputError, match=r"^problem: expected observations"):
            bundle.covariance(problem, **settings)
    with pytest.raises(bundle.InputError, match=r"^problem: "):
        bundle.covariance(turned_away(), **settings)
    assert "no observations" in bundle.diagnose(without_points()).findings[0].sentence


def test_a_prior_is_no_observation():
    problem = observed(scene(), slice(0, 0))
    rule = "camera 1: f prior 800 sigma 2"
    with pytest.raises(bundle.InputError, match=r"^problem: expected observations"):
        bundle.covariance(problem, constraints=[rule])


def scaled(problem, factor):
    poses = problem.cam_from_world.copy()
    poses[:, 4:] *= factor
    return problem.replace(cam_from_world=poses, points=problem.points * factor)


def far_point(problem):
    points = problem.points.copy()
    points[3] = 1e100
    return problem.replace(points=points)


def far_image(problem):
    poses = problem.cam_from_world.copy()
    poses[2, 4] = -1e100
    return problem.replace(cam_from_world=poses)


@pytest.mark.parametrize("gauge", ["inner", "two_cameras", "three_points"])
@pytest.mark.parametrize(
    ("change", "name"),
    [
        (far_point, "point 4: "),
        (far_image, "image 3: "),
        *((lambda problem, k=k: scaled(problem, k), "point ") for k in (1e70, 1e100, 1e160, 1e300)),
    ],
)
def test_coordinates_beyond_doubles_have_no_variances(change, name, gauge):
    with pytest.raises(bundle.InputError, match=f"^{name}.*expected coordinates"):
        bundle.covariance(change(scene()), gauge=gauge)


@pytest.mark.parametrize("factor", [1e-6, 1e12, 1e30])
def test_variances_scale_with_the_square_of_the_unit(factor):
    problem = bundle.solve(scene()).problem
    one = bundle.covariance(problem, gauge="two_cameras")
    other = bundle.covariance(scaled(problem, factor), gauge="two_cameras")
    np.testing.assert_allclose(other.point_covariance, one.point_covariance * factor**2, rtol=1e-5)
    np.testing.assert_allclose(other.camera_covariance, one.camera_covariance, rtol=1e-5)


def test_no_variance_is_rounding(monkeypatch):
    """Whatever the core makes of extreme numbers, none that is negative or no number leaves."""
    compute = _core.covariance
    for part, value in (("poses", -1e-3), ("poses", np.nan), ("points", np.inf), ("cameras", -1.0)):

        def spoiled(*args, part=part, value=value):
            out = compute(*args)
            changed = out[part].copy()
            changed[1, 0, 0] = value
            return {**out, part: changed}

        monkeypatch.setattr(_core, "covariance", spoiled)
        with pytest.raises(bundle.InputError, match=r"^(image|point|camera) 2: expected variances"):
            bundle.covariance(scene())


@pytest.mark.parametrize("loss", ["cauchy", "huber"])
def test_a_missing_loss_is_named(loss):
    problem = scene(num_points=60, perturbation=1e-2)
    xy = problem.observation_xy.copy()
    xy[::7] += 40
    problem = problem.replace(observation_xy=xy)
    refined = bundle.solve(problem, loss=loss, function_tolerance=1e-12)
    assert bundle.covariance(refined).notes == ()
    (without,) = bundle.covariance(refined.problem).notes
    assert "--loss" in without
    (other,) = bundle.covariance(problem, loss=loss).notes
    assert "--loss" not in other


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
    """Fixing the gauge of a dense S spreads what is not known over all images."""
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
