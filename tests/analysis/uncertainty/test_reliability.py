"""Redundancies against dense linear algebra, reference numbers, planted errors and each other.

The oracle is R = I - J J^+ of the whitened rows by singular values, rows by complex steps.
"""

import pickle

import numpy as np
import pytest

import bundle
from bundle.analysis.uncertainty.reliability_result import WEAK
from bundle.interface.analysis_options import NOT_CHECKABLE
from tests import rolling
from tests.analysis.uncertainty.dense import Dense, SingularError
from tests.analysis.uncertainty.random_problems import Case, random_case
from tests.georeference.flights import flight
from tests.scenes import make_problem, with_observations

TIGHT = {"function_tolerance": 1e-15, "gradient_tolerance": 0, "parameter_tolerance": 0}


def residual_maker(rows):
    """R = I - J J^+, for a J of comparable columns."""
    scale = np.sqrt((rows**2).sum(axis=0))
    rows = rows[:, scale > 0] / scale[scale > 0]
    vectors, values, _ = np.linalg.svd(rows, full_matrices=False)
    vectors = vectors[:, values > 1e-9 * values[0]]
    return np.eye(len(rows)) - vectors @ vectors.T


def diagonal_blocks(matrix, size=2):
    count = len(matrix) // size
    whole = matrix[: size * count, : size * count].reshape(count, size, count, size)
    return whole[np.arange(count), :, np.arange(count)]


