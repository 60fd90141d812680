"""The weighted similarity against closed forms of others and general solvers."""

import numpy as np
import pycolmap
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bundle import InputError
from bundle.georeference.similarity import Similarity, umeyama
from bundle.georeference.similarity_fit import Correspondences, fit_similarity

TURN = Rotation.from_euler("zyx", [130, 12, -25], degrees=True)


def spd(rng, count, size=1.0):
    root = rng.normal(size=(count, 3, 3))
    return size**2 * (root @ np.swapaxes(root, 1, 2) + 0.2 * np.eye(3))


def cloud(rng, count, noise, *, flat=False):
    source = rng.uniform(-4, 4, (count, 3))
    if flat:
        source[:, 2] = 0
    target = 2.5 * TURN.apply(source) + [10, -20, 3]
    if flat:
        target = TURN.inv().apply(target)  # a level field
    return source, target + noise * rng.normal(size=target.shape)


def transform(x, source, offset):
    rotation = Rotation.from_rotvec(x[1:4])
    return np.exp(x[0]) * rotation.apply(source) + rotation.apply(offset) + x[4:]


def as_vector(similarity):
    turn = Rotation.from_matrix(similarity.rotation).as_rotvec()
    return np.concatenate([[np.log(similarity.scale)], turn, similarity.translation])


def minimum(points, covariances, start, loss="linear"):
    """The minimum for covariances that stay, by SciPy."""
    roots = np.linalg.inv(np.linalg.cholesky(covariances))
    known = ~np.isnan(points.target[:, 2])

    def residuals(x):
        residual = np.nan_to_num(transform(x, points.source, points.offset) - points.target)
        white = np.einsum("nij,nj->ni", roots, residual)
        white[~known, 2] = 0
        return white.ravel()

    return least_squares(residuals, start, loss=loss, xtol=1e-15, ftol=1e-15, gtol=1e-15)


def test_equal_weights_give_pycolmaps_closed_form():
    rng = np.random.default_rng(1)
    source, target = cloud(rng, 7, 0.3)
    points = Correspondences(source, target, np.tile(9 * np.eye(3), (7, 1, 1)))
    theirs = pycolmap.estimate_sim3d(source, target)
    for ours in (umeyama(source, target), fit_similarity(points).similarity):
        assert ours.scale == pytest.approx(theirs.scale, rel=1e-12)
        np.testing.assert_allclose(ours.rotation, theirs.rotation.matrix(), atol=1e-12)
        np.testing.assert_allclose(ours.translation, theirs.translation, atol=1e-11)


@pytest.mark.parametrize("flat", [False, True])
def test_full_covariances_give_scipys_minimum(flat):
    rng = np.random.default_rng(2)
    source, target = cloud(rng, 6, 0.5, flat=flat)
    points = Correspondences(
        source,
        target,
        spd(rng, 6),
        source_covariance=spd(rng, 6, 0.2),
        offset=rng.normal(size=(6, 3)),
    )
    fit = fit_similarity(points)
    r = fit.similarity.rotation
    total = points.target_covariance + fit.similarity.scale**2 * r @ points.source_covariance @ r.T
    found = minimum(points, total, as_vector(fit.similarity))
    np.testing.assert_allclose(as_vector(fit.similarity), found.x, atol=1e-7)
    assert np.sum(fit.whitened**2) == pytest.approx(2 * found.cost, rel=1e-12)
    # Residuals and parameters share the degrees of freedom.
    assert fit.redundancy.sum() == pytest.approx(3 * 6 - 7, abs=1e-9)


def test_points_in_a_plane_have_one_rotation_where_pycolmap_gives_up():
    rng = np.random.default_rng(3)
    source, target = cloud(rng, 5, 0.0, flat=True)
    assert pycolmap.estimate_sim3d(source, target) is None
    points = Correspondences(source, target, np.tile(np.eye(3), (5, 1, 1)))
    similarity = fit_similarity(points).similarity
    np.testing.assert_allclose(similarity.apply(source), target, atol=1e-12)
    assert np.linalg.det(similarity.rotation) == pytest.approx(1)
    assert similarity.scale == pytest.approx(2.5)


