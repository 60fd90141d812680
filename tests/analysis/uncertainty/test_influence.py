"""Influences against dense matrices, reference numbers and problems solved again.

The oracle is C g and the Gauss-Newton step of smaller problems, rows by complex steps.
"""

import pickle

import numpy as np
import pytest

import bundle
from bundle.analysis.uncertainty.quantity import quantity_of
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import random_case
from tests.analysis.uncertainty.test_reliability import TARGETS, TIGHT
from tests.georeference.flights import flight
from tests.scenes import make_problem, with_observations


def gradient_of(dense, quantity):
    """The gradient of a quantity by the columns of a dense form without rigs."""
    g = np.zeros(len(dense.names))
    for (kind, i, k), j in dense.column.items():
        parts = {"image": quantity.images, "camera": quantity.cameras, "point": quantity.points}
        g[j] = parts[kind][i, k]
    return g


def columns_of(dense, held=((1, 2),)):
    """Focal lengths and distortion are free."""
    return [j for j, n in enumerate(dense.names) if n[0] != "camera" or n[2] not in held[0]]


def step_of(rows, residual, g):
    """g^T x of one step; the least-squares solution of least norm in comparable columns."""
    scale = np.linalg.norm(rows, axis=0)
    scale = np.where(scale > 0, scale, 1)
    x = np.linalg.lstsq(rows / scale, -residual, rcond=1e-9)[0] / scale
    return g @ x


def is_undetermined(rows, g):
    """True if g is no combination of the rows, as an estimable function is."""
    scale = np.linalg.norm(rows, axis=0)
    scale = np.where(scale > 0, scale, 1)
    combined = np.linalg.lstsq((rows / scale).T, g / scale, rcond=1e-9)[0]
    return np.linalg.norm(combined @ rows / scale - g / scale) > 1e-6 * np.linalg.norm(g / scale)


@pytest.fixture(scope="module")
def small():
    problem = make_problem(num_images=4, num_points=20, seed=3, perturbation=1e-3, shared=True)
    keep = np.random.default_rng(0).random(problem.num_observations) < 0.85
    return bundle.solve(with_observations(problem, keep), **TIGHT).problem


TEXTS = (
    "distance 3 9 / baseline 1 4",
    "distance 3 image:image2.jpg / baseline 1 4",
    "f 1",
    "k 1",
    "angle 3 5 7",
    "volume 1 2 3 4 / volume 5 6 7 8",
    "height 1 2 / height 3 4",
)


@pytest.mark.parametrize("text", TEXTS[:-1])
def test_derivatives_and_deletions_agree_with_dense_matrices(small, text):
    dense = Dense(small)
    quantity = quantity_of(text, small, {})
    columns = columns_of(dense)
    g, rows, r = gradient_of(dense, quantity)[columns], dense.jacobian[:, columns], dense.residual
    found = bundle.influence(small, text, without="images")
    scale = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-10, hermitian=True)
    a = (inverse @ (g / scale)) / scale
    assert found.sigma == pytest.approx(np.sqrt(g @ a), rel=1e-6)
    near = {"rtol": 1e-5, "atol": 1e-7 * found.sigma}
    np.testing.assert_allclose(found.by_observation, (rows @ a).reshape(-1, 2), **near)
    assert np.nansum(found.share) == pytest.approx(1, rel=1e-8) and found.share_of_factors == 0
    base = step_of(rows, r, g)
    for kind, owner, values in (
        ("observation", np.arange(small.num_observations), found.without_observation),
        ("point", small.observation_point, found.without_point),
        ("image", small.observation_image, found.without_image),
    ):
        checked = 0
        for key in np.unique(owner)[:: 7 if kind == "observation" else 1]:
            keep = np.repeat(owner != key, 2)
            is_open = is_undetermined(rows[keep], g)
            is_named = kind == "point" and quantity.points[key].any()
            assert np.isnan(values[key]) == (is_open or is_named)
            if np.isnan(values[key]):
                continue
            checked += 1
            change = step_of(rows[keep], r[keep], g) - base
            assert values[key] - found.value == pytest.approx(
                change, rel=1e-4, abs=1e-5 * found.sigma
            )
        assert checked >= 1


