"""Leverages several at a time against those row by row, in problems of every kind."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
import bundle._core as _core
from bundle.analysis.uncertainty.influence import _core_influence
from bundle.analysis.uncertainty.quantity import quantity_of
from bundle.interface.analysis_options import NOT_CHECKABLE
from bundle.interface.options import SolveOptions
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from tests import rolling
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import Case
from tests.analysis.uncertainty.test_reliability import check_effects
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem, with_observations

ROBUST = {"loss": "cauchy", "loss_scale": 0.4}


def many(**of):
    """A problem beyond long sums, so that its influences are computed several at a time."""
    return make_problem(num_images=12, num_points=200, perturbation=1e-3, **of)


def gaps(problem):
    """Without some observations, so that tracks differ; two points with two rays, one with one."""
    rng = np.random.default_rng(4)
    keep = rng.random(problem.num_observations) < 0.6
    for point, count in ((0, 2), (1, 2), (2, 1)):
        rows = np.flatnonzero(problem.observation_point == point)
        keep[rows] = np.arange(len(rows)) < count
    return with_observations(problem, keep)


def behind(problem):
    """Some points are behind one camera: their observations do not count."""
    points = problem.points.copy()
    axis = Rotation.from_quat(problem.cam_from_world[0, :4]).as_matrix()[2]
    points[3:5] = problem.projection_centers[0] - 2 * axis
    return problem.replace(points=points)


def far(problem):
    """Two points are far away: they determine most of the gauge of the points."""
    points, middle = problem.points.copy(), problem.projection_centers.mean(axis=0)
    points[[5, 11]] = middle + 40 * (points[[5, 11]] - middle)
    return problem.replace(points=points)


def with_sigmas(problem):
    sigmas = np.random.default_rng(5).uniform(0.5, 3, problem.num_observations)
    return problem.replace(observation_sigma=sigmas)


def held(problem):
    """Options with constant images, whose camera is constant, too, and constant points."""
    return {
        "fixed_image_ids": problem.image_ids[[1, 4]],
        "fixed_camera_ids": problem.camera_ids[:2],
        "fixed_point_ids": problem.point_ids[[2, 9, 17]],
    }


CASES = {
    "own lenses": (gaps(many(seed=1)), {}),
    "one lens": (
        gaps(many(seed=2, shared=True)),
        {"refine": ("poses", "points", "focal", "extra")},
    ),
    "sigmas": (with_sigmas(many(seed=3)), ROBUST),
    "loss": (gaps(many(seed=4, model="OPENCV")), {"loss": "tukey", "loss_scale": 1.5}),
    "behind a camera": (behind(gaps(many(seed=5))), ROBUST),
    "constant images and points": (gaps(many(seed=6)), held(many(seed=6))),
    "constant poses": (many(seed=7, shared=True), {"refine": ("points", "focal")}),
    "stereo": (gaps(rig_problem(rigs=(STEREO,), num_frames=9, num_points=90)), ROBUST),
    "rigs, sensors refined": (
        gaps(rig_problem(rigs=(FIVE, STEREO), num_frames=4, num_alone=2, num_points=90)),
        {"refine_sensor_from_rig": True},
    ),
    "rolling shutters": (rolling.filmed(gaps(many(seed=8)), row_time="fixed-point"), ROBUST),
    "velocities": (
        rolling.filmed(many(seed=9), row_time="fixed-point", ties=True),
        {"twists": "hard"},
    ),
}  # fmt: skip


BY_PRIORS = {5: 1.0, 20: 1.0, 40: 1.0, 60: 1.0}
"""Information of points by index, which holds the world."""


def prepared_with(problem, options, information):
    """A solve with priors on points: those of `information` by index."""
    factors = [
        bundle.PriorFactor(
            ("point", int(problem.point_ids[k])), problem.points[k], size * np.eye(3)
        )
        for k, size in information.items()
    ]
    options = SolveOptions().replace(**options)
    return prepare(SolveRequest(problem=problem, options=options, factors=factors, align=False))


def reliability_of(prepared, num_worst=0, least=NOT_CHECKABLE, long_sums=False):
    layout = prepared.layout
    given = (prepared.start, layout.options.asdict(), layout.limits, layout.core_factors())
    return _core.reliability(*given, least, num_worst, long_sums)


@pytest.mark.parametrize("case", CASES)
def test_leverages_agree_with_those_row_by_row(case):
    """Points with priors have rows: a few, or all points by priors of no weight."""
    problem, options = CASES[case]
    found = reliability_of(prepared_with(problem, options, BY_PRIORS))
    free = np.flatnonzero(~np.isin(problem.point_ids, options.get("fixed_point_ids", ())))
    by_rows = reliability_of(
        prepared_with(problem, options, dict.fromkeys(free, 1e-12) | BY_PRIORS)
    )
    used = np.isfinite(found["weights"])
    assert used.mean() > 0.9 and used.all() == (case != "behind a camera")
    for name in ("leverages", "residuals", "weights"):
        near = {"rtol": 1e-7, "atol": 1e-9}
        np.testing.assert_allclose(found[name], by_rows[name], **near, err_msg=name)
    # Leverages of any system sum up to the number of its parameters.
    of_priors = np.nansum(found["factor_measurements"] - found["factor_redundancy"])
    assert found["num_parameters"] - found["gauge_degrees"] == pytest.approx(
        found["leverages"][used][:, [0, 2]].sum() + of_priors, rel=1e-8
    )


@pytest.mark.parametrize("case", CASES)
def test_movements_agree_with_those_row_by_row(case):
    """Movements by more errors than one pass takes, in a world that priors hold."""
    problem, options = CASES[case]
    found = reliability_of(prepared_with(problem, options, BY_PRIORS), 50)["worst"]
    free = np.flatnonzero(~np.isin(problem.point_ids, options.get("fixed_point_ids", ())))
    of_all = prepared_with(problem, options, dict.fromkeys(free, 1e-12) | BY_PRIORS)
    compare_movements(found, reliability_of(of_all, 50)["worst"])


@pytest.mark.parametrize("seed", range(4))
def test_movements_in_a_free_world_agree_with_those_in_long_doubles(seed):
    """Sums in long doubles are row by row, and their covariances transformed as blocks of S."""
    problem = make_problem(num_images=6, num_points=30, perturbation=1e-3, seed=seed)
    options = SolveOptions().replace(num_threads=1 + seed % 2)
    prepared = prepare(SolveRequest(problem=gaps(problem), options=options))
    found = reliability_of(prepared, 25)["worst"]
    compare_movements(found, reliability_of(prepared, 25, long_sums=True)["worst"])


@pytest.mark.parametrize("case", ["own lenses", "one lens", "loss", "stereo", "far points"])
def test_movements_in_a_free_world_agree_with_dense_matrices(case):
    problem, options = (CASES | {"far points": (far(many(seed=1)), {})})[case]
    robust = {name: options[name] for name in ("loss", "loss_scale") if name in options}
    rays = np.bincount(problem.observation_point)
    problem = with_observations(problem, rays[problem.observation_point] > 1)
    dense = Dense(problem, **robust)
    principal = (2, 3) if case in ("loss", "stereo") else (1, 2)  # PINHOLE and OPENCV have two f
    held = [kind == "sensor" or (kind == "camera" and k in principal) for kind, _, k in dense.names]
    basis = np.eye(len(dense.names))[:, ~np.array(held) & dense.jacobian.any(axis=0)]
    found = bundle.reliability(problem, **options)
    check_effects(found, Case(problem, {}, [], dense, basis, 0), dense.covariance(basis))


@pytest.mark.parametrize("case", CASES)
def test_movements_do_not_depend_on_the_order(case):
    """The order of observations is that of points and chunks, too."""
    problem, options = CASES[case]
    order = np.random.default_rng(7).permutation(problem.num_observations)
    found = []
    mixed = with_observations(problem, order)
    if problem.observation_sigma is not None:
        mixed = mixed.replace(observation_sigma=problem.observation_sigma[order])
    for each in (problem, mixed):
        request = SolveRequest(problem=each, options=SolveOptions().replace(**options))
        found.append(reliability_of(prepare(request), 30)["worst"])
    found[1] = [(order[one[0]], *one[1:]) for one in found[1]]
    compare_movements(found[1], found[0])


def compare_movements(found, expected):
    assert [one[0] for one in found] == [one[0] for one in expected]
    assert len(found) >= 20 and {one[1] for one in found} - {-1}
    assert [one[1] for one in found] == [one[1] for one in expected]
    for at in (2, 4):  # images of one rig may move by the same
        sigmas = [one[at] for one in expected]
        np.testing.assert_allclose([one[at] for one in found], sigmas, rtol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_influences_agree_with_those_row_by_row(case):
    problem, options = CASES[case]
    ids = problem.image_ids
    quantity = quantity_of(f"baseline {ids[0]} {ids[3]} / baseline {ids[2]} {ids[-1]}", problem, {})
    prepared = prepared_with(problem, options, BY_PRIORS)
    out = _core_influence(prepared, quantity, "observations")
    near = {"rtol": 1e-6, "atol": 1e-8 * np.sqrt(out["variance"])}
    # All points have rows for deletions of points; nothing is deleted without a kind.
    for kind in ("points", ""):
        other = _core_influence(prepared, quantity, kind)
        np.testing.assert_allclose(out["along"], other["along"], **near)
        np.testing.assert_allclose(out["weights"], other["weights"], rtol=1e-12)
        assert out["step"] == pytest.approx(other["step"], rel=1e-6, abs=near["atol"])
    # The squares of J~ a are shares of the variance.
    whole = np.nansum(out["along"] ** 2) + np.nansum(out["factor_share"])
    assert whole == pytest.approx(out["variance"], rel=1e-8)
    found = reliability_of(prepared)
    rest = np.eye(2) - np.nan_to_num(found["leverages"][:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    checked = (found["weights"] > 0) & (np.linalg.eigvalsh(rest)[:, 0] > 1e-3)
    solved = np.linalg.solve(rest[checked], found["residuals"][checked][:, :, None])
    change = (out["along"][checked] * solved[:, :, 0]).sum(axis=1)
    np.testing.assert_allclose(out["without"][checked], change, **near)


@pytest.mark.parametrize("case", ["own lenses", "one lens", "stereo", "rigs, sensors refined"])
def test_deletions_of_points_agree_with_steps_of_smaller_problems(case):
    """At a minimum, one step of Gauss-Newton without the point, with rows of the same place."""
    problem, options = CASES[case]
    options = {key: value for key, value in options.items() if not key.startswith("loss")}
    tight = {"function_tolerance": 1e-15, "gradient_tolerance": 0, "parameter_tolerance": 0}
    solved = bundle.solve(problem, **options, **tight).problem
    ids = solved.image_ids
    quantity = quantity_of(f"baseline {ids[0]} {ids[3]} / baseline {ids[2]} {ids[-1]}", solved, {})
    prepared = prepared_with(solved, options, BY_PRIORS)  # at the points: of no force
    out = _core_influence(prepared, quantity, "points")
    sigma = np.sqrt(out["variance"])
    for point in (0, 1, 7, 31, 55):
        keep = solved.observation_point != point
        change = _core_influence(prepared, quantity, keep=keep)["step"] - out["step"]
        assert out["without"][point] == pytest.approx(change, rel=1e-5, abs=1e-7 * sigma)
