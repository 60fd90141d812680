"""Projections against one dense least-squares fit with all columns, and fields of known size."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.judging.findings import systematic
from bundle.judging.findings.images import between_images, image_fits
from bundle.judging.findings.measured import Measured, median_by_group
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.systematic import SystematicResiduals
from bundle.model.residuals import linearize


def measured(problem):
    return Measured(whole=problem, command=NextCommand())


@pytest.fixture(scope="module", params=["shared", "individual"])
def problem(request):
    scene = bundle.synthesize(
        scene="orbit", num_images=6, num_points=300, cameras=request.param, seed=5
    )
    return bundle.solve(scene.problem).problem


def dense_columns(problem, found):
    """Derivatives by all poses, and by focal lengths and distortion of all cameras."""
    rows = found.observations
    full = linearize(problem)
    image, camera = problem.observation_image[rows], found.camera
    pose = np.zeros((len(rows), 2, problem.num_images, 6))
    pose[np.arange(len(rows)), :, image] = full.d_pose[rows]
    used = [0, 3]  # f and k of SIMPLE_RADIAL
    lens = np.zeros((len(rows), 2, problem.num_cameras, 2))
    lens[np.arange(len(rows)), :, camera] = full.d_params[rows][:, :, used]
    return np.concatenate([pose.reshape(len(rows), 2, -1), lens.reshape(len(rows), 2, -1)], axis=2)


def test_coefficients_are_those_of_a_joint_fit(problem):
    found = SystematicResiduals(measured(problem))
    base = dense_columns(problem, found)
    rows = 2 * len(found.observations)
    extra = found.lens_columns[:, :, 1:]  # r2 belongs to the model
    joint = np.concatenate([extra, base], axis=2).reshape(rows, -1)
    scale = np.linalg.norm(joint, axis=0)
    target = found._residuals.reshape(rows)
    expected = (np.linalg.lstsq(joint / scale, target, rcond=1e-13)[0] / scale)[:5]
    fields = found.lens_fields[:, :, 1:].reshape(rows, -1)
    size = np.linalg.norm(fields, axis=0)
    usable = size > 1e-3 * np.linalg.norm(extra.reshape(rows, -1), axis=0)
    fitted = np.linalg.lstsq(fields / size, found.residuals.reshape(rows), rcond=1e-13)[0] / size
    np.testing.assert_allclose(fitted[usable], expected[usable], rtol=1e-3)


def test_fields_of_one_image_are_those_of_a_joint_fit(problem):
    found = SystematicResiduals(measured(problem))
    base = dense_columns(problem, found).reshape(2 * len(found.observations), -1)
    for one, normal in zip(found.images[:2], found.image_normals, strict=False):
        inside = np.zeros((len(found.observations), 2, 3))
        x, y = found.xy[one.rows].T
        inside[one.rows] = np.stack(
            [np.stack(pair, axis=1) for pair in ((x, y), (x, -y), (y, x))], axis=2
        )
        flat = inside.reshape(len(base), 3)
        scale = np.linalg.norm(base, axis=0)
        scale[scale == 0] = 1
        left = flat - base / scale @ np.linalg.lstsq(base / scale, flat, rcond=1e-12)[0]
        np.testing.assert_allclose(normal, left.T @ left, atol=1e-6 * np.trace(flat.T @ flat))
        assert found.image_fields[one.rows].shape == (len(x), 2, 3)


def test_linear_fields_are_fitted_image_by_image():
    """The oracle is a fit of each image by itself, with the fields that are left of it."""
    rng = np.random.default_rng(2)
    counts = np.array([40, 0, 31, 57, 0])
    rows, image = counts.sum(), np.repeat(np.arange(5), counts)
    xy, fields = rng.normal(size=(rows, 2)), rng.normal(size=(rows, 2, 3))
    # Less than a hundredth is left in the third image, more in the fourth; intrinsics took some.
    for k, column, left in ((2, 1, 0.0099), (3, 0, 0.0101)):
        own = fields[image == k, :, column]
        own *= left * np.sqrt((xy[image == k] ** 2).sum() / (0.9 * (own**2).sum()))
        fields[image == k, :, column] = own
    residual = rng.normal(size=(rows, 2)) * (1 + np.abs(xy[:, :1]))
    found = SimpleNamespace(
        num_rows=counts,
        image_of_row=image,
        xy=xy,
        image_fields=fields,
        residuals_without_lens=residual,
    )
    found.sums = partial(SystematicResiduals.sums, found)
    normals = [np.einsum("nka,nkb->ab", fields[image == k], fields[image == k]) for k in range(5)]
    found.image_normals = np.stack(normals) * 0.9  # intrinsics took some
    fields[image == 2, 0, 1] = np.inf  # after an overflow
    fits = image_fits(found, scale=2.0)
    for k, normal in enumerate(found.image_normals):
        own, target = fields[image == k], residual[image == k]
        left = np.array({0: [0, 1, 2], 2: [0, 2], 3: [0, 1, 2]}.get(k, []), int)
        absent = np.setdiff1d(range(3), left)
        assert np.isinf(fits.variances[k, absent]).all() and not fits.coefficients[k, absent].any()
        if not counts[k]:
            assert fits.chi2[k] == fits.sizes[k] == fits.medians[k] == 0
            continue
        inverse = np.linalg.inv(normal[np.ix_(left, left)])
        fitted = inverse @ np.einsum("nka,nk->a", own[:, :, left], target)
        field = own[:, :, left] @ fitted
        scores = np.einsum("nka,nk->na", own[:, :, left], target - field)
        covariance = inverse @ (scores.T @ scores) @ inverse * counts[k] / (counts[k] - 6)
        np.testing.assert_allclose(fits.coefficients[k, left], fitted)
        np.testing.assert_allclose(fits.variances[k, left], np.diag(covariance))
        np.testing.assert_allclose(fits.chi2[k], fitted @ np.linalg.solve(covariance, fitted))
        np.testing.assert_allclose(fits.sizes[k], np.sqrt((field**2).mean()) / 2)
        errors = np.sort(np.linalg.norm(target - field, axis=1))
        assert fits.medians[k] == pytest.approx(errors[(counts[k] - 1) // 2])


def test_random_effects_are_recovered():
    rng = np.random.default_rng(1)
    variances = rng.uniform(0.5, 2, 400)
    ratio, tau, excess = between_images(rng.normal(3, np.sqrt(variances)), variances)
    assert ratio == pytest.approx(1, abs=0.2) and tau < 0.4 and excess < 0
    spread = rng.normal(3, np.sqrt(variances + 9))
    ratio, tau, excess = between_images(spread, variances)
    assert ratio > 5 and excess > 0
    assert tau == pytest.approx(3, rel=0.1)
    assert between_images(spread[:5], variances[:5])[0] == 0
    assert between_images(spread, np.full(400, np.inf))[1] == 0


def test_medians_by_group_are_those_of_each_group():
    rng = np.random.default_rng(2)
    values, group = rng.normal(size=501), rng.integers(0, 7, 501)
    medians, numbers = median_by_group(values, group, 9)
    for one in range(7):
        inside = np.sort(values[group == one])
        assert medians[one] == inside[(len(inside) - 1) // 2]
        assert numbers[one] == len(inside)
    assert np.isnan(medians[7:]).all() and not numbers[7:].any()


def test_places_are_from_the_principal_point_in_halves_of_the_longer_side():
    scene = bundle.synthesize(scene="orbit", num_images=3, num_points=60, seed=2).problem
    params = scene.camera_params.copy()
    params[:, 1:3] += [170.0, -90.0]  # of SIMPLE_RADIAL
    problem = scene.replace(camera_params=params)
    xy, camera = problem.observation_xy, problem.image_camera[problem.observation_image]
    found = systematic._lens_coordinates(problem, camera, xy)
    half = problem.camera_sizes[camera].max(axis=1, keepdims=True) / 2
    np.testing.assert_allclose(found, (xy - params[camera, 1:3]) / half)
    unknown = systematic._lens_coordinates(
        problem.replace(camera_sizes=0 * problem.camera_sizes), camera, xy
    )
    assert np.abs(unknown).max() == pytest.approx(1)
    np.testing.assert_allclose(unknown * np.abs(xy - params[camera, 1:3]).max(), found * half)


def test_a_base_of_any_size_is_removed_with_what_depends_on_it():
    rng = np.random.default_rng(3)
    first, second, rest = np.linalg.qr(rng.normal(size=(40, 3)))[0].T.reshape(3, 20, 2)
    base = np.stack([1e-9 * first, 0 * first, 1e9 * (first + second)], axis=2)
    left = systematic.remove(np.stack([first, second, rest], axis=2), base)
    np.testing.assert_allclose(left[:, :, :2], 0, atol=1e-9)
    np.testing.assert_allclose(left[:, :, 2], rest, atol=1e-9)
    for away, rank in ((0.9e-7, 1), (3e-7, 2)):  # of parallel columns, half remains
        columns = np.stack([first, first + away * second], axis=2)
        assert systematic.orthonormal(columns).shape == (20, 2, rank)
    assert systematic.orthonormal(0 * base).shape == (20, 2, 0)
