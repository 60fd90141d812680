"""Priors of positions in a solve: limits, alignment, both backends, the published table."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, PositionPrior
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.prior_alignment import ProblemPriors
from bundle.georeference.similarity import umeyama
from tests import scenes
from tests.georeference.test_prior_alignment import LEVER, antennas, priors, problem_and_goal

TIGHT = {
    "function_tolerance": 1e-16,
    "gradient_tolerance": 1e-12,
    "parameter_tolerance": 1e-15,
    "max_num_iterations": 300,
}


def noisy(goal, sigma, lever=(0, 0, 0)):
    rng = np.random.default_rng(11)
    return antennas(goal, lever) + sigma * rng.standard_normal((goal.num_images, 3))


def test_sigmas_towards_infinity_are_a_free_solve(backend):
    _, goal = problem_and_goal(num_images=5)
    options = {**TIGHT, "backend": backend}
    made = priors(noisy(goal, 0.1), 1e9)
    with_them = bundle.solve(goal, priors=made, align=False, **options)
    free = bundle.solve(goal, gauge="none", **options)
    assert with_them.options.gauge == "none"
    assert with_them.similarity is None
    assert with_them.summary.final_cost == pytest.approx(free.summary.final_cost, rel=1e-8)
    found, expected = with_them.problem, free.problem
    np.testing.assert_allclose(found.camera_params, expected.camera_params, rtol=0, atol=1e-5)
    # Rounding may move a free world, as a whole.
    place = umeyama(found.points, expected.points)
    np.testing.assert_allclose(place.scale * place.rotation, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(place.apply(found.points), expected.points, rtol=0, atol=2e-6)


def held_centers(problem, centers):
    """Poses and points of least squares with the centres held, by SciPy alone."""
    starts = Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()
    n = problem.num_images

    def unpacked(x):
        w, points = x[: 3 * n].reshape(n, 3), x[3 * n :].reshape(-1, 3)
        turned = [scenes.exp(w[i]) @ starts[i] for i in range(n)]
        return w, -np.array([turned[i] @ centers[i] for i in range(n)]), points

    def function(x):
        w, t, points = unpacked(x)
        return scenes.residuals(problem, w, t, points=points).ravel()

    def jacobian(x):
        columns = []
        for j in range(len(x)):
            shifted = x.astype(complex)
            shifted[j] += 1e-30j
            columns.append(function(shifted).imag / 1e-30)
        return np.array(columns).T

    start = np.r_[np.zeros(3 * n), problem.points.ravel()]
    found = least_squares(function, start, jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    return found.cost, unpacked(found.x)[2]


def test_sigmas_towards_zero_are_held_positions(backend):
    problem = scenes.make_problem(num_images=3, num_points=8, noise=0.2)
    centers = problem.projection_centers + 0.01
    cost, points = held_centers(problem, centers)
    found = problem
    # A valley this narrow is curved: from far away each step along it would be short.
    for sigma in (1e-3, 1e-5, 1e-7):
        result = bundle.solve(
            found, priors=priors(centers, sigma), align=False, refine=("poses", "points"),
            backend=backend, **TIGHT,
        )  # fmt: skip
        found = result.problem
    np.testing.assert_allclose(found.projection_centers, centers, rtol=0, atol=1e-10)
    assert result.summary.final_cost == pytest.approx(cost, rel=1e-8)
    np.testing.assert_allclose(found.points, points, rtol=0, atol=1e-7)


@pytest.mark.parametrize("lever", [np.zeros(3), LEVER])
def test_a_model_in_a_frame_of_its_own(backend, lever):
    problem, goal = problem_and_goal(noise=0.1)
    made = priors(noisy(goal, 0.1, lever), 0.1, lever_arm=lever)
    result = bundle.solve(problem, priors=made, backend=backend, **TIGHT)
    assert result.similarity.scale == pytest.approx(25, rel=0.05)
    assert result.initial_problem is problem
    assert not result.summary.warnings
    assert "moved" in repr(result)
    # The minimum does not depend on where the solve starts.
    known = bundle.solve(goal, priors=made, align=False, backend=backend, **TIGHT)
    assert known.similarity is None
    assert result.summary.final_cost == pytest.approx(known.summary.final_cost, rel=1e-9)
    np.testing.assert_allclose(result.problem.points, known.problem.points, atol=1e-4)
    residual = antennas(result.problem, lever) - [prior.position for prior in made]
    costs = 0.5 * (residual**2).sum(axis=1) / 0.1**2
    np.testing.assert_allclose(result.factor_costs_after, costs, rtol=1e-9)
    error = result.reprojection_error_after
    pixels = 0.5 * error.rmse**2 * error.num_observations
    assert result.summary.final_cost == pytest.approx(pixels + costs.sum(), rel=1e-10)


def test_when_a_problem_is_moved():
    problem, goal = problem_and_goal()
    made = priors(goal.projection_centers)
    short = {"max_num_iterations": 1}
    held = [bundle.PriorFactor(("point", 1), goal.points[0], 1.0)]
    assert bundle.solve(problem, priors=made, **short).similarity is not None
    assert bundle.solve(goal, priors=made, factors=held, **short).similarity is None
    assert bundle.solve(goal, priors=made, factors=held, align=True, **short).similarity is not None
    assert bundle.solve(goal, priors=made[:2], **short).similarity is None
    assert bundle.solve(problem, priors=[], **short).similarity is None
    both = bundle.solve(goal, priors=iter(made), factors=iter(held), **short)
    assert both.summary.num_factors == 9
    assert both.factor_costs_before[0] == pytest.approx(0, abs=1e-20)
    with pytest.raises(InputError, match="priors: expected positions of at least 3 images"):
        bundle.solve(problem, priors=made[:2], align=True)
    with pytest.raises(InputError, match="align: expected priors"):
        bundle.solve(problem, align=True)
    with pytest.raises(InputError, match="align: expected True or False"):
        bundle.solve(problem, priors=made, align="yes")
    with pytest.raises(InputError, match="priors: expected PositionPriors"):
        bundle.solve(problem, priors=[1])


def test_a_fixed_gauge_beside_priors_is_told(backend):
    _, goal = problem_and_goal()
    made = priors(noisy(goal, 0.1))
    result = bundle.solve(goal, priors=made, gauge="two_cameras", backend=backend)
    assert "gauge_beside_factors" in result.summary.warning_kinds


@pytest.fixture(scope="module")
def brighton(bundle_data):
    """The model, and positions east, north, up about DJI_0018."""
    folder = bundle_data / "georeferenced" / "brighton_gps"
    places = json.loads((folder / "lla.json").read_text())
    problem = bundle.load(folder / "model")
    frame = LocalFrame(*places["DJI_0018.JPG"])
    return problem, frame.to_enu(np.array([places[name] for name in problem.image_names]))


def refined(
    brighton, sigma, backend="fused", wrong=False, without=False, options=TIGHT, **settings
):
    """The model with these priors, DJI_0025 moved 30 m east, or left out."""
    problem, enu = brighton
    positions = enu.copy()
    row = problem.image_names.index("DJI_0025.JPG")
    positions[row, 0] += 30 * wrong
    made = [
        PositionPrior(name, position, sigma, **settings)
        for name, position in zip(problem.image_names, positions, strict=True)
        if not (without and name == "DJI_0025.JPG")
    ]
    return bundle.solve(problem, priors=made, backend=backend, **options)


CAUCHY = {"loss": "cauchy", "loss_scale": 2.795483482915108}


@pytest.mark.parametrize(
    ("sigma", "settings", "cost", "pixels", "rms"),
    [
        (2, {}, 8289.754514915, 8289.341263, (0.1817, 0.3418, 0.1839)),
        ((2, 5), {}, 8289.690578540, 8289.341250, (0.1819, 0.3417, 0.1840)),
        (0.1, {}, 8447.825177987, 8295.351431, (0.1778, 0.3281, 0.1738)),
        (0.01, {}, 14361.406804928, 10829.590194, (0.0705, 0.0986, 0.1567)),
        (2, {"wrong": True}, 8392.892190267, 8289.344669, (1.8320, 0.7630, 0.1893)),
        (2, {"wrong": True, **CAUCHY}, 8302.942862476, 8289.341263, (0.1911, 0.3472, 0.1841)),
    ],
)
def test_costs_and_residuals_of_a_drone_flight(
    brighton, backend, sigma, settings, cost, pixels, rms
):
    """By pycolmap's bundle adjustment with position priors.

    At the minimum the cost does not change to first order, but pixels and priors trade there: the
    pixels' share repeats to 3e-8 only, and pycolmap's has that much left.
    """
    result = refined(brighton, sigma, backend, **settings)
    assert result.summary.final_cost == pytest.approx(cost, rel=1e-9)
    share = result.summary.final_cost - result.factor_costs_after.sum()
    assert share == pytest.approx(pixels, rel=5e-8)
    error = result.reprojection_error_after
    assert 0.5 * error.rmse**2 * error.num_observations == pytest.approx(share, rel=1e-9)
    residual = result.problem.projection_centers - brighton[1]
    np.testing.assert_allclose(np.sqrt((residual**2).mean(axis=0)), rms, rtol=0, atol=1e-4)


@pytest.mark.parametrize("loss", ["tukey", "arctan"])
def test_a_wrong_position_moves_nothing(brighton, loss):
    """With a loss that gives up on gross errors; Cauchy's keeps pulling as 1 / distance: 11 cm."""
    clean = refined(brighton, 2, loss=loss, without=True)
    robust = refined(brighton, 2, loss=loss, wrong=True)
    moved = robust.problem.projection_centers - clean.problem.projection_centers
    assert np.linalg.norm(moved, axis=1).max() < 0.01
    plain = refined(brighton, 2, without=True).problem.projection_centers
    assert np.linalg.norm(robust.problem.projection_centers - plain, axis=1).max() < 0.01
    trusting = refined(brighton, 2, wrong=True).problem.projection_centers
    assert np.linalg.norm(trusting - plain, axis=1).max() > 1


