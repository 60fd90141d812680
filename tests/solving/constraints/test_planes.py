"""Points on planes and lines, known and estimated."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.optimize import least_squares

import bundle
from bundle.solving.constraints import resolve
from bundle.solving.constraints.resolve import apply
from tests import scenes
from tests.solving.constraints.lenses import BACKENDS, IN_PLACE, TO_THE_END, mixed, solve

PLANE = "points 4-9: on plane 1 2 2 -0.3 sigma {}"
LINE = "points 11-14: on line 0.1 0.2 0.3  0 3 4 sigma {}"
NORMAL, AXIS = np.array([1, 2, 2]) / 3, np.array([0, 3, 4]) / 5
DIAGONAL = np.array([1, -1, 0]) / np.sqrt(2)
OPTIONS = bundle.SolveOptions()
OFFSET, PLACE = 0.1, np.array([0.1, 0.2, 0.3])


def distances(points):
    """Return the signed distances from the plane, and vectors as long as those from the line."""
    return points[3:9] @ NORMAL - OFFSET, np.cross(points[10:14] - PLACE, AXIS)


@pytest.mark.parametrize("backend", BACKENDS)
def test_cost_covariance_and_redundancy_are_those_of_dense_least_squares(backend):
    problem = scenes.make_problem(num_images=3, num_points=14, shared=True)
    rules = PLANE.format(0.02), LINE.format(0.03)
    held = {"gauge": "none", "fixed_image_ids": (1, 2), "fixed_camera_ids": (1,)}
    solved = solve(problem, *rules, **held, backend=backend)

    def residual(x):
        w, t = np.zeros((3, 3)), problem.cam_from_world[:, 4:].copy()
        w[2], t[2] = x[:3], x[3:6]
        points = x[6:].reshape(-1, 3)
        pixels = scenes.residuals(problem, w, t, problem.camera_params, points)
        plane, line = distances(points)
        return np.r_[pixels.ravel(), plane / 0.02, line.ravel() / 0.03]

    start = np.r_[np.zeros(3), problem.cam_from_world[2, 4:], problem.points.ravel()]
    dense = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(solved.summary.final_cost, dense.cost, rtol=1e-9)
    points = dense.x[6:].reshape(-1, 3)
    np.testing.assert_allclose(solved.problem.points, points, rtol=1e-6, atol=1e-8)

    plane, line = distances(points)
    pulls = np.r_[plane / 0.02, np.linalg.norm(line, axis=1) / 0.03]
    ends = [one for rule in solved.constraints for one in rule.priors]
    np.testing.assert_allclose([one.pull for one in ends], pulls, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(solved.factor_costs_after, pulls**2 / 2, rtol=1e-4, atol=1e-9)
    before = distances(problem.points)
    known = np.r_[before[0], np.linalg.norm(before[1], axis=1)]
    np.testing.assert_allclose([one.before[0] for one in ends], known, atol=1e-12)
    assert [one.parameter for one in ends] == 6 * ["plane"] + 4 * ["line"]
    assert [rule.num_parameters for rule in solved.constraints] == [6, 4]
    assert {one.known for one in ends} == {(0.0,)}

    jacobian = least_squares(residual, dense.x, x_scale="jac", jac="3-point", max_nfev=1).jac
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    found = bundle.covariance(solved.problem, constraints=rules, **held)
    for point in (0, 5, 12):
        own = slice(6 + 3 * point, 9 + 3 * point)
        sigmas = found.point(int(problem.point_ids[point]))
        np.testing.assert_allclose(sigmas, inverse[own, own], rtol=1e-4, atol=1e-12)
    hat = np.einsum("ij,jk,ik->i", jacobian, inverse, jacobian)
    checked = bundle.reliability(solved.problem, constraints=rules, **held)
    count = problem.num_observations
    np.testing.assert_allclose(checked.redundancy.ravel(), 1 - hat[: 2 * count], atol=1e-5)
    own = 1 - hat[2 * count :]
    own = np.r_[own[:6], own[6:].reshape(4, 3).sum(axis=1) - 1]  # the vectors are perpendicular
    assert own.min() < 0.9
    found = [one.redundancy for one in checked.priors]
    np.testing.assert_allclose(np.sort(found), np.sort(own), atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_small_sigma_holds_and_a_large_one_does_nothing(backend):
    problem = mixed()
    held = solve(problem, PLANE.format(1e-9), LINE.format(1e-9), **IN_PLACE, backend=backend)
    for found in distances(held.problem.points):
        assert np.abs(found).max() < 1e-9
    free = solve(problem, PLANE.format(1e9), LINE.format(1e9), **IN_PLACE, backend=backend)
    expected = solve(problem, **IN_PLACE, backend=backend)
    np.testing.assert_allclose(free.problem.points, expected.problem.points, atol=1e-8)
    parts = solve(problem, PLANE.format(1e-9), **IN_PLACE, backend=backend).problem.points
    moved = np.cross((parts - expected.problem.points)[3:9], NORMAL)
    assert np.abs(moved).max() < np.abs(distances(problem.points)[0]).max()


FLOOR = "points 1-9: on plane 0 0 1 0.5 sigma 0.01"
CEILING = "points 10-14: on plane 0 0 -2 1 sigma 0.01"
WALLS = "points 15-17: on plane 1 0 0 0 sigma 0.01", "points 18-20: on plane 0 1 0 0 sigma 0.01"
WALL, LEVEL = "points 15-20: on plane sigma 0.01", "points 1-9: on level plane sigma 0.01"
LENGTH = bundle.ScaleBar(("image", 1), ("image", 2), 1.0, 0.01)


@pytest.mark.parametrize(
    ("rules", "more", "is_refused"),
    [
        ((FLOOR,), {}, True),
        ((FLOOR, *WALLS), {}, True),
        ((FLOOR, "points 10-14: on line 0 0 -0.5 1 1 1 sigma 0.01"), {}, True),
        ((FLOOR, "image 1: position fixed"), {}, False),
        ((FLOOR, CEILING), {}, False),
        ((FLOOR, *WALLS, CEILING), {}, False),
        ((FLOOR,), {"gauge": "two_cameras"}, False),
        ((FLOOR,), {"priors": [LENGTH], "backend": "ceres", "align": False}, False),
        ((FLOOR,), {"fixed_image_ids": (1, 2)}, False),
        ((FLOOR,), {"fixed_image_ids": (2,)}, False),
        ((FLOOR, "point 22: position prior sigma 1"), {}, False),
        ((FLOOR, "image 3: rotation prior sigma 1"), {}, True),
        ((FLOOR, "cameras *: f prior 1 %"), {}, True),
        ((WALL,), {}, True),
        ((LEVEL,), {}, True),
        ((LEVEL, FLOOR), {}, True),
        ((WALL, FLOOR, CEILING), {}, False),
        ((WALL,), {"gauge": "two_cameras"}, False),
        ((LEVEL,), {"fixed_image_ids": (2, 3)}, False),
        ((WALL, "point 22: position prior sigma 1", "point 23: position prior sigma 1"), {}, False),
        (("cameras *: f prior 1 %",), {}, False),
    ],
)
def test_a_world_that_would_shrink_is_refused(rules, more, is_refused):
    short = {**TO_THE_END, "gauge": "auto", "max_num_iterations": 2, **more}
    if is_refused:
        with pytest.raises(bundle.InputError, match="smaller world"):
            bundle.solve(mixed(), constraints=rules, **short)
        for analyse in (bundle.covariance, bundle.reliability):
            with pytest.raises(bundle.InputError, match="smaller world"):
                analyse(mixed(), constraints=rules)
    else:
        assert bundle.solve(mixed(), constraints=rules, **short).summary.is_solution_usable


def test_a_camera_holds_the_scale_by_its_distance_from_the_plane():
    problem = mixed()
    center = problem.projection_centers[0]
    known = {"priors": [bundle.PositionPrior(1, center, 0.01)], "align": False}
    for distance in (0.0, 0.5):
        rule = f"points 1-9: on plane 0 0 1 {distance - center[2]} sigma 1"
        if distance:
            assert bundle.solve(problem, constraints=[rule], **known).constraints
            continue
        with pytest.raises(bundle.InputError, match="smaller world"):
            bundle.solve(problem, constraints=[rule], **known)


@pytest.mark.parametrize(
    ("rules", "options"),
    [
        (("points 4-99: on plane 0 0 1 1 sigma 1",), {}),
        (("points 4-9: on plane 0 0 1 1 sigma 1", "point 5: on plane 0 0 2 2 sigma 3"), {}),
        (("points 4-9: on plane 1 0 3 1 sigma 1", "point 5: on plane -7 0 -21 -7 sigma 3"), {}),
        (("point 5: on line 1 2 3 4 5 6 sigma 1", "point 5: on line 5 7 9 -8 -10 -12 sigma 1"), {}),
        (("points 4-9: on plane 0 0 1 1 sigma 1", "point 5: position fixed"), {}),
        (("points 4-9: on plane 0 0 1 1 sigma 1",), {"fixed_point_ids": (9,)}),
        (("points 4-9: on plane 0 0 1 1 sigma 1",), {"refine": ("poses",)}),
        (("points 4-9: on plane sigma 1",), {"refine": ("poses",)}),
        (("points 4-9: on plane sigma 1",), {"fixed_point_ids": tuple(range(4, 10))}),
        (("points 4-9: on plane sigma 1", "points 9,4-8: on plane sigma 2"), {}),
        (("points 4,5: on plane sigma 1",), {}),
        (("points 4-6: on plane sigma 1",), {}),
        (("point 4: on level plane sigma 1",), {}),
        (("points 4-99: on plane sigma 1",), {}),
    ],
)
def test_what_a_rule_contradicts(rules, options):
    with pytest.raises(bundle.InputError, match=r"constraints\[\d\]: "):
        solve(mixed(), *rules, **options)


@pytest.mark.parametrize("is_level", [False, True])
def test_an_estimated_plane_costs_as_much_as_one_with_unknowns_of_its_own(is_level):
    problem = scenes.make_problem(num_images=3, num_points=14, shared=True)
    own = [3, 4, 5, 6, 7, 8, 12]
    word = "level plane" if is_level else "plane"
    rule = f"points 4-9,13: on {word} sigma 0.02"
    held = {"gauge": "none", "fixed_image_ids": (1, 2), "fixed_camera_ids": (1,)}
    solved = solve(problem, rule, **held)

    def residual(x):
        w, t = np.zeros((3, 3)), problem.cam_from_world[:, 4:].copy()
        w[2], t[2] = x[:3], x[3:6]
        points, (a, b, c) = x[6:-3].reshape(-1, 3), x[-3:]
        pixels = scenes.residuals(problem, w, t, problem.camera_params, points)
        # z = a x + b y + c, but turned: the best plane of these points is far from upright.
        normal = (
            np.array([0.0, 0, 1]) if is_level else frame @ [-a, -b, 1] / np.hypot(1, np.hypot(a, b))
        )
        return np.r_[pixels.ravel(), (points[own] @ normal - c) / 0.02]

    start = problem.points[own]
    frame = np.linalg.svd(start - start.mean(axis=0))[2].T
    at = [0, 0, start.mean(axis=0) @ (frame[:, 2] if not is_level else [0, 0, 1])]
    start = np.r_[np.zeros(3), problem.cam_from_world[2, 4:], problem.points.ravel(), at]
    dense = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(solved.summary.final_cost, dense.cost, rtol=1e-9)
    np.testing.assert_allclose(solved.problem.points.ravel(), dense.x[6:-3], rtol=1e-5, atol=1e-6)
    (end,) = solved.constraints
    assert end.num_parameters == 7 and {one.parameter for one in end.priors} == {word}
    assert [one.id for one in end.priors] == [row + 1 for row in own]
    pulls = residual(dense.x)[-7:]
    found = np.array([one.pull for one in end.priors])
    np.testing.assert_allclose(found * np.sign(found @ pulls), pulls, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose([one.after[0] for one in end.priors], 0.02 * found)
    assert solved.factor_costs_after == pytest.approx([(found**2).sum() / 2])
    before = np.array([one.before[0] for one in end.priors])
    normal = [0, 0, 1] if is_level else frame[:, 2]
    expected = (problem.points[own] - problem.points[own].mean(axis=0)) @ normal
    np.testing.assert_allclose(before * np.sign(before @ expected), expected, atol=1e-12)


@pytest.mark.parametrize("word", ["plane", "level plane"])
def test_derivatives_of_an_estimated_plane(word):
    problem = mixed()
    rule = bundle.constraints.On("points 3-11", word, (), 0.03)
    _, resolved = apply([rule], problem, OPTIONS, None)
    assert bundle.check_factors(problem, resolved.factors)
    # A diagonal normal: its largest components are equal, and their order must not matter.
    turned = problem.points.copy()
    turned[2:11] -= np.outer(turned[2:11] @ DIAGONAL, 0.9 * DIAGONAL)
    diagonal = problem.replace(points=turned)
    _, resolved = apply([rule], diagonal, OPTIONS, None)
    assert bundle.check_factors(diagonal, resolved.factors)
    flatness = resolved.priors[0].flatness
    if word == "plane":
        other = dataclasses.replace(flatness, normal=tuple(-np.array(flatness.normal)))
        np.testing.assert_array_equal(
            other.distances(diagonal), -np.array(flatness.distances(diagonal))
        )


def test_an_estimated_plane_moves_with_its_points_and_a_level_one_stays_level():
    problem = mixed()
    fixed = {**TO_THE_END, "gauge": "two_cameras"}
    for word in ("plane", "level plane"):
        found = solve(problem, f"points 4-12: on {word} sigma 1e-7", **fixed).problem.points[3:12]
        found = found - found.mean(axis=0)
        _, sizes, axes = np.linalg.svd(found)
        assert sizes[2] < 1e-6 < 0.01 < sizes[1]
        assert (abs(axes[2, 2]) > 1 - 1e-9) == (word == "level plane")
    free = solve(problem, "points 4-12: on plane sigma 1e7", **fixed).problem.points
    np.testing.assert_allclose(free, solve(problem, **fixed).problem.points, atol=1e-7)


def test_points_on_an_estimated_plane_share_its_certainty():
    """An exact plane is three numbers for six distances, which nothing checks."""
    held = {"fixed_image_ids": (1, 2)}
    given = {"constraints": ["points 4-9: on plane sigma 1e-6"], **held}
    problem = bundle.solve(mixed(), **given, num_threads=1).problem
    free, flat = (bundle.reliability(problem, **one) for one in (held, given))
    assert flat.dof == free.dof + 3
    assert flat.priors[0].num_residuals == 3
    assert flat.priors[0].redundancy == pytest.approx(0, abs=1e-6)
    sigmas = [
        np.sqrt(np.trace(bundle.covariance(problem, **one).point_covariance[3:9], axis1=1, axis2=2))
        for one in (held, given)
    ]
    assert (sigmas[1] < sigmas[0]).all()


def test_points_that_no_plane_can_have(monkeypatch):
    problem = mixed()
    rule = "points 4-9: on {} sigma 1"
    line = problem.points.copy()
    line[3:9] = np.outer(np.arange(6), [1, 2, 3])
    with pytest.raises(bundle.InputError, match=r"constraints\[0\]: [^\n]*line$"):
        solve(problem.replace(points=line), rule.format("plane"), **IN_PLACE)
    _, resolved = apply([rule.format("level plane")], problem.replace(points=line), OPTIONS, None)
    assert resolved.priors[0].flatness.points == (4, 5, 6, 7, 8, 9)
    monkeypatch.setattr(resolve, "MOST_ON_A_PLANE", 6)
    assert apply([rule.format("plane")], problem, OPTIONS, None)
    monkeypatch.setattr(resolve, "MOST_ON_A_PLANE", 5)
    with pytest.raises(bundle.InputError, match="4 to 5 points"):
        apply([rule.format("plane")], problem, OPTIONS, None)


def test_a_part_of_the_images_needs_all_points_of_an_estimated_plane():
    whole = mixed()
    keep = (whole.observation_image > 0) | (whole.observation_point < 20)
    problem = scenes.with_observations(whole, keep)
    local = {"num_rounds": 1, "only_images": [1], "min_angle": 0, "max_error": 1e9}
    with pytest.raises(bundle.InputError, match="refined images"):
        bundle.solve_rounds(problem, constraints=["points 1-21: on plane sigma 1"], **local)
    part = bundle.solve_rounds(problem, constraints=["points 1-20: on plane sigma 1"], **local)
    assert part.constraints[0].num_parameters == 20


def test_an_edge_lies_on_two_planes():
    problem = mixed()
    x, _, z = problem.points[3] + 0.01
    rules = [
        f"point 4: on plane {axis} {-d} sigma 1e-9" for axis, d in (("1 0 0", x), ("0 0 1", z))
    ]
    points = solve(problem, *rules, **IN_PLACE).problem.points
    np.testing.assert_allclose(points[3, [0, 2]], [x, z], atol=1e-8)


@pytest.mark.parametrize(
    ("rule", "others"),
    [
        (PLANE.format(0.1), (PLANE.format(0.2), PLANE.replace("1 2 2", "1 2 3").format(0.1))),
        (
            "points 4-9: on plane sigma 0.1",
            ("points 4-9: on plane sigma 0.2", "points 4-9: on level plane sigma 0.1"),
        ),
    ],
)
def test_a_run_with_another_plane_does_not_resume(tmp_path, rule, others):
    problem, path = mixed(), tmp_path / "run"
    run = {"num_rounds": 2, "max_error": 5, "min_angle": 0, **IN_PLACE}
    done = bundle.solve_rounds(problem, constraints=[rule], checkpoint=path, hold_out=5, **run)
    assert np.isin(range(4, 10), done.problem.point_ids).all() and done.held_out is not None
    again = bundle.solve_rounds(problem, constraints=[rule], resume=path, **run)
    np.testing.assert_array_equal(again.problem.points, done.problem.points)
    assert again.constraints == done.constraints
    for other in others:
        with pytest.raises(bundle.InputError):
            bundle.solve_rounds(problem, constraints=[other], resume=path, **run)


def test_a_part_of_the_images_leaves_other_points_alone():
    problem = mixed()
    seen = problem.observation_point[problem.observation_image == 0]
    part = bundle.solve_rounds(
        problem, num_rounds=1, only_images=[1], constraints=[FLOOR], min_angle=0, max_error=1e9
    )
    (rule,) = part.constraints
    assert {one.id for one in rule.priors} <= set(problem.point_ids[seen].tolist())


@pytest.mark.parametrize("rule", [FLOOR, LEVEL, "points 1-9: on plane sigma 0.01"])
def test_the_report_of_a_command(tmp_path, capsys, rule):
    from bundle.cli.main import main

    bundle.save(mixed(), tmp_path / "model")
    output = tmp_path / "out"
    words = ["refine", str(tmp_path / "model"), "-o", str(output), "--set", rule]
    assert main([*words, "--quiet"]) == 2
    assert capsys.readouterr().err.startswith("error: --set: ") and not output.exists()
    held = ["--fix-images", "1,2", "--json", str(tmp_path / "report.json")]
    assert main([*words, *held, "--html", str(tmp_path / "page.html")]) == 0
    (end,) = json.loads((tmp_path / "report.json").read_text())["constraints"]
    assert end["kind"] == "on" and end["num_parameters"] == len(end["priors"]) == 9
    for one in end["priors"]:
        assert one["pull"] == pytest.approx(one["after"][0] / 0.01)
