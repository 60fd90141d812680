"""Derivatives of a minimum against another program's numbers, and against minima of changed data.

Differences are central, with two steps (Richardson), of minima that Newton steps reach exactly.
"""

import copy
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.analysis.uncertainty.quantity import quantity_of
from tests.analysis.uncertainty.random_problems import random_case
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem, with_observations

TIGHT = {"function_tolerance": 1e-15, "gradient_tolerance": 0, "parameter_tolerance": 0}
ANGLE = "angle 3 5 7"


def gradients(problem, text=ANGLE):
    q = quantity_of(text, problem, {})
    return {"points": q.points, "poses": q.images, "cameras": q.cameras}


def value_of(problem, text=ANGLE):
    return quantity_of(text, problem, {}).value


def minimum(problem, **given):
    adjoint = bundle.adjoint(problem, **given)
    if not adjoint.is_converged:
        solved = bundle.solve(problem, align=False, **given, **TIGHT, max_num_iterations=300)
        adjoint = bundle.adjoint(solved.problem, **given)
    assert adjoint.is_converged
    return adjoint.problem


def moved_to(problem, rows, places):
    """Move the world so that three points get to their places."""
    here = problem.points[rows]
    a, b = here - here.mean(axis=0), places - places.mean(axis=0)
    turn, _ = Rotation.align_vectors(b, a)
    scale = np.linalg.norm(b) / np.linalg.norm(a)
    shift = places.mean(axis=0) - scale * turn.apply(here.mean(axis=0))
    points = scale * turn.apply(problem.points.copy()) + shift
    np.testing.assert_allclose(points[rows], places, atol=1e-7 * np.abs(b).max())
    return moved(problem, scale, turn, shift)


def moved(problem, scale, turn, shift):
    poses = problem.cam_from_world.copy()
    rotations = Rotation.from_quat(poses[:, :4].copy()) * turn.inv()
    poses[:, :4] = rotations.as_quat()
    poses[:, 4:] = scale * poses[:, 4:] - rotations.apply(np.tile(shift, (len(poses), 1)))
    points = scale * turn.apply(problem.points.copy()) + shift
    return problem.replace(points=points, cam_from_world=poses)


def slope(value, step):
    """d value(h) / dh at h = 0, of fourth order."""
    near, far = ((value(h) - value(-h)) / (2 * h) for h in (step / 2, step))
    return (4 * near - far) / 3


# Reference numbers of another program, from its own dense derivatives: ratios of lengths and
# volumes of the best seen points, along random directions of the data.

REFERENCE = {
    "street": {
        "plain": {"pixels": 0.0006640381858, "weights": 0.0001501878912},
        "gauss_newton": {"pixels": 0.0006807855089, "weights": 0.0001508909702},
        "held": {
            "pixels": -0.001887788276, "weights": 7.695979484e-06, "f": -7.267712085e-05,
            "k": 2.307315909e-05, "cx": 6.259639399e-05,
        },
        "priors": {
            "pixels": -0.0002605733473, "weights": 0.0001572541416, "mean": -0.09701517209,
            "sigma": 0.0001020481977, "length": 0.002702769288,
        },
        "cauchy": {
            "pixels": -0.0002203439096, "weights": 3.612070987e-05, "mean": -0.04987737063,
            "sigma": -3.245872755e-05, "length": 0.008898230045,
        },
    },
    "crane": {
        "plain": {"pixels": 4.640618945e-05, "weights": -2.267729372e-05},
        "gauss_newton": {"pixels": 4.702845082e-05, "weights": -2.243502633e-05},
        "held": {
            "pixels": -0.0001487922059, "weights": -1.044885059e-05, "f": -8.160439446e-06,
            "k": 2.821023395e-06, "cx": 5.826521352e-07,
        },
        "priors": {
            "pixels": -0.0006338913847, "weights": 0.0001158995325, "mean": -0.01234881845,
            "sigma": -2.636803688e-05, "length": -0.002997000653,
        },
        "cauchy": {
            "pixels": 4.654489397e-05, "weights": 0.0001862716257, "mean": -0.01610603507,
            "sigma": -7.634082839e-05, "length": -0.001746649754,
        },
    },
}  # fmt: skip


