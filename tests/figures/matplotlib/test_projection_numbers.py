"""Projection uncertainty against mrcal's own formula on dense Jacobians, and against resampling."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle import pictures
from bundle.figures.projection_uncertainty import contour_levels, projection_uncertainty
from bundle.reports.page.svg_planes import contour
from tests.analysis.uncertainty.dense import Dense
from tests.scenes import make_problem, project


def middles(known):
    rows, columns = known.count.shape
    left, top, right, bottom = known.box
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    y = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
    return np.array([[(a, b) for a in x] for b in y])


def ray(model, params, xy):
    """The ray of a pixel, by a solver of its own."""
    start = (xy - params[1:3]) / params[0]
    found = least_squares(
        lambda u: (project(model, params, [[*u, 1.0]])[0] - xy) / params[0],
        start, xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    direction = np.array([*found.x, 1.0])
    return direction / np.linalg.norm(direction)


def in_camera(problem):
    """Observed points in the frames of their images."""
    poses = problem.cam_from_world[problem.observation_image]
    points = problem.points[problem.observation_point]
    return Rotation.from_quat(poses[:, :4]).apply(points) + poses[:, 4:]


def derivatives(model, params, point):
    """Derivatives of a pixel by (w, s) of the point and by the parameters, by complex steps."""
    step = 1e-30
    columns = []
    for k in range(6):
        moved = point.astype(complex)
        moved[k % 3 if k >= 3 else slice(None)] += (
            1j * step if k >= 3 else 1j * step * np.cross(np.eye(3)[k], point)
        )
        columns.append(project(model, params, [moved])[0].imag / step)
    for k in range(len(params)):
        changed = params.astype(complex)
        changed[k] += 1j * step
        columns.append(project(model, changed, [point])[0].imag / step)
    return np.array(columns).T


def cross_reprojection(problem, camera, free, pixels, distances, loss):
    """Var(q+) by mrcal's own words, as a linear map of the noise of the measurements.

    rt_rr+ = -(Jc^T Jc)^-1 Jc^T J_frames,points db and q+ = project(intrinsics+, T_r+r p), with
    db = -J^+ e; images take the part of the frames, points that of the board.
    """
    dense = Dense(problem, loss=loss, loss_scale=0.8)
    names = dense.names
    columns = [j for j, name in enumerate(names)
               if name[0] != "camera" or (name[1], name[2]) in free]  # fmt: skip
    change = np.zeros((len(names), dense.jacobian.shape[0]))
    change[columns] = -np.linalg.pinv(dense.jacobian[:, columns], rcond=1e-11)
    others = [j for j, name in enumerate(names) if name[0] != "camera"]
    images = np.flatnonzero(problem.image_camera == camera)
    mine = np.repeat(np.isin(problem.observation_image, images), 2)
    # The common motion of all frames of the camera: columns of J of its poses, added up. A pose
    # turns about the origin of its points, R to Exp(w) R, the housing about that of the camera.
    common = np.zeros((mine.sum(), 6))
    for i in images:
        pose = dense.jacobian[np.ix_(mine, [names.index(("image", i, k)) for k in range(6)])]
        common += pose
        common[:, :3] += pose[:, 3:] @ np.cross(np.eye(3), problem.cam_from_world[i, 4:]).T
    aligned = -np.linalg.pinv(common) @ dense.jacobian[np.ix_(mine, others)] @ change[others]
    model, params = problem.camera_models[camera], problem.camera_params[camera]
    parameters = change[[names.index(("camera", camera, k)) for k in range(len(params))]]
    result = []
    for xy, distance in zip(pixels, distances, strict=True):
        point = distance * ray(model, params, xy)
        by = derivatives(model, params, point)
        result.append(by[:, :6] @ -aligned + by[:, 6:] @ parameters)
    return [part @ part.T for part in result]


@pytest.mark.parametrize("loss", ["trivial", "huber"])
def test_it_is_mrcals_cross_reprojection_uncertainty(loss):
    problem = make_problem(num_images=4, num_points=12, shared=True, seed=3, noise=1.0)
    image_camera = np.array([0, 0, 1, 0])
    params = np.repeat(problem.camera_params, 2, axis=0)
    problem = problem.replace(
        image_camera=image_camera, camera_ids=[5, 9], camera_models=problem.camera_models * 2,
        camera_params=params, camera_sizes=np.repeat(problem.camera_sizes, 2, axis=0),
        observation_sigma=np.linspace(0.5, 2, problem.num_observations),
    )  # fmt: skip
    options = {"loss": "huber", "loss_scale": 0.8} if loss == "huber" else {}
    solved = bundle.solve(problem, max_num_iterations=50, function_tolerance=1e-14, **options)
    problem = solved.problem
    cov = bundle.covariance(solved)
    known = projection_uncertainty(problem, 0, cov.camera(5), **options)
    cells = [(0, 0), (9, 12), (3, 20), (18, 24)]
    at = [1e9, 4.0, known.distance, 0.7]
    places = middles(known)
    assert known.count.shape == (19, 25)
    free = {(camera, k) for camera in (0, 1) for k in (0, 3)}
    expected = cross_reprojection(problem, 0, free, [places[c] for c in cells], at, loss)
    for cell, distance, variance in zip(cells, at, expected, strict=True):
        worst = np.sqrt(np.linalg.eigvalsh(variance)[-1])
        assert known.sigma(distance)[cell] == pytest.approx(worst, rel=1e-5)
    assert known.sigma()[0, 0] == pytest.approx(known.sigma(1e9)[0, 0], rel=1e-6)
    assert known.distance == pytest.approx(
        np.median(np.linalg.norm(in_camera(problem)[image_camera[problem.observation_image] == 0],
                                 axis=1))
    )  # fmt: skip
    twice = projection_uncertainty(problem, 0, 4 * cov.camera(5), sigma=2.0, **options)
    np.testing.assert_allclose(twice.sigma(3.0), 2 * known.sigma(3.0), rtol=1e-9)


def test_pixels_of_solves_with_other_noise_are_as_far_off_as_it_says():
    noise = 0.05
    problem = make_problem(
        num_images=4, num_points=20, shared=True, noise=0.0, perturbation=0.0, model="PINHOLE"
    )
    options = {"refine": ("poses", "points", "focal", "principal_point")}
    truth = bundle.solve(problem, **options).problem
    cov = bundle.covariance(truth, **options).camera(1)
    known = projection_uncertainty(truth, 0, noise**2 * cov, sigma=noise)
    points, params = in_camera(truth), truth.camera_params[0]
    cells = [(0, 0), (9, 12), (18, 3)]
    targets = [4.0 * ray("PINHOLE", params, middles(known)[cell]) for cell in cells]
    rng = np.random.default_rng(1)
    moved = []
    for _ in range(40):
        xy = problem.observation_xy + noise * rng.standard_normal((problem.num_observations, 2))
        made = bundle.solve(truth.replace(observation_xy=xy), **options).problem.camera_params[0]

        def misfit(h, made=made, xy=xy):
            there = Rotation.from_rotvec(h[:3]).apply(points) + h[3:]
            return (project("PINHOLE", made, there) - xy).ravel()

        h = least_squares(misfit, np.zeros(6), x_scale="jac").x
        seen = Rotation.from_rotvec(h[:3]).apply(targets) + h[3:]
        moved.append(project("PINHOLE", made, seen) - project("PINHOLE", params, targets))
    spread = np.einsum("nci,ncj->cij", moved, moved) / len(moved)
    for cell, variance in zip(cells, spread, strict=True):
        ratio = np.linalg.eigvalsh(variance)[-1] / known.sigma(4.0)[cell] ** 2
        assert 0.5 < ratio < 1.8  # 40 draws: 99.9 % lie within


def test_what_is_held_or_unseen_has_none():
    problem = make_problem(num_images=3, num_points=20, shared=True)
    held = np.full((4, 4), np.nan)
    free = np.diag([4.0, np.nan, np.nan, 1e-6])
    assert projection_uncertainty(problem, 0, held) is None
    assert projection_uncertainty(problem, 0, free) is not None
    two = problem.observation_point == 0
    two &= problem.observation_image < 2  # the housing may turn about a line
    few = problem.replace(**{
        f"observation_{name}": getattr(problem, f"observation_{name}")[two]
        for name in ("image", "point", "xy", "keypoint")
    })  # fmt: skip
    assert projection_uncertainty(few, 0, free) is None
    panorama = make_problem(num_images=2, num_points=9, model="EQUIRECTANGULAR", shared=True)
    assert projection_uncertainty(panorama, 0, np.diag([1.0, 1.0])) is None


def test_contours_are_where_the_function_has_the_level():
    y, x = np.mgrid[0:9, 0:12] + 0.5
    segments = contour(3.0 * x + 2.0 * y, 20.0)
    np.testing.assert_allclose(segments @ [3.0, 2.0], 20.0)
    lengths = np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1)
    # From (11/3 at y = 8.5 ... 19/3 at y = 0.5).
    assert lengths.sum() == pytest.approx(np.hypot(8.0, 8.0 * 2 / 3))
    holed = (x - 6) ** 2 + (y - 4.5) ** 2
    ring = contour(holed, 9.0)
    assert np.linalg.norm(ring[:, 0] - ring[:, 1], axis=1).sum() == pytest.approx(
        6 * np.pi, rel=0.03
    )
    holed[4, 3] = np.nan
    cut = contour(holed, 9.0)
    assert 0 < len(cut) < len(ring)
    assert len(contour(holed, 1e9)) == 0


@pytest.mark.parametrize("values", [[[0, 2], [2, 0]], [[2, 0], [0, 2]]])
@pytest.mark.parametrize("level", [0.9, 1.1])
def test_saddles_join_what_their_mean_joins(values, level):
    corners = np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]])
    flat = np.array(values, float).ravel()
    for a, b in contour(np.array(values, float), level):
        cut_off = corners[np.argmin(np.linalg.norm(corners - (a + b) / 2, axis=1))]
        value = flat[np.flatnonzero((corners == cut_off).all(axis=1))[0]]
        assert (value > level) == (level > 1.0)  # the mean is 1: the others are joined


def test_levels_are_round_and_inside():
    assert contour_levels(np.array([[1.02, 1.9]])) == [1.2, 1.4, 1.6, 1.8]
    assert contour_levels(np.array([[0.03, 0.9, np.nan]])) == [0.05, 0.1, 0.2, 0.5]
    assert contour_levels(np.array([[1.0, 1.0]])) == []
    assert contour_levels(np.array([[np.nan]])) == []


def test_axes_show_the_numbers():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    problem = make_problem(num_images=4, num_points=60, shared=True)
    known = projection_uncertainty(problem, 0, np.diag([4.0, np.nan, np.nan, 1e-6]))
    made, axes = pictures.figure(1, 2)
    pictures.draw_projection_uncertainty(axes[0, 0], known, 3.0)
    pictures.draw_uncertainty_against_distance(axes[0, 1], known)
    made.canvas.draw()
    np.testing.assert_allclose(axes[0, 0].images[0].get_array(), known.sigma(3.0))
    for line, values in zip(axes[0, 1].lines, known.by_distance().values(), strict=False):
        np.testing.assert_allclose(line.get_xydata(), np.column_stack([known.distances, values]))
    with pytest.raises(bundle.InputError, match="distance"):
        pictures.draw_projection_uncertainty(axes[0, 0], known, -1.0)
    empty = dataclasses.replace(known, terms=np.ones_like(known.terms))
    pictures.draw_projection_uncertainty(axes[0, 0], empty)  # no contour in what is flat