def test_deletions_of_a_problem_beyond_long_sums_agree_with_dense_matrices():
    """The rank formula with all leverages, of which three are those of a point's coordinates."""
    problem = make_problem(num_images=12, num_points=200, seed=5, perturbation=1e-3, shared=True)
    problem = bundle.solve(problem, **TIGHT).problem
    text = "distance 3 9 / baseline 1 4"
    dense, quantity = Dense(problem), quantity_of(text, problem, {})
    columns = columns_of(dense)
    scale = np.linalg.norm(dense.jacobian[:, columns], axis=0)
    rows, r = dense.jacobian[:, columns] / scale, dense.residual
    a = np.linalg.pinv(rows.T @ rows, rcond=1e-12, hermitian=True)
    along = rows @ (a @ (gradient_of(dense, quantity)[columns] / scale))
    found = bundle.influence(problem, text)
    for owner, keys, values, rank in (
        (np.arange(problem.num_observations), range(0, 2400, 311), found.without_observation, 0),
        (problem.observation_point, range(0, 200, 31), found.without_point, 3),
    ):
        for key in keys:
            own = np.repeat(owner == key, 2)
            rest = np.eye(own.sum()) - rows[own] @ a @ rows[own].T
            share, axes = np.linalg.eigh(rest)
            change = (axes.T @ along[own] / share * (axes.T @ r[own]))[rank:].sum()
            assert values[key] - found.value == pytest.approx(change, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("text", TEXTS)
def test_gradients_of_quantities_agree_with_differences(small, text):
    """Gradients by poses, which move by (w, t), by parameters and by points."""
    from tests.scenes import exp

    quantity = quantity_of(text, small, {})
    step = 1e-6

    def at(**changes):
        return quantity_of(text, small.replace(**changes), {}).value

    def moved(i, k, size):
        from scipy.spatial.transform import Rotation

        poses = small.cam_from_world.copy()
        if k < 3:
            turn = Rotation.from_matrix(exp(size * np.eye(3)[k]).real)
            poses[i, :4] = (turn * Rotation.from_quat(poses[i, :4])).as_quat()
        else:
            poses[i, 1 + k] += size
        return at(cam_from_world=poses)

    for i in range(small.num_images):
        for k in range(6):
            slope = (moved(i, k, step) - moved(i, k, -step)) / (2 * step)
            assert quantity.images[i, k] == pytest.approx(slope, abs=1e-7)
    for name, values, gradient in (
        ("points", small.points, quantity.points),
        ("camera_params", small.camera_params, quantity.cameras),
    ):
        for index in [tuple(one) for one in np.argwhere(gradient)] + [(0, 0)]:
            ends = []
            for size in (step, -step):
                changed = values.copy()
                changed[index] += size
                ends.append(at(**{name: changed}))
            slope = (ends[0] - ends[1]) / (2 * step)
            assert gradient[index] == pytest.approx(slope, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5, 6, 8, 10, 11, 13, 16, 19])
def test_random_problems_agree_with_dense_matrices(seed):
    """Rigs, ties, constant parameters, sigmas, losses and priors."""
    case = random_case(seed)
    text = "angle " + " ".join(map(str, case.problem.point_ids[[3, 5, 8]]))
    quantity = quantity_of(text, case.problem, {})
    g = np.zeros(len(case.dense.names))
    for p in range(case.problem.num_points):
        g[case.dense.column["point", p, 0] :][:3] = quantity.points[p]
    variance = g @ case.dense.covariance(case.basis) @ g
    given = {"factors": case.factors, "align": False, **case.settings}
    if variance == 0:
        with pytest.raises(bundle.InputError, match="constant"):
            bundle.influence(case.problem, text, **given)
        return
    found = bundle.influence(case.problem, text, **given)
    assert found.sigma == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert np.nansum(found.share) + found.share_of_factors == pytest.approx(1, rel=1e-7)
    along = case.dense.jacobian @ case.dense.covariance(case.basis) @ g
    n = case.problem.num_observations
    share = (along[: 2 * n].reshape(-1, 2) ** 2).sum(axis=1) / variance
    used = case.dense.rho_prime > 0
    np.testing.assert_allclose(found.share[used], share[used], rtol=1e-5, atol=1e-9)
    sigma = case.problem.observation_sigma
    root = np.sqrt(case.dense.rho_prime) / (1 if sigma is None else sigma)
    by_pixel = along[: 2 * n].reshape(-1, 2) * root[:, None]
    near = {"rtol": 1e-5, "atol": 1e-7 * np.abs(by_pixel).max()}
    np.testing.assert_allclose(found.by_observation[used], by_pixel[used], **near)
    largest = np.sort(share[used])[::-1]
    assert largest[: found.hangs_on].sum() >= 0.5 * share[used].sum() - 1e-9
    assert largest[: found.hangs_on - 1].sum() < 0.5 * share[used].sum()