THREE = {
    "street": (
        (8.97739915105656, -1.4484782618430514, -0.011720594454523517),
        (45.640648061225974, 7.750300188716535, 2.139406817650166),
        (25.58759766695778, -11.168241243870778, 7.287243694928846),
    ),
    "crane": (
        (1.1888406859165523, 1.06261133715263, 3.721647402612946),
        (-3.538599082261962, 0.8529736900901008, 10.83762218829158),
        (1.705191859260571, 0.9886493160502527, 10.939813852884265),
    ),
}
"""Three points in the gauge of the other program, whose priors are in it."""


class Reference:
    """A model of the other program, its random directions and its scalar."""

    def __init__(self, name, request):
        self.name = name
        if name == "street":
            start = bundle.synthesize(scene="street", num_images=8, num_points=60, seed=7).problem
            ids = start.point_ids
        else:
            folder = request.getfixturevalue("bundle_data") / "colmap" / "crane_mast"
            whole = bundle.load(folder)
            lines = (folder / "points3D.txt").read_text().splitlines()
            ids = [int(line.split()[0]) for line in lines if line[0] != "#"][::35]
            start = whole.select(points=np.isin(whole.point_ids, ids)).problem
        self.problem = bundle.solve(start, **TIGHT, max_num_iterations=200).problem
        self.problem = bundle.adjoint(self.problem).problem
        row_of = {key: row for row, key in enumerate(start.point_ids.tolist())}
        self.points = np.array([row_of[int(key)] for key in ids])  # rows in its order
        self.observations = np.lexsort((start.observation_keypoint, start.observation_image))
        counts = np.bincount(start.observation_point)[self.points]
        self.best = self.points[np.argsort(-counts, kind="stable")[:4]]
        self.counts, self.rng = counts, np.random.default_rng(5)
        self.problem = moved_to(self.problem, self.three(), np.array(THREE[name]))

    def three(self):
        """Rows of three well seen points far apart."""
        x = self.problem.points[self.points]
        seen = np.flatnonzero(self.counts >= 3)
        axis = np.linalg.svd(x - x.mean(axis=0))[2][0]
        ends = [seen[np.argmin(x[seen] @ v)] for v in (axis, -axis)]
        if self.name == "street":
            ends.sort()
        across = np.cross(x[seen] - x[ends[0]], x[ends[1]] - x[ends[0]])
        return self.points[[*ends, seen[np.argmax(np.linalg.norm(across, axis=1))]]]

    def known_points(self):
        """Rows, means and sigmas of three priors, and the unit of the scene."""
        rows = self.three()
        span = np.linalg.norm(self.problem.points.std(axis=0))
        means = self.problem.points[rows] + 0.005 * span * self.rng.normal(size=(3, 3))
        return rows, means, 0.02 * span, span

    def directions(self):
        """Directions of pixels and weights in the order of the problem, and of three means."""
        n = self.problem.num_observations
        pixels, weights = np.empty((n, 2)), np.empty(n)
        pixels[self.observations] = self.rng.normal(size=(n, 2))
        weights[self.observations] = self.rng.normal(size=n)
        return pixels, weights, self.rng.normal(size=(3, 3))

    def gradients(self, problem, has_datum):
        """Derivatives of 3 distance / base + volume / base^3, and of a height with a datum."""
        ends = problem.point_ids[self.best]
        base = f"baseline {problem.image_ids[0]} {problem.image_ids[-1]}"
        ratio = quantity_of(f"distance {ends[0]} {ends[1]} / {base}", problem, {})
        length = quantity_of(base, problem, {})
        volume = quantity_of("volume " + " ".join(map(str, ends)), problem, {})
        e = problem.points[self.best[1:]] - problem.points[self.best[0]]
        sign = np.sign(np.linalg.det(e))
        found = {}
        for name, part in (("points", "points"), ("poses", "images"), ("cameras", "cameras")):
            r, b, v = (getattr(one, part) for one in (ratio, length, volume))
            found[name] = 3 * r + sign * (
                v / length.value**3 - 3 * volume.value / length.value**4 * b
            )
        if has_datum:
            found["points"][self.points[5], 2] += 1
        return found


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_numbers(name, request):
    model = Reference(name, request)
    problem = model.problem
    found = {}
    dy, dw, _ = model.directions()
    for kind, exact in (("plain", True), ("gauss_newton", False)):
        adjoint = bundle.adjoint(problem, exact=exact)
        d = adjoint.vjp(**model.gradients(adjoint.problem, False))
        found[kind] = {"pixels": 0.05 * (d.pixels * dy).sum(), "weights": 0.02 * d.weights @ dw}
    assert found["plain"]["pixels"] == pytest.approx(0.05 * (d.pixels * dy).sum(), rel=0.1)

    dy, dw, _ = model.directions()
    adjoint = bundle.adjoint(problem, refine=("poses", "points"))
    d = adjoint.vjp(**model.gradients(adjoint.problem, False))
    f, cx, _, k = d.held[0]
    found["held"] = {
        "pixels": 0.05 * (d.pixels * dy).sum(), "weights": 0.02 * d.weights @ dw,
        "f": 1e-4 * problem.camera_params[0, 0] * f, "k": 1e-4 * k, "cx": 0.1 * cx,
    }  # fmt: skip

    for kind, loss in (("priors", "trivial"), ("cauchy", "cauchy")):
        rows, means, sigma, span = model.known_points()
        known = [
            bundle.PriorFactor(("point", int(problem.point_ids[row])), mean, sigma=sigma)
            for row, mean in zip(rows, means, strict=True)
        ]
        a, b = model.best[:2]
        length = np.linalg.norm(problem.points[a] - problem.points[b]) * 1.005
        ends = [("point", int(problem.point_ids[row])) for row in (a, b)]
        bar = bundle.ScaleBar(*ends, float(length), 0.01 * span)
        dy, dw, dm = model.directions()
        given = {"factors": known, "priors": [bar], "loss": loss}
        near = bundle.solve(problem, align=False, **given, **TIGHT, max_num_iterations=300)
        adjoint = bundle.adjoint(near)
        d = adjoint.vjp(**model.gradients(adjoint.problem, True))
        assert d.is_converged and d.gauge_share < 1e-9
        found[kind] = {
            "pixels": 0.05 * (d.pixels * dy).sum(), "weights": 0.02 * d.weights @ dw,
            "mean": 0.01 * span * sum(m @ v for m, v in zip(d.prior_means, dm, strict=False)),
            "sigma": 0.02 * sigma * sum(one.sum() for one in d.prior_sigmas[:3]),
            "length": 0.01 * span * float(d.prior_means[3]),
        }  # fmt: skip
    for kind, numbers in REFERENCE[name].items():
        for what, number in numbers.items():
            # Parts ten times as large cancel in one of them.
            rel = 3e-6 if (name, kind, what) == ("crane", "cauchy", "pixels") else 1e-6
            assert found[kind][what] == pytest.approx(number, rel=rel), (kind, what)


