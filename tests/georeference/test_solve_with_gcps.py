"""Control points in a solve: against dense least squares, known truth, and the limits of sigma."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.georeference import target_priors
from bundle.georeference.alignment_result import root_mean_square
from bundle.georeference.target_priors import LARGEST_ID, TargetPriors
from bundle.model.residuals import linearize
from tests.georeference.flights import flight

CORNERS = [(-22, -20, 0.5), (21, -22, -0.4), (-20, 23, 0.2), (22, 21, -0.6)]
LINE = [(-20, 0, 0), (0, 0, 0), (20, 0, 0)]
SPREAD = [*CORNERS, (0, 2, 0.8), (-2, -15, -0.9)]
TIGHT = {"function_tolerance": 1e-15, "gradient_tolerance": 1e-14, "parameter_tolerance": 1e-14}


def small(targets=CORNERS, **settings):
    return flight(targets, num_images=9, num_points=60, start_noise=0.05, **settings)


def without_height(point):
    return dataclasses.replace(point, position=(*point.position[:2], np.nan))


def with_points(problem, gcps, pixel_sigma=0.5):
    """The problem with the targets as ordinary points, which begin at their surveyed places."""
    index = {name: row for row, name in enumerate(problem.image_names)}
    image, point, xy = [], [], []
    for row, gcp in enumerate(gcps):
        for entry in gcp.measurements:
            image.append(index[entry.image])
            point.append(problem.num_points + row)
            xy.append((entry.x, entry.y))
    ids = 1000 + np.arange(len(gcps))
    return problem.replace(
        points=np.concatenate([problem.points, np.nan_to_num([gcp.position for gcp in gcps])]),
        point_ids=np.concatenate([problem.point_ids, ids]),
        observation_image=np.concatenate([problem.observation_image, image]),
        observation_point=np.concatenate([problem.observation_point, point]),
        observation_xy=np.concatenate([problem.observation_xy, xy]),
        observation_keypoint=np.full(problem.num_observations + len(image), -1),
        observation_sigma=np.concatenate(
            [np.ones(problem.num_observations), np.full(len(image), pixel_sigma)]
        ),
    )


def whitened(problem, gcps, sigma):
    """Residuals of a problem as `with_points` makes it, and their dense Jacobian.

    Columns: 6 for each image, focal length and distortion, 3 for each point.
    """
    parts = linearize(problem)
    num_poses, num_points = 6 * problem.num_images, problem.num_points
    jacobian = np.zeros((problem.num_observations, 2, num_poses + 2 + 3 * num_points))
    n, side = np.arange(problem.num_observations)[:, None, None], np.arange(2)[:, None]
    pose = 6 * problem.observation_image[:, None, None] + np.arange(6)
    point = num_poses + 2 + 3 * problem.observation_point[:, None, None] + np.arange(3)
    jacobian[n, side, pose] = parts.d_pose
    jacobian[n, side, point] = parts.d_point
    jacobian[:, :, num_poses : num_poses + 2] = parts.d_params[:, :, [0, 3]]
    weight = 1 / problem.observation_sigma
    rows = [(weight[:, None, None] * jacobian).reshape(2 * len(weight), -1)]
    residual = [(weight[:, None] * parts.residual).ravel()]
    for row, gcp in enumerate(gcps):
        axes = 2 if np.isnan(gcp.position[2]) else 3
        place = num_points - len(gcps) + row
        prior = np.zeros((axes, jacobian.shape[2]))
        start = num_poses + 2 + 3 * place
        prior[:, start : start + axes] = np.eye(axes) / sigma
        rows.append(prior)
        residual.append((problem.points[place] - gcp.position)[:axes] / sigma)
    return np.concatenate(residual), np.concatenate(rows)


def dense_solution(problem, gcps, sigma, steps=6):
    """Gauss-Newton steps of least length on a dense matrix."""
    for _ in range(steps):
        residual, jacobian = whitened(problem, gcps, sigma)
        step = -np.linalg.lstsq(jacobian, residual, rcond=1e-12)[0]
        num_poses = 6 * problem.num_images
        poses = [
            np.concatenate([_turned(pose[:4], move[:3]), pose[4:] + move[3:]])
            for pose, move in zip(
                problem.cam_from_world, step[:num_poses].reshape(-1, 6), strict=True
            )
        ]
        params = problem.camera_params.copy()
        params[0, [0, 3]] += step[num_poses : num_poses + 2]
        points = problem.points + step[num_poses + 2 :].reshape(-1, 3)
        problem = problem.replace(cam_from_world=poses, camera_params=params, points=points)
    residual, _ = whitened(problem, gcps, sigma)
    return problem, 0.5 * residual @ residual


def _turned(quaternion, rotvec):
    from scipy.spatial.transform import Rotation

    return (Rotation.from_rotvec(rotvec) * Rotation.from_quat(quaternion)).as_quat()


@pytest.mark.parametrize(("heights", "backend"), [(True, "ceres"), (False, "fused")])
def test_a_dense_solver_finds_the_same(heights, backend):
    made = small()
    gcps = made.gcps if heights else [without_height(made.gcps[0]), *made.gcps[1:]]
    expected, cost = dense_solution(with_points(made.problem, gcps), gcps, 0.02)
    found = bundle.solve(made.problem, priors=gcps, align=False, backend=backend, **TIGHT)
    assert found.options.gauge == "none"
    assert found.summary.final_cost == pytest.approx(cost, rel=1e-9)
    count = made.problem.num_points
    np.testing.assert_allclose(found.problem.points, expected.points[:count], atol=1e-6)
    np.testing.assert_allclose(
        found.problem.projection_centers, expected.projection_centers, atol=1e-6
    )
    np.testing.assert_array_equal(found.problem.point_ids, made.problem.point_ids)
    np.testing.assert_array_equal(found.problem.observation_xy, made.problem.observation_xy)
    assert found.problem.observation_sigma is None
    assert len(found.factor_costs_after) == 4
    prior = (expected.points[count:] - [gcp.position for gcp in gcps]) / 0.02
    np.testing.assert_allclose(
        found.factor_costs_after, 0.5 * np.nansum(prior**2, axis=1), rtol=1e-5, atol=1e-9
    )


def test_a_small_sigma_pins_the_point_and_a_large_one_frees_it():
    made = small()
    options = {"gauge": "none", **TIGHT}

    def solved(sigma):
        gcps = [dataclasses.replace(gcp, sigma=sigma) for gcp in made.gcps]
        return bundle.solve(made.problem, priors=gcps, align=False, **options)

    as_points = with_points(made.problem, made.gcps)
    held = bundle.solve(as_points, fixed_point_ids=range(1000, 1004), **options)
    pinned = solved(1e-7)
    assert pinned.summary.final_cost == pytest.approx(held.summary.final_cost, rel=1e-8)
    count = made.problem.num_points
    np.testing.assert_allclose(pinned.problem.points, held.problem.points[:count], atol=1e-6)
    free = bundle.solve(as_points, **options)
    loose = solved(1e8)
    assert loose.summary.final_cost == pytest.approx(free.summary.final_cost, rel=1e-8)


def test_pixels_of_a_large_sigma_say_nothing():
    made = small()
    gcps = [
        dataclasses.replace(
            gcp, measurements=[(*entry[:3], 1e8) for entry in gcp.measurements], sigma=1e3
        )
        for gcp in made.gcps
    ]
    plain = bundle.solve(made.problem, gauge="none", **TIGHT)
    found = bundle.solve(made.problem, priors=gcps, align=False, **TIGHT)
    assert found.summary.final_cost == pytest.approx(plain.summary.final_cost, rel=1e-8)


def test_what_control_points_leave_open_is_counted_and_not_held():
    made = small()
    line = flight(LINE, num_images=9, num_points=60, survey_noise=0.0)
    sets = {
        1: (made, made.gcps[:1], 4),
        2: (made, made.gcps[:2], 1),
        "2 and a place": (made, [*made.gcps[:2], without_height(made.gcps[2])], 0),
        3: (made, made.gcps[:3], 0),
        "on a line": (line, line.gcps, 1),
    }
    for what, (where, gcps, expected) in sets.items():
        problem = with_points(where.problem, gcps)
        _, jacobian = whitened(problem, gcps, 0.02)
        values = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), compute_uv=False)
        assert (values < 1e-9).sum() == expected, what
        if what == "2 and a place":  # leave a tilt all but open, and dense steps go astray
            continue
        # Of what is left nothing is held twice: the cost is that of the best model.
        _, cost = dense_solution(problem, gcps, 0.02)
        for backend in ("ceres", "fused"):
            found = bundle.solve(where.problem, priors=gcps, align=False, backend=backend, **TIGHT)
            assert found.options.gauge == "none"
            assert found.summary.final_cost == pytest.approx(cost, rel=1e-8), (what, backend)


def test_the_start_may_be_anywhere():
    made = small(survey_noise=0.02)
    there = bundle.solve(made.problem, priors=made.gcps, align=False, **TIGHT)
    found = bundle.solve(made.elsewhere(), priors=made.gcps, **TIGHT)
    assert found.similarity.scale == pytest.approx(1 / 0.27, rel=0.02)
    assert found.summary.final_cost == pytest.approx(there.summary.final_cost, rel=1e-8)
    np.testing.assert_allclose(found.problem.points, there.problem.points, atol=1e-5)
    np.testing.assert_allclose(
        [point.residual for point in found.control_points],
        [point.residual for point in there.control_points],
        atol=1e-5,
    )


def test_control_points_beside_positions_of_images():
    made = small()
    centers = made.truth.projection_centers
    priors = [
        bundle.PositionPrior(name, center, 0.5)
        for name, center in zip(made.problem.image_names, centers, strict=True)
    ]
    found = bundle.solve(made.elsewhere(), priors=[*made.gcps[:1], *priors, *made.gcps[1:2]])
    assert len(found.factor_costs_after) == 11
    assert [point.name for point in found.control_points] == ["t0", "t1"]
    np.testing.assert_allclose(found.problem.projection_centers, centers, atol=0.3)
    # The costs of control points come last.
    alone = bundle.solve(found.problem, priors=priors, align=False, max_num_iterations=0)
    np.testing.assert_allclose(
        found.factor_costs_after[:9], alone.factor_costs_before, rtol=1e-6, atol=1e-9
    )


def test_check_points_never_influence():
    made = small(SPREAD)
    check = [dataclasses.replace(gcp, role="check") for gcp in made.gcps[4:]]
    far = [dataclasses.replace(gcp, position=(900.0, 0.0, 5.0)) for gcp in check]
    start = made.elsewhere()
    without = bundle.solve(start, priors=made.gcps[:4])
    found = bundle.solve(start, priors=[*made.gcps[:4], *check])
    moved = bundle.solve(start, priors=[*far, *made.gcps[:4]])
    for other in (found, moved):
        np.testing.assert_array_equal(other.problem.points, without.problem.points)
        assert other.summary.final_cost == without.summary.final_cost
    assert [point.role for point in found.control_points] == ["control"] * 4 + ["check"] * 2
    for point, wrong, gcp in zip(
        found.control_points[4:], moved.control_points[:2], check, strict=True
    ):
        assert np.abs(point.residual).max() < 0.2
        assert (point.position, wrong.position) == (gcp.position, (900.0, 0.0, 5.0))
        shift = np.subtract(point.residual, wrong.residual)
        np.testing.assert_allclose(shift, np.subtract((900.0, 0, 5), gcp.position), atol=1e-6)


def bowl(**settings):
    """A flat flight whose start bends: its lens is another one."""
    targets = [*SPREAD, (10, 0, 0.1), (-9, 8, 0.3), (4, 15, -0.5), (0, -8, 0.0), (16, 12, 0.4)]
    return flight(targets, num_images=16, num_points=120, seed=2, start_k=0.02, **settings)


def test_control_points_take_the_bowl_out_and_statistics_agree():
    made = bowl(sigma=0.02)
    check = [dataclasses.replace(gcp, role="check") for gcp in made.gcps[6:]]
    gcps = [*made.gcps[:6], *check]
    start = made.elsewhere()
    # Without: the lens is held, as it is known wrongly, so that the ground bends.
    bent = bundle.solve(start, refine="poses,points")
    aligned = bundle.align(bent.problem, gcps=gcps)
    found = bundle.solve(start, priors=gcps)
    before = aligned.rms("check")
    after = root_mean_square(p.residual for p in found.control_points if p.role == "check")
    assert before[2] > 0.3
    assert after[2] < 0.1 and after[0] < 0.05 and after[1] < 0.05
    np.testing.assert_allclose(found.problem.camera_params[0, 3], -0.05, atol=2e-3)
    # With honest sigmas the cost is that of a chi squared distribution.
    pixels = start.num_observations + sum(len(gcp.measurements) for gcp in gcps[:6])
    unknowns = 6 * start.num_images + 2 + 3 * (start.num_points + 6)
    freedom = 2 * pixels + 3 * 6 - unknowns
    sigma0 = np.sqrt(2 * found.summary.final_cost / freedom)
    assert sigma0 == pytest.approx(1, abs=4 / np.sqrt(2 * freedom))


def test_a_robust_loss_keeps_a_gross_error_out():
    made = small(SPREAD)
    x, y, z = made.gcps[2].position
    wrong = list(made.gcps)
    wrong[2] = dataclasses.replace(made.gcps[2], position=(x + 3.5, y, z))
    robust = [dataclasses.replace(gcp, loss="tukey") for gcp in wrong]
    start = made.elsewhere()
    right = bundle.solve(start, priors=[gcp for gcp in made.gcps if gcp.name != "t2"])
    bent = bundle.solve(start, priors=wrong)
    found = bundle.solve(start, priors=robust)
    distance = [
        np.abs(result.problem.points - right.problem.points).max() for result in (bent, found)
    ]
    assert distance[0] > 0.2 and distance[1] < 0.05
    residuals = {point.name: np.abs(point.residual).max() for point in found.control_points}
    assert residuals.pop("t2") == pytest.approx(3.5, abs=0.2)
    assert max(residuals.values()) < 0.15


def test_a_gross_error_below_the_bowl_is_a_suspect_after_the_solve():
    made = bowl(sigma=0.02)
    x, y, z = made.gcps[4].position
    wrong = [
        dataclasses.replace(gcp, position=(x, y, z + 0.4)) if gcp.name == "t4" else gcp
        for gcp in made.gcps
    ]
    bent = bundle.solve(made.elsewhere(), refine="poses,points").problem
    for gcps, expected in ((wrong, ("t4",)), (made.gcps, ())):
        known = bundle.georeference.gcp_priors(bent, gcps, prior_loss="tukey")
        assert known.suspects == ()
        found = known.georeference(bundle.solve(bent, priors=known.priors))
        assert found.suspect_points == expected
        if expected:
            assert found.control_points[4].leave_one_out[2] == pytest.approx(-0.4, abs=0.1)


def test_no_filter_removes_a_measurement():
    made = small()
    first, *others = made.gcps
    entries = [first.measurements[0]._replace(x=first.measurements[0].x + 30)]
    wrong = [dataclasses.replace(first, measurements=[*entries, *first.measurements[1:]]), *others]
    settings = {"max_error": 2.0, "num_rounds": 3}
    found = bundle.solve_rounds(made.problem, priors=wrong, align=False, **settings)
    removed = sum(done.num_observations_removed for done in found.rounds)
    assert removed > 0
    assert made.problem.num_observations - found.problem.num_observations == removed
    problem = made.problem
    for _ in found.rounds:
        result = bundle.solve(problem, priors=wrong, align=False)
        problem = bundle.filter_observations(result.problem, max_error=2.0).problem
    result = bundle.solve(problem, priors=wrong, align=False)  # rounds end at a minimum
    assert found.summary.final_cost == pytest.approx(result.summary.final_cost, rel=1e-6)
    np.testing.assert_array_equal(found.problem.point_ids, problem.point_ids)
    assert [p.num_images for p in found.control_points] == [len(g.measurements) for g in wrong]


class StopError(Exception):
    """Stands for a kill."""


def test_a_run_that_was_stopped_goes_on_to_the_same_end(tmp_path):
    made = small()
    options = {
        "deterministic": True,
        "num_threads": 1,
        "num_rounds": 2,
        "max_error": 2.5,
        "checkpoint_interval": 2,
        "function_tolerance": 1e-12,
    }
    start, gcps = made.elsewhere(), made.gcps

    def run(name, priors=gcps, **more):
        return bundle.solve_rounds(
            start, priors=priors, checkpoint=tmp_path / name, **options, **more
        )

    expected = run("whole")
    reports = iter(range(5))

    def stop(_):
        if next(reports, None) is None:
            raise StopError

    with pytest.raises(StopError):
        run("killed", progress=stop)
    found = run("killed", resume=tmp_path / "killed")
    for name in ("points", "cam_from_world", "camera_params", "observation_xy"):
        np.testing.assert_array_equal(getattr(found.problem, name), getattr(expected.problem, name))
    assert repr(found.control_points) == repr(expected.control_points)
    assert found.rounds == expected.rounds
    other = [dataclasses.replace(gcps[0], sigma=0.5), *gcps[1:]]
    with pytest.raises(bundle.InputError, match="checkpoint"):
        run("killed", priors=other, resume=tmp_path / "killed")
    entries = [first._replace(sigma=0.7) for first in gcps[0].measurements]
    other = [dataclasses.replace(gcps[0], measurements=entries), *gcps[1:]]
    with pytest.raises(bundle.InputError, match="checkpoint"):
        run("killed", priors=other, resume=tmp_path / "killed")


def test_ids_that_are_taken_are_not_given_twice():
    made = small()
    ids = made.problem.point_ids.copy()
    ids[-1] = 2**63 - 2
    problem = made.problem.replace(point_ids=ids)
    targets = TargetPriors.make(problem, made.gcps)
    assert len({*targets.point_ids, *ids.tolist()}) == len(ids) + 4
    result = bundle.solve(problem, priors=made.gcps, max_num_iterations=1)
    np.testing.assert_array_equal(result.problem.point_ids, ids)


@pytest.mark.parametrize(
    ("taken", "free"),
    [
        ([4, 9], (10, 11, 12)),
        ([2, LARGEST_ID - 4], (LARGEST_ID - 3, LARGEST_ID - 2, LARGEST_ID - 1)),
        ([0, 2, LARGEST_ID - 3], (1, 3, 4)),
        ([*range(6), LARGEST_ID], (6, 7, 8)),
    ],
)
def test_free_ids_follow_the_largest_or_fill_the_gaps(taken, free):
    problem = SimpleNamespace(point_ids=np.array(taken), num_points=len(taken))
    assert target_priors._free_ids(problem, 3) == free


def test_sigmas_of_the_problem_stay():
    made = small()
    sigma = np.linspace(0.5, 2, made.problem.num_observations)
    problem = made.problem.replace(observation_sigma=sigma)
    result = bundle.solve(problem, priors=made.gcps, max_num_iterations=2)
    np.testing.assert_array_equal(result.problem.observation_sigma, sigma)
    assert _core.is_immutable(result.problem.observation_sigma)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"reference_system": "EPSG:4326"}, ["t0", "gcp_priors", "EPSG:4326"]),
        ({"name": "t1"}, ["found 't1' twice"]),
    ],
)
def test_control_points_that_do_not_fit(change, expected):
    made = small()
    gcps = [dataclasses.replace(made.gcps[0], **change), *made.gcps[1:]]
    with pytest.raises(bundle.InputError) as caught:
        bundle.solve(made.problem, priors=gcps)
    assert all(part in str(caught.value) for part in ["priors", *expected])
    assert "\n" not in str(caught.value)


def test_too_few_are_refused_or_leave_the_problem_in_place():
    made = small()
    with pytest.raises(bundle.InputError, match=r"^priors: expected at least 3 .*found 2$"):
        bundle.solve(made.problem, priors=made.gcps[:2], align=True)
    assert bundle.solve(made.problem, priors=made.gcps[:2]).similarity is None
    line = flight(LINE, num_images=9, num_points=60, survey_noise=0.0)
    with pytest.raises(bundle.InputError, match=r"^priors: .*lie on one line"):
        bundle.solve(line.problem, priors=line.gcps, align=True)
    single = [dataclasses.replace(gcp, measurements=gcp.measurements[:1]) for gcp in made.gcps]
    with pytest.raises(bundle.InputError, match=r"^priors: .*2 images .*t0: measured in 1"):
        bundle.solve(made.problem, priors=single)
    some = bundle.solve(made.problem, priors=[single[0], *made.gcps[1:]])
    assert [point.role for point in some.control_points] == ["unused"] + ["control"] * 3
    with pytest.raises(bundle.InputError, match="only_images"):
        bundle.solve_rounds(made.problem, priors=made.gcps, only_images="1-3", num_rounds=0)