# Values and sigmas of another program: ratio of a distance to the longest baseline, focal length,
# ratio of two baselines.
REFERENCE = {
    "street": (
        (0.2220813449, 0.00754459474),
        (1025.0246, 22.81971476),
        (0.5979418831, 0.00143978741),
    ),
    "crane": (
        (0.02240649242, 0.000777317076),
        (2293.442678, 15.38397997),
        (0.5729159957, 0.001283290179),
    ),
}


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_numbers(name, request):
    if name == "street":
        start = bundle.synthesize(scene="street", num_images=8, num_points=60, seed=7).problem
        ids = start.point_ids
    else:
        folder = request.getfixturevalue("bundle_data") / "colmap" / "crane_mast"
        whole = bundle.load(folder)
        lines = (folder / "points3D.txt").read_text().splitlines()
        ids = [int(line.split()[0]) for line in lines if line[0] != "#"][::35]
        start = whole.select(points=np.isin(whole.point_ids, ids)).problem
    result = bundle.solve(start, **TIGHT, max_num_iterations=200)
    problem = result.problem
    counts = dict(zip(problem.point_ids, np.bincount(problem.observation_point), strict=True))
    longest = sorted(ids, key=lambda key: -counts[key])[:2]
    base = f"baseline {problem.image_ids[0]} {problem.image_ids[7]}"
    texts = (
        f"distance {longest[0]} {longest[1]} / {base}",
        f"f {problem.camera_ids[0]}",
        f"baseline {problem.image_ids[0]} {problem.image_ids[4]} / {base}",
    )
    for text, (value, sigma) in zip(texts, REFERENCE[name], strict=True):
        found = bundle.influence(result, text)
        assert found.value == pytest.approx(value, rel=2e-7)
        assert found.sigma == pytest.approx(sigma, rel=2e-6)


def test_deletions_predict_problems_solved_again():
    problem = make_problem(num_images=6, num_points=60, seed=4, perturbation=1e-3, shared=True)
    problem = bundle.solve(problem, **TIGHT).problem
    text = "distance 3 9 / baseline 1 6"
    found = bundle.influence(problem, text, without="images")
    rows = np.argsort(-found.share)[:6]
    errors = []
    for owner, keys, values in (
        (np.arange(problem.num_observations), rows, found.without_observation),
        (problem.observation_point, [10, 30], found.without_point),
        (problem.observation_image, [2, 3], found.without_image),
    ):
        for key in keys:
            kept = with_observations(problem, owner != key)
            again = quantity_of(text, bundle.solve(kept, **TIGHT).problem, {}).value
            errors.append(abs(values[key] - again) / found.sigma)
    assert max(errors) < 0.05 and np.median(errors) < 0.01


def test_what_is_no_minimum_is_said(small):
    assert not bundle.influence(small, "f 1").notes
    points = small.points + 0.01 * np.random.default_rng(1).standard_normal(small.points.shape)
    (note,) = bundle.influence(small.replace(points=points), "f 1").notes
    assert note in bundle.reliability(small.replace(points=points)).notes