# Against minima of changed data, with all that can be on at the same time.


def changed(problem, what, size, direction):
    """The problem with its data moved along a direction."""
    if what == "pixels":
        return problem.replace(observation_xy=problem.observation_xy + size * direction)
    if what == "sigmas":
        sigma = problem.observation_sigma
        sigma = np.ones(problem.num_observations) if sigma is None else sigma
        return problem.replace(observation_sigma=sigma + size * direction)
    return problem.replace(camera_params=problem.camera_params + size * direction)


def agree(problem, given, text=ANGLE, *, rel=1e-6, step=1e-2):
    """Compare the derivatives of a problem with differences of its minima."""
    adjoint = bundle.adjoint(problem, **given)
    d = adjoint.vjp(**gradients(adjoint.problem, text))
    assert d.is_converged
    rng = np.random.default_rng(0)
    directions = {
        "pixels": (d.pixels, rng.normal(size=d.pixels.shape)),
        "sigmas": (d.sigmas, rng.normal(size=d.sigmas.shape)),
        "held": (d.held, (d.held != 0) * np.maximum(np.abs(problem.camera_params), 1) * 1e-3),
    }
    for what, (derivatives, direction) in directions.items():
        expected = slope(
            lambda h, what=what, direction=direction: value_of(
                minimum(changed(adjoint.problem, what, h, direction), **given), text
            ),
            step,
        )
        scale = np.linalg.norm(derivatives) * np.linalg.norm(direction)
        found = (derivatives * direction).sum()
        assert found == pytest.approx(expected, rel=rel, abs=rel * scale), what
    return adjoint, d