@pytest.mark.parametrize("loss", ["trivial", "huber", "cauchy", "arctan", "tukey"])
def test_the_table_of_the_document_holds_at_the_defaults(brighton, backend, loss):
    table = (Path(__file__).parents[2] / "docs" / "positions.md").read_text()
    listed = re.search(rf"\| {loss}[^|]*\| ([\d.]+) m \|", table)[1]
    with_it, without = (
        refined(brighton, 2, backend, wrong=wrong, without=not wrong, loss=loss, options={})
        for wrong in (True, False)
    )
    away = with_it.problem.projection_centers - without.problem.projection_centers
    digit = 10.0 ** -len(listed.partition(".")[2])
    assert np.linalg.norm(away, axis=1).max() == pytest.approx(float(listed), abs=0.6 * digit)


def test_rounds_align_before_the_first(backend, monkeypatch):
    problem, goal = problem_and_goal(noise=0.5)
    calls = []
    align = ProblemPriors.align
    monkeypatch.setattr(
        ProblemPriors, "align", lambda self, given: calls.append(given) or align(self, given)
    )
    made = priors(noisy(goal, 0.1), 0.1)
    result = bundle.solve_rounds(
        problem, priors=iter(made), num_rounds=3, max_error=1.5, backend=backend
    )
    assert len(result.rounds) > 1
    assert calls == [problem]
    assert result.similarity.scale == pytest.approx(25, rel=0.05)
    assert result.initial_problem is problem
    again = bundle.solve(result.problem, priors=made, align=False, backend=backend, **TIGHT)
    np.testing.assert_allclose(
        again.problem.projection_centers, result.problem.projection_centers, atol=0.05
    )


def test_a_part_stays_in_its_place():
    _, goal = problem_and_goal(noise=0.5)
    made = priors(np.add(goal.projection_centers, [1, 0, 0]), 1e-3)
    settings = {"num_rounds": 0, "only_images": [2, 3]}
    result = bundle.solve_rounds(goal, priors=made, **settings)
    assert result.similarity is None
    moved = np.linalg.norm(result.problem.projection_centers - goal.projection_centers, axis=1)
    assert (moved > 0.5).tolist() == [False, True, True] + [False] * 5
    with pytest.raises(InputError, match="align: not valid with only_images"):
        bundle.solve_rounds(goal, priors=made, align=True, **settings)