def test_an_error_moves_the_quantity_as_the_derivative_says(small):
    text = "distance 3 9 / baseline 1 4"
    found = bundle.influence(small, text)
    row = int(np.nanargmax(found.share))
    ends = []
    for size in (0.01, -0.01):
        xy = small.observation_xy.copy()
        xy[row, 0] += size
        ends.append(
            quantity_of(text, bundle.solve(small.replace(observation_xy=xy), **TIGHT).problem, {})
        )
    slope = (ends[0].value - ends[1].value) / 0.02
    assert found.by_observation[row, 0] == pytest.approx(slope, rel=0.03)


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        ("distance 1 2", "the scale of"),
        ("height 1 2", "the rotation and scale of"),
        ("volume 1 2 3 4", "the scale of"),
        ("baseline 1 2", "the scale of"),
        ("distance 1 image:image2.jpg", "the scale of"),
        ("height 1 image:image2.jpg", "the rotation and scale of"),
    ],
)
def test_a_quantity_without_a_datum_is_refused(small, text, lacks):
    with pytest.raises(bundle.InputError, match=f"changes with {lacks} the world"):
        bundle.influence(small, text)


def test_control_points_are_a_datum():
    scene = flight(TARGETS, seed=1)
    given = {"priors": scene.gcps, "align": False}
    found = bundle.influence(scene.problem, "distance t0 t1", **given)
    assert found.value == pytest.approx(40, abs=0.5) and 0 < found.sigma < 0.1
    assert found.share_of_factors > 0.1
    height = bundle.influence(scene.problem, "height t0 12", **given)
    assert height.sigma > 0 and len(height.share) == scene.problem.num_observations
    assert np.nansum(height.share) + height.share_of_factors < 1 + 1e-9  # without the markers'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "a quantity such as"),
        ("distance 1", "2 places after distance"),
        ("distance 1 2 3", "2 places"),
        ("distance 1 1", "different places"),
        ("distance 1 999", "the id of a point"),
        ("distance 1 marker", "the id of a point"),
        ("distance 1 image:none.jpg", "the name or id of an image"),
        ("baseline 1 99", "the name or id of an image"),
        ("baseline 1 image0.jpg", "different places"),
        ("f 9", "the id of a camera"),
        ("fy 1", "a parameter of camera 1"),
        ("length 1 2", "a camera's parameter"),
        ("cx 1", "a constant"),
        ("f 1 /  ", "baseline"),
        ("f 1 / cx", "baseline"),
    ],
)
def test_what_is_no_quantity_is_one_line(small, text, words):
    with pytest.raises(bundle.InputError, match=r"^on: expected ") as error:
        bundle.influence(small, text)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_places_at_one_place_have_no_direction(small):
    points = small.points.copy()
    points[0] = points[1]
    with pytest.raises(bundle.InputError, match="at one place"):
        bundle.influence(small.replace(points=points), "distance 1 2 / baseline 1 4")


def test_changes_are_sorted_and_it_pickles(small):
    for without in ("observations", "points", "images"):
        found = bundle.influence(small, "f 1", without=without)
        values = getattr(found, f"without_{without[:-1]}")
        order = np.argsort(-np.nan_to_num(np.abs(values - found.value), nan=-1), kind="stable")
        shown = order[np.isfinite(values[order])][:20]
        np.testing.assert_array_equal([one.value for one in found.changes], values[shown])
        first = {"observations": "the observation of point", "points": "point", "images": "image"}
        assert found.changes[0].what.startswith(first[without])
    again = pickle.loads(pickle.dumps(found))
    asked = bundle.influence(small, "f 1", without="points")
    for name in ("share", "without_observation", "without_point", "without_image"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    np.testing.assert_array_equal(again.without_point, asked.without_point)
    assert repr(found).startswith("Influence: f 1") and len(found.sentences) <= 4
    assert 1 <= found.hangs_on <= found.num_observations
    assert not any(isinstance(one, np.ndarray) for one in found.entries.values())
    with pytest.raises(bundle.InputError, match=r"^without: "):
        bundle.influence(small, "f 1", without="cameras")