@pytest.fixture(scope="module")
def small():
    problem = make_problem(num_images=4, num_points=20, seed=3, perturbation=1e-3, shared=True)
    keep = np.random.default_rng(0).random(problem.num_observations) < 0.85
    return bundle.solve(with_observations(problem, keep), **TIGHT).problem


@pytest.mark.parametrize("loss", ["trivial", "huber", "soft_l1", "cauchy", "arctan"])
def test_losses_agree_with_minima_of_changed_data(small, loss):
    given = {"loss": loss, "refine": ("poses", "points", "focal")}
    given |= {} if loss == "trivial" else {"loss_scale": 1.5}
    problem = bundle.solve(small, **given, **TIGHT).problem
    # The second derivative of huber jumps at its scale.
    _, d = agree(problem, given, rel=1e-4 if loss == "huber" else 1e-6, step=2e-3)
    assert (d.held[:, 1:] != 0).all() and (d.held[:, 0] == 0).all()
    assert d.num_products == 1


@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5, 7, 10, 11])
def test_random_problems_agree_with_minima_of_changed_data(seed):
    """Rigs, ties, constant parameters, sigmas, losses and priors."""
    case = random_case(seed)
    given = {"factors": case.factors, **case.settings}
    if given["loss"] in ("huber", "tukey"):  # not twice differentiable, and not one minimum
        given["loss"] = "cauchy"
    problem = bundle.solve(
        case.problem, align=False, **given, **TIGHT, max_num_iterations=300
    ).problem
    text = "angle " + " ".join(map(str, problem.point_ids[[3, 5, 8]]))
    adjoint, d = agree(problem, given, text, rel=3e-6, step=2e-3)
    assert len(d.prior_means) == len(adjoint.factors) == len(case.factors)
    known = [k for k, factor in enumerate(case.factors) if factor.kind != "function"]
    if not known:
        return
    priors = [case.factors[k] for k in known]
    names = ["position" if one.kind == "position" else "value" for one in priors]
    means = [np.asarray(getattr(*one), float) for one in zip(priors, names, strict=True)]
    directions = [
        np.random.default_rng(k).normal(size=mean.shape) / np.sqrt(np.diag(factor.information))
        for k, (mean, factor) in enumerate(zip(means, priors, strict=True))
    ]

    def with_means(h):  # all at once, in sigmas
        factors = [copy.copy(factor) for factor in case.factors]
        for k, name, mean, direction in zip(known, names, means, directions, strict=True):
            object.__setattr__(factors[k], name, mean + h * direction)
        return value_of(minimum(adjoint.problem, **{**given, "factors": factors}), text)

    products = [d.prior_means[k] * b for k, b in zip(known, directions, strict=True)]
    scale = np.linalg.norm(np.concatenate(products))
    found = sum(one.sum() for one in products)
    assert found == pytest.approx(slope(with_means, 1e-2), rel=3e-6, abs=3e-6 * scale + 1e-7)