def check_rows(found, blocks, residual=None, **near):
    """The arrays of a result against the 2 x 2 blocks of R."""
    near = near or {"rtol": 1e-9, "atol": 1e-11}
    np.testing.assert_allclose(found.redundancy, np.diagonal(blocks, axis1=1, axis2=2), **near)
    values, vectors = np.linalg.eigh(blocks)
    np.testing.assert_allclose(found.least_redundancy, values[:, 0], **near)
    is_clear = values[:, 1] - values[:, 0] > 1e-3
    along = (found.weakest_direction * vectors[:, :, 0]).sum(axis=1)
    np.testing.assert_allclose(np.abs(along)[is_clear], 1, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found.weakest_direction, axis=1), 1, rtol=1e-12)
    is_checked = values[:, 0] >= NOT_CHECKABLE
    np.testing.assert_array_equal(np.isfinite(found.minimal_detectable_error), is_checked)
    np.testing.assert_array_equal(np.isfinite(found.external_bound), is_checked)
    assert found.num_uncontrolled == (~is_checked).sum()
    bound = found.delta0 * np.sqrt((1 - values[:, 0]) / np.maximum(values[:, 0], 1e-300))
    np.testing.assert_allclose(found.external_bound[is_checked], bound[is_checked], rtol=1e-8)
    if residual is None:
        return
    own = np.diagonal(blocks, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        w = np.where(own >= NOT_CHECKABLE, residual / np.sqrt(own), np.nan)
    np.testing.assert_allclose(found.standardized, w, rtol=1e-8, atol=1e-10)


# The two models of the reference: a scene of eight images, and a part of crane_mast, by another
# program: redundancies (least, median, largest; first five), detectable errors of components,
# largest standardised residual and its row, observations of points with two rays
# and the largest redundancy of their components, least l of the others, classes of components, the
# redundancy of an image and its place.
REFERENCE = {
    "street": {
        "dof": 367,
        "range": (0.001759617951, 0.6929738391, 0.8859042374),
        "first": (0.4849541977, 0.4014244748, 0.3140450389, 0.7045384519, 0.02768005733),
        "sigma0": 0.4854433394,
        "errors": (4.387899401, 4.961256743, 98.45569898),
        "largest": (1.708266097, 73),
        "two_view": (18, 0.5285631307),
        "least_of_others": 0.01478139933,
        "classes": (4, 19, 45, 522),
        "image": (-1, 0.4127),
    },
    "crane": {
        "dof": 124,
        "range": (5.4676e-07, 0.4186551034, 0.6902396635),
        "first": (0.09663964219, 0.4053942219, 0.1039628527, 0.4739934527, 0.1095515583),
        "sigma0": 1.422286545,
        "errors": (4.971072485, 6.383060698, 5585.35),
        "largest": (4.502105809, 133),
        "two_view": (48, 0.4960),
        "least_of_others": None,
        "classes": (48, 17, 62, 223),
        "image": (0, 0.2741),
    },
}


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_numbers(name, request):
    expected = REFERENCE[name]
    if name == "street":
        start = bundle.synthesize(scene="street", num_images=8, num_points=60, seed=7).problem
    else:
        folder = request.getfixturevalue("bundle_data") / "colmap" / "crane_mast"
        whole = bundle.load(folder)
        lines = (folder / "points3D.txt").read_text().splitlines()
        ids = [int(line.split()[0]) for line in lines if line[0] != "#"]
        start = whole.select(points=np.isin(whole.point_ids, ids[::35])).problem
    result = bundle.solve(start, **TIGHT, max_num_iterations=200)
    problem = result.problem
    found = bundle.reliability(result)
    assert found.dof == expected["dof"] and found.sum == pytest.approx(found.dof, abs=1e-7)
    assert found.sigma0 == pytest.approx(expected["sigma0"], rel=1e-8)
    rows = np.lexsort([problem.observation_keypoint, problem.observation_image])
    r = found.redundancy[rows].ravel()
    least, median, largest = expected["range"]
    assert np.median(r) == pytest.approx(median, rel=1e-7)
    assert r.max() == pytest.approx(largest, rel=1e-7)
    assert r.min() == pytest.approx(least, rel=1e-7, abs=1e-10)
    np.testing.assert_allclose(r[:5], expected["first"], rtol=1e-6)
    errors = found.delta0 / np.sqrt(r)
    for one, of in zip((np.min, np.median, np.max), expected["errors"], strict=True):
        assert one(errors) == pytest.approx(of, rel=2e-5 if of > 1000 else 1e-7)
    w = found.standardized[rows].ravel()
    size, row = expected["largest"]
    assert np.nanargmax(np.abs(w)) == row and abs(w[row]) == pytest.approx(size, rel=1e-7)
    of_two = np.bincount(problem.observation_point)[problem.observation_point] == 2
    count, largest = expected["two_view"]
    assert of_two.sum() == found.num_two_view == count
    assert np.abs(found.least_redundancy[of_two]).max() < 1e-10
    assert found.redundancy[of_two].max() == pytest.approx(largest, abs=5e-5)
    if expected["least_of_others"]:
        others = found.least_redundancy[~of_two].min()
        assert others == pytest.approx(expected["least_of_others"], rel=1e-7)
    classes = np.histogram(r, [-1, 0.01, 0.1, 0.3, 2])[0]
    assert tuple(classes) == expected["classes"]
    image, share = expected["image"]
    of_image = found.image_redundancy / (2 * np.bincount(problem.observation_image))
    assert of_image[image] == pytest.approx(share, abs=5e-5)
    dense = Dense(problem)
    held = {("camera", 0, 1), ("camera", 0, 2)}
    columns = [j for j, column in enumerate(dense.names) if column not in held]
    whole = residual_maker(dense.jacobian[:, columns])
    check_rows(found, diagonal_blocks(whole), dense.residual.reshape(-1, 2), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("seed", range(40))
def test_random_problems_agree_with_dense_matrices(seed):
    """Rigs, ties, constant parameters, sigmas, losses and priors of three kinds."""
    case = random_case(seed)
    rows = case.dense.jacobian @ case.basis
    try:
        whole_covariance = case.dense.covariance(case.basis)
    except SingularError:
        pytest.skip("more than similarities is free")
    found = bundle.reliability(case.problem, factors=case.factors, align=False, **case.settings)
    whole = residual_maker(rows)
    n = case.problem.num_observations
    used = np.repeat(case.dense.rho_prime > 0, 2)
    assert found.num_zero_weight == (~used[::2]).sum()
    if used.all():
        residual = case.dense.residual[: 2 * n].reshape(-1, 2)
        check_rows(found, diagonal_blocks(whole)[:n], residual, rtol=1e-8, atol=1e-10)
    first = 2 * n
    test_of = {}
    for factor, size in zip(case.factors, case.dense.prior_sizes, strict=True):
        block = whole[first : first + size, first : first + size]
        r = case.dense.residual[first : first + size]
        values, vectors = np.linalg.eigh(block)
        is_checked = values >= NOT_CHECKABLE
        test = ((vectors.T @ r)[is_checked] ** 2 / values[is_checked]).sum()
        test_of[factor.name] = np.trace(block), values[0], test, is_checked.sum()
        first += size
    assert len(found.priors) == len(case.factors)
    for prior in found.priors:
        redundancy, least, test, degrees = test_of[prior.name]
        assert prior.redundancy == pytest.approx(redundancy, rel=1e-8, abs=1e-9)
        assert prior.least_redundancy == pytest.approx(least, rel=1e-8, abs=1e-9)
        assert prior.test == pytest.approx(test, rel=1e-6, abs=1e-8)
        assert prior.degrees == degrees
    counted = np.append(used, np.ones(first - 2 * n, bool))
    assert found.sum == pytest.approx(np.diag(whole)[counted].sum(), rel=1e-9, abs=1e-8)
    check_effects(found, case, whole_covariance)


def check_effects(found, case, covariance):
    """The exact movement by the worst errors, in units of the dense covariance."""
    problem, column = case.problem, case.dense.column
    sigma = problem.observation_sigma
    images = problem.observation_image[[one.observation for one in found.worst]]
    beside = set(problem.observation_point[np.isin(problem.observation_image, images)].tolist())
    for one in found.worst:
        k = one.observation
        u = found.weakest_direction[k] / np.sqrt(one.least_redundancy)
        moved = found.delta0 * covariance @ (case.dense.jacobian[2 * k : 2 * k + 2].T @ u)
        sizes = {}
        for p in beside:
            j = column["point", p, 0]
            block = covariance[j : j + 3, j : j + 3]
            if np.trace(block) > 0:
                sizes[p] = np.sqrt(moved[j : j + 3] @ np.linalg.solve(block, moved[j : j + 3]))
        if sizes:
            p = max(sizes, key=lambda key: sizes[key])
            assert one.moved_point_sigmas == pytest.approx(sizes[p], rel=1e-6)
            assert one.moved_point_id == problem.point_ids[p]
            assert one.moved_point_sigmas <= one.external_bound * (1 + 1e-9)
        assert one.moved_image_sigmas <= one.external_bound * (1 + 1e-9)
        images = {}
        for i in np.flatnonzero(case.dense.frame[: problem.num_images] < 0):
            j = column["image", i, 0]
            block = covariance[j : j + 6, j : j + 6]
            if np.trace(block) > 0:
                images[i] = np.sqrt(moved[j : j + 6] @ np.linalg.solve(block, moved[j : j + 6]))
        if images and (case.dense.frame[: problem.num_images] < 0).all():
            assert one.moved_image_sigmas == pytest.approx(max(images.values()), rel=1e-6)
        scale = 1.0 if sigma is None else sigma[k]
        weight = found.weight[k]
        size = found.delta0 * scale / np.sqrt(weight * one.least_redundancy)
        assert one.minimal_detectable_error == pytest.approx(size, rel=1e-9)


@pytest.fixture(scope="module")
def sparse():
    """A problem whose S is sparse, refined."""
    problem = make_problem(num_images=60, num_points=200, track=5, seed=2, perturbation=1e-4)
    return bundle.solve(problem, **TIGHT).problem


def test_a_sparse_system_agrees_with_dense_matrices(sparse):
    dense = Dense(sparse)
    held = [j for j, name in enumerate(dense.names) if name[0] == "camera" and name[2] in (1, 2)]
    rows = np.delete(dense.jacobian, held, axis=1)
    found = bundle.reliability(sparse)
    blocks = diagonal_blocks(residual_maker(rows))
    check_rows(found, blocks, dense.residual.reshape(-1, 2), rtol=1e-8, atol=1e-9)
    assert found.sum == pytest.approx(found.dof, abs=1e-6)
    basis = np.delete(np.eye(len(dense.names)), held, axis=1)
    check_effects(found, Case(sparse, {}, [], dense, basis, 0), dense.covariance(basis))


def arrays(found):
    return np.column_stack([found.redundancy, found.least_redundancy, found.standardized])


def test_neither_order_nor_frame_nor_threads_matter(sparse):
    whole = arrays(bundle.reliability(sparse))
    near = {"rtol": 1e-8, "atol": 1e-9}
    order = np.random.default_rng(1).permutation(sparse.num_observations)
    mixed = bundle.reliability(with_observations(sparse, order))
    np.testing.assert_allclose(arrays(mixed), whole[order], **near)
    from bundle.georeference.similarity import Similarity, moved
    from tests.rig_scenes import Rotation

    turn = Rotation.from_euler("zyx", [130, 12, -25], degrees=True).as_matrix()
    elsewhere = moved(sparse, Similarity(0.27, turn, np.array([500.0, -900.0, 40.0])))
    np.testing.assert_allclose(arrays(bundle.reliability(elsewhere)), whole, rtol=1e-6, atol=1e-8)
    for settings in ({"num_threads": 2}, {"gauge": "two_cameras"}, {"backend": "ceres"}):
        np.testing.assert_allclose(arrays(bundle.reliability(sparse, **settings)), whole, **near)


def test_an_error_on_an_epipolar_line_is_never_seen():
    """l = 0 for both rays to a point, along the projection of the other ray."""
    problem = make_problem(num_images=4, num_points=30, seed=3, perturbation=1e-3, shared=True)
    keep = ~((problem.observation_point == 7) & (problem.observation_image > 1))
    problem = bundle.solve(with_observations(problem, keep), **TIGHT).problem
    found = bundle.reliability(problem)
    rows = np.flatnonzero(problem.observation_point == 7)
    np.testing.assert_allclose(found.least_redundancy[rows], 0, atol=1e-10)
    assert found.redundancy[rows].max() > 0.1
    assert np.isnan(found.minimal_detectable_error[rows]).all()
    assert found.num_two_view == 2 and found.num_uncontrolled >= 2
    assert found.point_redundancy[7] < 1
    # The image of points on the ray of the other image, at depths beside the point's.
    first, second = problem.observation_image[rows]
    center = problem.projection_centers[second]
    ends = problem.points[7] + 1e-4 * np.outer([-1, 1], problem.points[7] - center)
    moved = problem.replace(points=np.vstack([problem.points[:7], ends[:1], problem.points[8:]]))
    other = problem.replace(points=np.vstack([problem.points[:7], ends[1:], problem.points[8:]]))
    line = Dense(other).residual.reshape(-1, 2)[rows[0]]
    line = line - Dense(moved).residual.reshape(-1, 2)[rows[0]]
    line /= np.linalg.norm(line)
    assert abs(found.weakest_direction[rows[0]] @ line) == pytest.approx(1, abs=1e-6)
    assert first != second


def test_a_planted_error_of_the_detectable_size_shifts_the_test_by_delta0():
    problem = make_problem(num_images=6, num_points=60, seed=4, perturbation=1e-3, shared=True)
    problem = bundle.solve(problem, **TIGHT).problem
    before = bundle.reliability(problem)
    for row in (10, 111, 203):
        u = before.weakest_direction[row]
        xy = problem.observation_xy.copy()
        xy[row] += before.minimal_detectable_error[row] * u
        after = bundle.reliability(bundle.solve(problem.replace(observation_xy=xy), **TIGHT))
        shift = [
            (found.standardized[row] * np.sqrt(found.redundancy[row])) @ u
            for found in (before, after)
        ]
        shift = abs(shift[1] - shift[0]) / np.sqrt(before.least_redundancy[row])
        assert shift == pytest.approx(4.13, rel=0.03)


def test_an_image_of_three_points_is_checked_by_nothing():
    problem = make_problem(num_images=5, num_points=40, seed=5, perturbation=1e-3, shared=True)
    keep = (problem.observation_image != 4) | (problem.observation_point < 3)
    problem = bundle.solve(with_observations(problem, keep), **TIGHT).problem
    found = bundle.reliability(problem)
    assert found.image_redundancy[4] == pytest.approx(0, abs=1e-9)
    assert found.images[0].image_id == problem.image_ids[4] and found.images[0].share < 1e-9
    finding = next(one for one in found.findings if one.kind == "unchecked_images")
    assert finding.evidence["image_ids"] == [int(problem.image_ids[4])]
    few = bundle.solve(make_problem(num_images=5, num_points=40, seed=5, shared=True)).problem
    whole = bundle.reliability(few)
    assert not whole.findings and whole.images[0].share > WEAK


def test_sums_belong_to_images_points_and_cameras(sparse):
    found = bundle.reliability(sparse)
    of_row = found.redundancy.sum(axis=1)
    cameras = sparse.image_camera[sparse.observation_image]
    for owner, sums in (
        (sparse.observation_image, found.image_redundancy),
        (sparse.observation_point, found.point_redundancy),
        (cameras, found.camera_redundancy),
    ):
        np.testing.assert_allclose(sums, np.bincount(owner, of_row), rtol=1e-12)
        assert sums.sum() == pytest.approx(found.sum, rel=1e-9)
    shares = [image.share for image in found.images]
    assert shares == sorted(shares)


def test_observations_without_weight_count_apart():
    problem = make_problem(num_images=5, num_points=40, seed=6, perturbation=1e-3, shared=True)
    xy = problem.observation_xy.copy()
    xy[3] += 60  # beyond the scale of the loss
    problem = bundle.solve(problem.replace(observation_xy=xy), loss="tukey", loss_scale=8).problem
    found = bundle.reliability(problem, loss="tukey", loss_scale=8)
    assert found.num_zero_weight == 1 and found.weight[3] == 0
    assert np.isnan(found.redundancy[3]).all() and np.isnan(found.least_redundancy[3])
    assert found.num_used == problem.num_observations - 1
    without = with_observations(problem, np.arange(problem.num_observations) != 3)
    alone = bundle.reliability(without, loss="tukey", loss_scale=8)
    rest = np.arange(problem.num_observations) != 3
    np.testing.assert_allclose(found.redundancy[rest], alone.redundancy, rtol=1e-9, atol=1e-11)
    assert found.sum == pytest.approx(alone.sum, rel=1e-10)
    robust = bundle.reliability(problem, loss="cauchy", loss_scale=1.0)
    assert robust.num_downweighted == (robust.weight < 0.1).sum() >= 1


def test_a_point_at_infinity_keeps_its_observations():
    """Its undetermined direction takes no part; the pseudo-inverse of V does as the dense one."""
    problem = make_problem(num_images=4, num_points=30, seed=7, perturbation=1e-3, shared=True)
    points = problem.points.copy()
    points[5] = problem.projection_centers[0] + 1e9 * np.array([0.1, 0.0, 1.0])
    problem = problem.replace(points=points)
    dense = Dense(problem)
    held = {("camera", 0, 1), ("camera", 0, 2)}
    columns = [j for j, column in enumerate(dense.names) if column not in held]
    found = bundle.reliability(problem)
    assert found.num_points_at_infinity == 1
    blocks = diagonal_blocks(residual_maker(dense.jacobian[:, columns]))
    near = {"rtol": 1e-6, "atol": 1e-8}
    np.testing.assert_allclose(found.redundancy, np.diagonal(blocks, axis1=1, axis2=2), **near)


@pytest.mark.parametrize("row_time", ["fixed-point", "observed"])
def test_rolling_shutters_agree_with_differences(row_time):
    base = make_problem(num_images=4, num_points=30, seed=8, perturbation=0, shared=True)
    problem = rolling.filmed(base, seed=8, row_time=row_time)
    options = {"twists": "free", "refine": ("poses", "points", "focal")}
    found = bundle.reliability(problem, **options)
    blocks = diagonal_blocks(residual_maker(rolling_rows(problem)))
    near = {"rtol": 1e-5, "atol": 1e-6}
    np.testing.assert_allclose(found.redundancy, np.diagonal(blocks, axis1=1, axis2=2), **near)
    np.testing.assert_allclose(found.least_redundancy, np.linalg.eigvalsh(blocks)[:, 0], **near)
    assert found.sum == pytest.approx(found.dof, abs=1e-6)


def rolling_rows(problem):
    """J by central differences of an independent projection."""

    def with_pose(i, k, step):
        poses = rolling.matrices(problem)
        twist = np.zeros(6)
        twist[k] = step
        poses[i] = rolling.exponentials(rolling.hats(twist[None]))[0] @ poses[i]
        return at(poses=poses)

    def at(**values):
        rows = rolling.Rows(problem)
        if problem.rolling_shutter.row_time == "observed":
            return rows.project(rows.time(problem.observation_xy), **values)
        return rows.project(rows.fixed_point(**values), **values)

    def with_array(name, values, index, step):
        changed = values.astype(float).copy()
        changed[index] += step
        return at(**{name: changed})

    columns = []
    for i in range(problem.num_images):
        for k in range(6):
            columns.append(lambda s, i=i, k=k: with_pose(i, k, s))
    for name, values, step in (
        ("twists", problem.rolling_shutter.twist, 1),
        ("points", problem.points, 1),
        ("params", problem.camera_params[:, :1], 1),
    ):
        source = {"twists": values, "points": values, "params": problem.camera_params}[name]
        for index in np.ndindex(values.shape):
            columns.append(lambda s, n=name, v=source, j=index, u=step: with_array(n, v, j, s * u))
    step = 1e-5
    return np.stack([(f(step) - f(-step)).ravel() / (2 * step) for f in columns], axis=1)


def test_ties_of_twists_count_as_priors():
    base = make_problem(num_images=5, num_points=40, seed=9, perturbation=0, shared=True)
    problem = rolling.filmed(base, seed=9, ties=True)
    found = bundle.reliability(problem, twists="tied", twist_sigma=(0.002, 0.01), gauge="none")
    assert found.priors and {prior.kind for prior in found.priors} == {"twist_tie"}
    assert found.sum == pytest.approx(found.dof, abs=1e-6)


TARGETS = [[-20, -20, 0], [20, -20, 0.5], [0, 20, -0.5], [18, 18, 0.2], [-18, 17, 0.1]]


@pytest.mark.parametrize("count", [3, 5])
def test_control_points_that_nothing_checks(count):
    scene = flight(TARGETS[:count], seed=1, survey_noise=0.0)
    found = bundle.reliability(scene.problem, priors=scene.gcps, align=False)
    assert [prior.kind for prior in found.priors] == ["control point"] * count
    assert {prior.name for prior in found.priors} == {f"t{k}" for k in range(count)}
    assert found.sum == pytest.approx(found.dof, abs=1e-5)
    assert len(found.redundancy) == scene.problem.num_observations
    assert len(found.point_redundancy) == scene.problem.num_points
    kinds = {finding.kind for finding in found.findings}
    assert ("unchecked_control_points" in kinds) == (count == 3)
    total = sum(prior.redundancy for prior in found.priors)
    assert total <= 3 * count - 7 + 1e-6 + 7 * (count > 0)


def test_sigma0_scales_errors_but_no_redundancies(sparse):
    unit = bundle.reliability(sparse)
    scaled = bundle.reliability(sparse, scale="sigma0", delta0=2.0)
    np.testing.assert_array_equal(scaled.redundancy, unit.redundancy)
    np.testing.assert_allclose(
        scaled.minimal_detectable_error,
        2 / 4.13 * unit.sigma0 * unit.minimal_detectable_error,
        rtol=1e-12,
    )
    np.testing.assert_allclose(scaled.standardized, unit.standardized / unit.sigma0, rtol=1e-12)
    np.testing.assert_allclose(scaled.external_bound, 2 / 4.13 * unit.external_bound, rtol=1e-12)


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"delta0": 0}, "delta0"),
        ({"delta0": float("nan")}, "delta0"),
        ({"scale": "pixels"}, "scale"),
        ({"loss": "none"}, "loss"),
    ],
)
def test_wrong_arguments(settings, field):
    with pytest.raises(bundle.InputError, match=rf"^{field}: "):
        bundle.reliability(make_problem(), **settings)