def test_unknown_heights_count_in_east_and_north():
    rng = np.random.default_rng(4)
    source, target = cloud(rng, 8, 0.2)
    target[[1, 4, 6, 7], 2] = np.nan
    points = Correspondences(source, target, spd(rng, 8, 0.3))
    fit = fit_similarity(points)
    found = minimum(points, points.target_covariance, as_vector(fit.similarity))
    np.testing.assert_allclose(as_vector(fit.similarity), found.x, atol=1e-7)
    assert fit.redundancy.sum() == pytest.approx(3 * 8 - 4 - 7, abs=1e-9)
    # A target without a height, moved up, moves nothing; moved east, it does.
    exact = cloud(np.random.default_rng(4), 8, 0.0)[1]
    assert np.isnan(fit.predict(points)[0][1, 2])
    assert np.abs(fit.similarity.apply(source) - exact).max() < 1.0


def test_a_loss_gives_scipys_minimum_and_takes_the_outlier_away():
    rng = np.random.default_rng(5)
    source, target = cloud(rng, 9, 0.05)
    target[3] += [30, 0, 0]
    points = Correspondences(source, target, np.tile(0.0025 * np.eye(3), (9, 1, 1)))
    plain, robust = fit_similarity(points), fit_similarity(points, loss="cauchy", loss_scale=2.0)
    clean = fit_similarity(points.rows(np.arange(9) != 3))
    wrong = np.linalg.norm(plain.similarity.translation - clean.similarity.translation)
    right = np.linalg.norm(robust.similarity.translation - clean.similarity.translation)
    assert wrong > 1 and right < 0.05
    assert robust.weight[3] < 1e-3 < 0.2 < np.delete(robust.weight, 3).min()

    def cost(x):  # of whole points, which SciPy's losses do not know
        squared = ((transform(x, source, points.offset) - target) ** 2).sum(1) / 0.0025
        return (2 * np.log1p(squared / 4)).sum()

    at, best = as_vector(robust.similarity), cost(as_vector(robust.similarity))
    for step in 1e-3 * np.vstack([np.eye(7), -np.eye(7)]):
        assert cost(at + step) > best


def test_the_covariance_is_that_of_repeated_surveys():
    rng = np.random.default_rng(6)
    source, target = cloud(rng, 6, 0.0)
    covariances, in_model = spd(rng, 6, 0.05), spd(rng, 6, 0.02)
    exact = fit_similarity(Correspondences(source, target, covariances, in_model))
    truth = exact.similarity
    roots = np.linalg.cholesky([covariances, in_model])
    samples = []
    for _ in range(500):
        noise, blur = np.einsum("knij,knj->kni", roots, rng.normal(size=(2, 6, 3)))
        noisy, seen = target + noise, source + blur
        found = fit_similarity(Correspondences(seen, noisy, covariances, in_model)).similarity
        turn = Rotation.from_matrix(found.rotation @ truth.rotation.T).as_rotvec()
        shift = found.apply(exact.center[None])[0] - truth.apply(exact.center[None])[0]
        samples.append([np.log(found.scale / truth.scale), *turn, *shift])
    spread = np.cov(np.transpose(samples))
    sigma = np.sqrt(np.diag(exact.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), sigma, rtol=0.12)
    correlation = (spread - exact.covariance) / np.outer(sigma, sigma)
    assert np.abs(correlation).max() < 0.2