def test_sigmas_of_priors_agree_with_minima_of_changed_sigmas(small):
    def known(sigma, loss):
        means = small.points[:3] + 0.02 * np.random.default_rng(2).normal(size=(3, 3))
        return [
            bundle.PriorFactor(
                ("point", int(key)), mean, sigmas=sigma, loss=loss, loss_scale=1.0
            )
            for key, mean in zip(small.point_ids[:3], means, strict=True)
        ]  # fmt: skip

    sigmas, direction = np.array([0.02, 0.03, 0.05]), np.array([0.01, -0.02, 0.015])
    for loss in ("trivial", "cauchy"):
        at = {"factors": known(sigmas, loss)}
        problem = bundle.solve(small, align=False, **at, **TIGHT).problem
        adjoint = bundle.adjoint(problem, **at)
        d = adjoint.vjp(**gradients(adjoint.problem, "distance 5 9"))
        expected = slope(
            lambda h, p=adjoint.problem, loss=loss: value_of(
                minimum(p, factors=known(sigmas + h * direction, loss)),
                "distance 5 9",
            ),
            1e-2,
        )
        found = sum(one @ direction for one in d.prior_sigmas)
        assert found == pytest.approx(expected, rel=1e-6)


def test_derivatives_do_not_depend_on_the_gauge(small):
    """A moved, turned and scaled world, also one far from its origin, has the same derivatives."""
    d = bundle.adjoint(small).vjp(**gradients(small))
    for scale, shift in ((3.0, 0.0), (1.0, 1e5)):
        turn = Rotation.from_rotvec([0.3, -0.5, 0.2])
        adjoint = bundle.adjoint(moved(small, scale, turn, np.full(3, shift)))
        again = adjoint.vjp(**gradients(adjoint.problem))
        tolerance = {"atol": 1e-7 * np.abs(d.pixels).max() * max(1, abs(shift) / 1e3)}
        np.testing.assert_allclose(again.pixels, d.pixels, rtol=0, **tolerance)


def test_the_part_along_the_gauge_is_taken_out_and_said(small):
    adjoint = bundle.adjoint(small)
    by_x = np.zeros_like(small.points)
    by_x[:, 0] = 1.0  # the sum of all x: a motion of the world
    plain = gradients(adjoint.problem)
    mixed = {**plain, "points": plain["points"] + 1e-3 * by_x}
    with pytest.warns(bundle.GaugeWarning, match="%"):
        d = adjoint.vjp(**mixed)
    assert 1e-6 < d.gauge_share <= 1 and d.is_converged and np.isfinite(d.pixels).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert adjoint.vjp(**plain).gauge_share < 1e-9


def test_the_problem_is_polished():
    loose = bundle.solve(
        make_problem(num_images=4, num_points=20, seed=3, perturbation=1e-3, shared=True),
        function_tolerance=1e-4,
    ).problem
    tight = bundle.adjoint(bundle.solve(loose, **TIGHT).problem)
    adjoint = bundle.adjoint(loose)
    assert adjoint.is_converged and adjoint.next_step < 1e-8
    found, expected = (one.vjp(**gradients(one.problem)).pixels for one in (adjoint, tight))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    off = loose.points - adjoint.problem.points
    assert np.abs(off).max() > 1e-9


def test_without_a_minimum_derivatives_are_nan_with_a_warning(small):
    points = small.points + 0.5 * np.random.default_rng(1).standard_normal(small.points.shape)
    adjoint = bundle.adjoint(small.replace(points=points), loss="cauchy", loss_scale=0.1)
    assert not adjoint.is_converged
    with pytest.warns(bundle.NotConvergedWarning, match="NaN"):
        d = adjoint.vjp(points=np.zeros_like(points))
    assert not d.is_converged
    for array in (d.pixels, d.weights, d.sigmas, d.held):
        assert np.isnan(array).all()