def test_what_nothing_determines_is_refused():
    problem = make_problem(num_images=2, num_points=5, perturbation=0)
    with pytest.raises(bundle.InputError, match="problem: expected"):
        bundle.reliability(problem)
    with pytest.raises(bundle.InputError, match="found 0"):
        bundle.reliability(with_observations(problem, []))


def test_a_result_with_priors_needs_them_again():
    problem = make_problem(num_images=4, num_points=30, perturbation=1e-3, shared=True)
    prior = bundle.PriorFactor(("point", 1), problem.points[0], np.eye(3))
    result = bundle.solve(problem, factors=[prior])
    with pytest.raises(bundle.InputError, match="together with its result"):
        bundle.reliability(result)
    assert len(bundle.reliability(result, factors=[prior]).priors) == 1


def test_it_pickles_shows_itself_and_is_written_whole(tmp_path):
    found = bundle.reliability(bundle.solve(make_problem(shared=True)))
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.redundancy, found.redundancy)
    assert not again.redundancy.flags.writeable
    assert repr(found).startswith("Reliability: ") and len(found.sentences) <= 4
    found.save(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as arrays:
        assert set(arrays) == {
            name for name in vars(found) if isinstance(getattr(found, name), np.ndarray)
        }
        np.testing.assert_array_equal(arrays["external_bound"], found.external_bound)
    assert not any(isinstance(one, np.ndarray) for one in found.entries.values())
    assert {"sum", "num_uncontrolled", "images", "worst"} <= set(found.entries)