def test_what_does_not_determine_a_similarity_is_refused():
    rng = np.random.default_rng(7)
    source, target = cloud(rng, 6, 0.0)
    line = np.outer(np.linspace(-3, 5, 6), [1, 2, -1.0])

    def fit(source, target, sigma=0.1):
        unit = np.tile(sigma**2 * np.eye(3), (len(source), 1, 1))
        return fit_similarity(Correspondences(source, target, unit), what="targets")

    with pytest.raises(InputError, match=r"at least 3 targets.*found 2"):
        fit(source[:2], target[:2])
    for a, b in ((line, line * 3), (source, line), (line, target), (0 * source, target)):
        with pytest.raises(InputError, match="one line"):
            fit(a, b)
    # Nearly on a line: refused where the noise is as large as the distance from it.
    beside = line + 0.02 * rng.normal(size=line.shape)
    np.testing.assert_allclose(fit(beside, beside).similarity.apply(beside), beside, atol=1e-9)
    with pytest.raises(InputError, match="degrees"):
        fit(beside, line + 0.05 * rng.normal(size=line.shape), sigma=0.05)
    unknown = target.copy()
    unknown[:, 2] = np.nan
    with pytest.raises(InputError, match="height"):
        fit(source, unknown)
    unknown[0, 2] = 1.0  # a level field with one height may tilt
    level = np.column_stack([source[:, :2], np.zeros(6)])
    with pytest.raises(InputError, match="tilt"):
        fit(level, np.column_stack([level[:, :2], unknown[:, 2]]))


def on_a_line(rng, count, source_width, target_width, *, same=False):
    along = np.linspace(-50, 50, count)
    across = rng.normal(size=(count, 2))
    other = across if same else rng.normal(size=(count, 2))
    source = np.column_stack([along, source_width * across])
    target = np.column_stack([along, target_width * other])
    return 0.2 * TURN.apply(source), target


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [1, 2, 0.3], [0, 0, 1]])
def test_a_wide_model_over_a_line_is_refused(axis):
    # It stands on its edge beside the line, where heights have the larger sigma.
    grid = 20.0 * (np.indices((4, 4)).reshape(2, -1).T - 1.5)
    source = 0.1 * TURN.apply(np.column_stack([grid, np.zeros(16)]))
    along = grid @ [1, 0.2]
    target = along[:, None] * np.array(axis) / np.linalg.norm(axis)
    target += 1e-4 * np.random.default_rng(0).normal(size=target.shape)
    covariance = np.tile(np.diag([4.0, 4, 25]), (16, 1, 1))
    with pytest.raises(InputError, match="one line"):
        fit_similarity(Correspondences(source, target, covariance))


def test_lines_whose_widths_are_noise_are_refused():
    rng = np.random.default_rng(1)
    source, target = on_a_line(rng, 100, 0.05, 0.05)
    covariance = np.tile(0.05**2 * np.eye(3), (100, 1, 1))
    with pytest.raises(InputError, match=r"only to .* one line"):
        fit_similarity(Correspondences(source, target, covariance))
    source, target = on_a_line(rng, 100, 0.5, 0.5, same=True)
    fit_similarity(Correspondences(source, target + 0.05 * rng.normal(size=(100, 3)), covariance))


def test_widths_far_below_the_sigmas_are_refused_however_well_they_fit():
    rng = np.random.default_rng(2)
    covariance = np.tile(np.diag([4.0, 4, 25]), (18, 1, 1))
    source, target = on_a_line(rng, 18, 1e-3, 1e-3, same=True)
    with pytest.raises(InputError, match=r"only to .* one line"):
        fit_similarity(Correspondences(source, target, covariance))
    # Residuals of two centimetres tell that the sigmas of a strip are too large.
    source, target = on_a_line(rng, 18, 1.5, 1.5, same=True)
    noisy = target + 0.02 * rng.normal(size=(18, 3))
    fit = fit_similarity(Correspondences(source, noisy, covariance))
    assert fit.similarity.scale == pytest.approx(5, rel=1e-3)


def test_one_similarity_after_another():
    rng = np.random.default_rng(8)
    points = rng.normal(size=(5, 3))
    turns = Rotation.random(2, random_state=1).as_matrix()
    first = Similarity(3.0, turns[0], rng.normal(size=3))
    second = Similarity(0.2, turns[1], rng.normal(size=3))
    both = second.after(first)
    np.testing.assert_allclose(both.apply(points), second.apply(first.apply(points)), rtol=1e-12)
    assert both.scale == pytest.approx(0.6)