@pytest.mark.parametrize(("loss_scale", "has_minimum"), [(20.0, True), (1.0, False)])
def test_a_stationary_point_without_a_minimum_is_nan(loss_scale, has_minimum):
    """A point halfway between two measurements, each of which a loss takes for an outlier."""
    start = make_problem(num_images=2, num_points=12, noise=0, perturbation=0, shared=True)
    twice = np.repeat([0, 1], 2)
    rows = np.concatenate([np.flatnonzero(start.observation_image == image) for image in twice])
    xy = start.observation_xy[rows]
    is_first = start.observation_point[rows] == 0
    xy[is_first, 0] += np.array([3, -3, 3, -3])
    problem = start.replace(
        image_ids=np.arange(1, 5),
        image_names=[f"image{i}.jpg" for i in range(4)],
        image_camera=np.zeros(4, int),
        cam_from_world=start.cam_from_world[twice],
        observation_image=np.repeat(np.arange(4), 12),
        observation_point=start.observation_point[rows],
        observation_xy=xy,
        observation_keypoint=None,
    )
    given = {"refine": ("points", "focal"), "loss": "cauchy", "loss_scale": loss_scale}
    adjoint = bundle.adjoint(problem, **given)
    assert adjoint.next_step < 1e-7 and adjoint.is_converged == has_minimum
    by_another = np.zeros_like(problem.points)
    by_another[5, 2] = 1
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        d = adjoint.vjp(points=by_another)
    kinds = [one.category for one in said]
    assert kinds == ([] if has_minimum else [bundle.NotConvergedWarning])
    assert d.is_converged == has_minimum
    for array in (d.pixels, d.weights, d.sigmas, d.held):
        assert (np.isfinite(array) if has_minimum else np.isnan(array)).all()


EVERYTHING = {
    "plain": {},
    "robust": {"loss": "cauchy", "loss_scale": 1.0},
    "constant": {"fixed_image_ids": [1, 3], "fixed_point_ids": [2, 9], "fixed_camera_ids": [2]},
    "priors": {"loss": "soft_l1", "loss_scale": 2.0},
}


@pytest.mark.parametrize("name", EVERYTHING)
def test_one_product_shows_the_solution(name):
    """Derivatives of several cameras do not depend on the threads or the order of points."""
    problem = make_problem(num_images=5, num_points=30, track=4, seed=6, perturbation=1e-3)
    given = dict(EVERYTHING[name])
    if name == "priors":
        given["factors"] = [
            bundle.PriorFactor(("point", key), problem.points[key - 1] + 0.01, sigma=0.02)
            for key in (1, 4, 20)
        ] + [bundle.ScalarPriorFactor(("camera", 1), 0, 500.0, 5.0)]
    problem = bundle.solve(problem, align=False, **given, **TIGHT).problem
    adjoint = bundle.adjoint(problem, num_threads=1, **given)
    d = adjoint.vjp(**gradients(adjoint.problem))
    assert d.num_products == 1 and d.is_converged
    order = np.random.default_rng(0).permutation(problem.num_points)
    mixed = adjoint.problem.replace(
        points=adjoint.problem.points[order],
        point_ids=problem.point_ids[order],
        observation_point=np.argsort(order)[problem.observation_point],
    )
    for other, threads in ((adjoint.problem, 2), (mixed, 1), (mixed, 2)):
        again = bundle.adjoint(other, num_threads=threads, **given)
        found = again.vjp(**gradients(again.problem))
        assert found.num_products == 1
        for array in ("pixels", "weights", "sigmas", "held"):
            expected = getattr(d, array)
            # Those by constant parameters are differences.
            atol = (1e-7 if array == "held" else 1e-9) * np.abs(expected).max()
            np.testing.assert_allclose(getattr(found, array), expected, rtol=0, atol=atol)


@pytest.mark.parametrize("exact", [True, False])
def test_derivatives_of_a_constant_are_zero(small, exact):
    """Also of one of an undetermined point, here one that no image sees."""
    unseen = small.replace(
        points=np.vstack([small.points, [0.1, 0.2, 0.3]]),
        point_ids=np.append(small.point_ids, 99),
    )
    adjoint = bundle.adjoint(unseen, exact=exact, refine=("poses", "points"))
    by_unseen = np.zeros_like(unseen.points)
    by_unseen[-1] = 1
    for given in ({}, {"points": by_unseen}):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            d = adjoint.vjp(**given)
        assert d.is_converged
        for array in (d.pixels, d.weights, d.sigmas, d.held):
            assert (array == 0).all()


