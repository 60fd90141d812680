"""Reliability and influence with a prior of every kind, robust losses, lenses and shutters.

The oracle has the formulas of all measurements, differentiated by central differences.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.analysis.uncertainty.covariance_by_input import at_control_points, request_at
from bundle.analysis.uncertainty.quantity import quantity_of
from bundle.interface.analysis_options import NOT_CHECKABLE
from bundle.solving.prepare import prepare
from tests import rolling
from tests.analysis.uncertainty.dense import rho_prime
from tests.analysis.uncertainty.test_influence import step_of
from tests.analysis.uncertainty.test_reliability import diagonal_blocks, residual_maker
from tests.scenes import make_problem

FREE = [0, 3]  # focal length and k
FRAME_RATE = 25.0
IDLE = {"direction": 1, "plane of 5 points": 3, "level plane of 4 points": 1}
"""Residuals that follow from the others of their prior."""


class Case:
    """A problem, its priors, and whitened rows by columns of poses, twists, lenses and points."""

    def __init__(self, seed, row_time, loss):
        rng = np.random.default_rng(seed)
        base = make_problem(num_images=6, num_points=25, seed=seed, perturbation=0)
        directions = ("rows", "columns", "rows", "global", "rows", "global")
        self.problem = problem = rolling.filmed(
            base, direction=directions, seed=seed, row_time=row_time, frame_rate=FRAME_RATE
        )
        self.given = {
            "twists": "free", "refine": ("poses", "points", "focal", "extra"),
            "loss": loss, "align": False, **({} if loss == "trivial" else {"loss_scale": 0.5}),
        }  # fmt: skip
        turns = Rotation.from_quat(problem.cam_from_world[:, :4])
        centers = problem.projection_centers
        robust = {"loss": "cauchy", "loss_scale": 0.7}
        lever = (0.1, -0.2, 0.3)
        self.sets = []  # (kind, residual by a state, loss, loss_scale)
        priors = []

        def add(prior, kind, residual):
            priors.append(prior)
            self.sets.append((kind, residual, prior.loss, prior.loss_scale))

        def at(i, lever):
            where = centers[i] + turns[i].inv().apply(lever) + rng.normal(0, 0.05, 3)
            sigma = np.array([0.03, 0.03, 0.08])
            prior = bundle.PositionPrior(i + 1, where, (0.03, 0.08), lever_arm=lever, **robust)

            def residual(s):
                r, t = s["poses"][i, :3, :3], s["poses"][i, :3, 3]
                return (r.T @ (np.array(lever) - t) - where) / sigma

            add(prior, f"PositionFactor(('image', {i + 1}))", residual)

        at(0, lever)
        at(3, (0, 0, 0))
        down = turns[1].apply([0, 0, -1.0]) + rng.normal(0, 0.02, 3)
        down /= np.linalg.norm(down)
        add(
            bundle.GravityPrior(2, down, 1.5, **robust),
            "direction",
            lambda s: (s["poses"][1, :3, :3] @ [0, 0, -1] - down) / np.radians(1.5),
        )
        z = turns[2] * Rotation.from_rotvec(rng.normal(0, 0.03, 3))
        add(
            bundle.OrientationPrior(3, z.as_quat(), (3.0, 1.0), **robust),
            "rotation",
            lambda s: (
                (z.inv() * Rotation.from_matrix(s["poses"][2, :3, :3])).as_rotvec()
                / np.radians([1.0, 1.0, 3.0])
            ),
        )

        def heading(s):
            east, north, _ = s["poses"][3, :3, :3].T @ [0, 0, 1]
            return np.array([np.arctan2(east, north)])

        straight = heading({"poses": rolling.matrices(problem)})[0] + 0.04
        add(
            bundle.HeadingPrior(4, np.degrees(straight), 2.0),
            "heading",
            lambda s: (heading(s) - straight) / np.radians(2.0),
        )

        def velocity(s):
            w, v = s["twists"][4, :3], s["twists"][4, 3:]
            r = s["poses"][4, :3, :3]
            return -FRAME_RATE * r.T @ (v + np.cross(w, lever)) / problem.rolling_shutter.readout[4]

        now = velocity(
            {"poses": rolling.matrices(problem), "twists": problem.rolling_shutter.twist}
        )
        measured = now + rng.normal(0, 0.3, 3)
        add(
            bundle.VelocityPrior(5, measured, (0.3, 0.5), lever_arm=lever, **robust),
            "velocity",
            lambda s: (velocity(s) - measured) / [0.3, 0.3, 0.5],
        )
        for k in range(2):  # among the points of the problem, displaced
            pixels = [
                (problem.image_names[i], *xy)
                for i, p, xy in zip(
                    problem.observation_image,
                    problem.observation_point,
                    problem.observation_xy + rng.normal(0, 0.3, problem.observation_xy.shape),
                    strict=True,
                )
                if p == k
            ]
            place = problem.points[k] + rng.normal(0, 0.02, 3)
            row = problem.num_points + k
            add(
                bundle.GroundControlPoint(
                    name=f"g{k}", position=tuple(place), measurements=pixels, sigma=(0.02, 0.04),
                    **robust,
                ),
                f"g{k}",
                lambda s, row=row, place=place: (s["points"][row] - place) / [0.02, 0.02, 0.04],
            )  # fmt: skip

        def bar(ends, of, place):  # between control points, or between images
            length = np.linalg.norm(np.subtract(*place)) + 0.01

            def residual(s):
                return np.array([(np.linalg.norm(np.subtract(*of(s))) - length) / 0.005])

            name = f"scale bar {ends[0]} - {ends[1]}"
            add(bundle.ScaleBar(*ends, length, 0.005, **robust), name, residual)

        row = problem.num_points
        bar(("g0", "g1"), lambda s: s["points"][row : row + 2], problem.points[:2])
        i, j = 2, 4
        bar(
            (problem.image_names[i], problem.image_names[j]),
            lambda s: [-s["poses"][k, :3, :3].T @ s["poses"][k, :3, 3] for k in (i, j)],
            centers[[i, j]],
        )
        rules = ("points 7-11: on plane sigma 0.3", "points 11-14: on level plane sigma 0.4")
        for name, rows, sigma in (("plane", np.s_[6:11], 0.3), ("level plane", np.s_[10:14], 0.4)):

            def flat(s, rows=rows, sigma=sigma, is_level=name != "plane"):
                x = s["points"][rows] - s["points"][rows].mean(axis=0)
                normal = np.array([0, 0, 1]) if is_level else np.linalg.svd(x)[2][2]
                return x @ normal * np.copysign(1, normal[2]) / sigma

            kind = f"{name} of {rows.stop - rows.start} points"
            self.sets.append((kind, flat, "trivial", 1.0))
        self.priors = priors
        focal = problem.camera_params[1] + [5.0, 0, 0, 0]
        sigmas = np.array([8.0, 1e3, 1e3, 0.05])
        self.factors = [bundle.PriorFactor(("camera", 2), focal, np.diag(sigmas**-2))]
        self.sets.append(("prior", lambda s: (s["params"][1] - focal) / sigmas, "trivial", 1.0))
        settings = {name: value for name, value in self.given.items() if name != "align"}
        self.given["constraints"] = rules
        known = {
            "priors": priors, "factors": self.factors, "align": False, "constraints": rules
        }  # fmt: skip
        result = bundle.solve(
            problem, **known, **settings, function_tolerance=1e-16, gradient_tolerance=0,
            parameter_tolerance=1e-12, max_num_iterations=200,
        )  # fmt: skip
        self.problem = result.problem
        request = request_at(self.problem, None, settings, "reliability", **known, bounds=None)
        self.start = at_control_points(prepare(request)).start
        self.linearize(loss)

    def linearize(self, loss):
        start, rows = self.start, rolling.Rows(self.start)
        shutter = start.rolling_shutter

        def residuals(**values):
            state = {
                "poses": rolling.matrices(start), "twists": shutter.twist,
                "params": start.camera_params, "points": start.points,
            } | values  # fmt: skip
            if shutter.row_time == "observed":
                xy = rows.project(rows.time(start.observation_xy), **state)
            else:
                xy = rows.project(rows.fixed_point(**state), **state)
            seen = (xy - start.observation_xy) / start.observation_sigma[:, None]
            return [seen.ravel(), *(residual(state) for _, residual, _, _ in self.sets)]

        def moved(i, k, step):
            poses = rolling.matrices(start)
            if k < 3:
                turn = Rotation.from_rotvec(step * np.eye(3)[k]).as_matrix()
                poses[i, :3, :3] = turn @ poses[i, :3, :3]
            else:
                poses[i, k - 3, 3] += step
            return {"poses": poses}

        def changed(name, values, index, step):
            values = values.astype(float).copy()
            values[index] += step
            return {name: values}

        columns = [
            (("pose", i, k), lambda s, i=i, k=k: moved(i, k, s))
            for i in range(start.num_images)
            for k in range(6)
        ]
        rolls = shutter.is_rolling[start.image_camera]
        arrays = {
            "twists": (shutter.twist, [(i, k) for i in np.flatnonzero(rolls) for k in range(6)]),
            "params": (
                start.camera_params, [(c, j) for c in range(start.num_cameras) for j in FREE]
            ),
            "points": (start.points, list(np.ndindex(start.points.shape))),
        }  # fmt: skip
        for name, (values, indices) in arrays.items():
            for index in indices:
                columns.append(
                    (
                        (name, *index),
                        lambda s, n=name, v=values, j=index: changed(n, v, j, s),
                    )
                )
        raw = residuals()
        step = 1e-5
        jacobian = np.stack(
            [
                (
                    np.concatenate(residuals(**change(step)))
                    - np.concatenate(residuals(**change(-step)))
                )
                / (2 * step)
                for _, change in columns
            ],
            axis=1,
        )
        squares = (raw[0].reshape(-1, 2) ** 2).sum(axis=1)
        weights = [np.repeat(rho_prime(loss, 0.5, squares), 2)]
        for r, (_, _, of, scale) in zip(raw[1:], self.sets, strict=True):
            weights.append(np.full(len(r), rho_prime(of, scale, np.array([r @ r]))[0]))
        root = np.sqrt(np.concatenate(weights))
        self.rows, self.r = root[:, None] * jacobian, root * np.concatenate(raw)
        self.weight = weights[0][::2]
        self.place = {name: j for j, (name, _) in enumerate(columns)}
        ends = np.cumsum([len(r) for r in raw])
        self.blocks = {
            kind: slice(a, b)
            for (kind, *_), a, b in zip(self.sets, ends[:-1], ends[1:], strict=True)
        }


@pytest.fixture(
    scope="module", params=[(0, "fixed-point", "cauchy"), (1, "observed", "trivial")], ids=str
)
def case(request):
    return Case(*request.param)


def test_redundancies_agree_with_differences(case):
    found = bundle.reliability(case.problem, priors=case.priors, factors=case.factors, **case.given)
    gradient = case.rows.T @ case.r / np.linalg.norm(case.rows, axis=0)
    assert np.abs(gradient).max() < 1e-4 * np.linalg.norm(case.r)  # control points, too
    squares = (case.r**2).sum() / found.dof
    given = {name: value for name, value in case.given.items() if name != "align"}
    scaled = bundle.covariance(
        case.problem, priors=case.priors, factors=case.factors, **given, scale="sigma0"
    )
    assert found.sigma0 == pytest.approx(np.sqrt(squares), rel=1e-6)
    assert scaled.sigma0 == pytest.approx(np.sqrt(squares), rel=1e-6)
    whole = residual_maker(case.rows)
    n = case.problem.num_observations
    near = {"rtol": 1e-5, "atol": 2e-6}
    blocks = diagonal_blocks(whole)[:n]
    np.testing.assert_allclose(found.redundancy, np.diagonal(blocks, axis1=1, axis2=2), **near)
    np.testing.assert_allclose(found.least_redundancy, np.linalg.eigvalsh(blocks)[:, 0], **near)
    np.testing.assert_allclose(found.weight, case.weight[:n], rtol=1e-7)
    own = np.diagonal(blocks, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        w = np.where(own >= NOT_CHECKABLE, case.r[: 2 * n].reshape(-1, 2) / np.sqrt(own), np.nan)
    np.testing.assert_allclose(found.standardized, w, rtol=1e-4, atol=1e-5)
    assert found.sum == pytest.approx(found.dof, abs=1e-5)
    assert found.sum == pytest.approx(np.trace(whole) - sum(IDLE.values()), abs=1e-4)
    assert len(found.priors) == len(case.sets)
    named = ("control point", "position", "function")
    priors = {prior.name if prior.kind in named else prior.kind: prior for prior in found.priors}
    assert priors.keys() == case.blocks.keys()
    for key, prior in priors.items():
        of = case.blocks[key]
        block, r = whole[of, of], case.r[of]
        idle = IDLE.get(key, 0)
        assert prior.num_residuals == len(block) - idle
        assert prior.redundancy == pytest.approx(np.trace(block) - idle, abs=1e-5)
        values, vectors = np.linalg.eigh(block)
        values, along = values[: len(block) - idle], (vectors.T @ r)[: len(block) - idle]
        assert prior.least_redundancy == pytest.approx(values[0], abs=1e-5)
        is_checked = values >= NOT_CHECKABLE
        test = (along[is_checked] ** 2 / values[is_checked]).sum()
        assert prior.test == pytest.approx(test, rel=1e-3, abs=1e-5)
        assert prior.degrees == is_checked.sum()


@pytest.mark.parametrize(
    "text", ["distance 3 9", "height 4 image:image2.jpg", "f 2", "distance g0 g1", "baseline 1 5"]
)
def test_influences_agree_with_differences(case, text):
    found = bundle.influence(
        case.problem, text, priors=case.priors, factors=case.factors, without="images", **case.given
    )
    markers = dict(zip(("g0", "g1"), case.start.point_ids[-2:], strict=True))
    quantity = quantity_of(text, case.start, markers)
    g = np.zeros(len(case.place))
    for (kind, *index), j in case.place.items():
        parts = {"pose": quantity.images, "params": quantity.cameras, "points": quantity.points}
        if kind in parts:
            g[j] = parts[kind][tuple(index)]
    scale = np.linalg.norm(case.rows, axis=0)
    a = np.linalg.pinv((case.rows / scale).T @ (case.rows / scale), rcond=1e-13, hermitian=True)
    a = (a @ (g / scale)) / scale
    assert found.sigma == pytest.approx(np.sqrt(g @ a), rel=1e-4)
    along, n = case.rows @ a, case.problem.num_observations
    share = (along.reshape(-1)[: 2 * n].reshape(-1, 2) ** 2).sum(axis=1) / (g @ a)
    np.testing.assert_allclose(found.share, share, rtol=1e-3, atol=1e-7)
    of_factors = (along[2 * case.start.num_observations :] ** 2).sum() / (g @ a)
    assert found.share_of_factors == pytest.approx(of_factors, rel=1e-4)
    base = step_of(case.rows, case.r, g)
    checked = 0
    for owner, values in (
        (np.arange(n), found.without_observation),
        (case.start.observation_point, found.without_point),
        (case.start.observation_image, found.without_image),
    ):
        for key in np.unique(owner)[::11] if len(values) > 30 else range(len(values)):
            if np.isnan(values[key]):
                continue
            keep = np.ones(len(case.r), bool)
            keep[: 2 * len(owner)] = np.repeat(owner != key, 2)
            change = step_of(case.rows[keep], case.r[keep], g) - base
            checked += 1
            assert values[key] - found.value == pytest.approx(
                change, rel=2e-3, abs=1e-3 * found.sigma
            )
    assert checked > 20