def test_control_points_fix_the_world():
    from tests.analysis.uncertainty.test_reliability import TARGETS
    from tests.georeference.flights import flight

    scene = flight(TARGETS, seed=1)
    result = bundle.solve(scene.problem, priors=scene.gcps, align=False, **TIGHT)
    adjoint = bundle.adjoint(result)
    by_height = np.zeros_like(adjoint.problem.points)
    by_height[12, 2] = 1
    d = adjoint.vjp(points=by_height)
    assert d.gauge_share < 1e-12 and d.is_converged
    rising = [mean[2] for mean in d.prior_means if mean is not None]
    assert sum(rising) == pytest.approx(1, abs=1e-6)  # the block rises with its control points


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("points", np.zeros((3, 3)), "shape"),
        ("poses", np.zeros((4, 7)), "shape"),
        ("cameras", np.zeros(3), "shape"),
        ("points", np.full((20, 3), np.nan), "finite"),
        ("poses", np.full((4, 6), np.inf), "finite"),
        ("points", "abc", "numbers"),
    ],
)
def test_wrong_cotangents_are_one_line(small, name, value, words):
    with pytest.raises(bundle.InputError, match=rf"^{name}: expected ") as error:
        bundle.adjoint(small).vjp(**{name: value})
    assert words in str(error.value) and "\n" not in str(error.value)


def test_what_is_not_supported_is_one_line(small):
    bar = bundle.ScaleBar(("point", 1), ("point", 2), 1.0, 0.01)
    with pytest.raises(bundle.InputError, match=r"^exact: expected True") as error:
        bundle.adjoint(small, exact=False, priors=[bar])
    assert "\n" not in str(error.value)
    with pytest.raises(bundle.InputError, match=r"^exact: "):
        bundle.adjoint(small, exact=1.5)


def test_rigs_with_free_sensors_agree():
    problem = rig_problem(num_frames=3, num_points=16, seed=2, rigs=(STEREO,))
    given = {"refine_sensor_from_rig": True, "loss": "cauchy", "loss_scale": 2.0}
    problem = bundle.solve(problem, **given, **TIGHT, max_num_iterations=300).problem
    text = "angle " + " ".join(map(str, problem.point_ids[[3, 5, 8]]))
    agree(problem, given, text, rel=3e-6, step=2e-3)


def test_repr_says_which_hessian(small):
    exact, plain = (bundle.adjoint(small, exact=exact) for exact in (True, False))
    assert "exact" in repr(exact) and "Gauss-Newton" in repr(plain)
    given = gradients(small)
    assert "Gauss-Newton" in repr(plain.vjp(**given)) and exact.vjp(**given).num_products == 1
    assert plain.vjp(**given).num_products == 0


@pytest.mark.parametrize(
    ("given", "ties"),
    [({}, False), ({"loss": "cauchy", "loss_scale": 1.0}, False), ({"twists": "hard"}, True)],
)
def test_rolling_shutters_agree_with_minima_of_changed_data(given, ties):
    from tests.rolling import filmed

    start = make_problem(num_images=5, num_points=30, seed=4, perturbation=1e-3, shared=True)
    given = {"refine": ("poses", "points"), **given}
    near = bundle.solve(filmed(start, ties=ties), **given, **TIGHT, max_num_iterations=300)
    agree(near.problem, given, rel=1e-5, step=2e-3)


def test_measured_rows_of_a_rolling_shutter_are_refused():
    from tests.rolling import filmed

    with pytest.raises(bundle.InputError, match="row_time fixed-point, found observed"):
        bundle.adjoint(filmed(make_problem(num_images=4, num_points=20), row_time="observed"))
