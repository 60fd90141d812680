"""Local adjustment under the exact marginal prior of the rest, against dense linear algebra.

The whole problem and the part are linearised by formulas of the tests
(tests/analysis/uncertainty/dense.py); only the prior is ours. One Gauss-Newton step of the part
under it has to be that of the whole.
"""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.model.rigid_motions import rotation_matrices
from bundle.solving.rounds.local_part import LocalPart
from bundle.solving.rounds.rest_prior import marginalize_rest
from tests.analysis.uncertainty.dense import Dense
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem, with_observations
from tests.solving.rounds.test_local import TIGHT, chain

SOLVE = {"num_rounds": 0, "rest": "marginal", **TIGHT}


def in_a_row(problem, width, seed=2):
    """Leave observations of `width` images or frames in a row per point."""
    unit = np.arange(problem.num_images)
    if problem.num_frames:
        unit = np.where(problem.image_frame >= 0, problem.image_frame, 100 + unit)
    unit = np.unique(unit, return_inverse=True)[1]
    first = np.random.default_rng(seed).integers(0, unit.max() + 2 - width, problem.num_points)
    offset = unit[problem.observation_image] - first[problem.observation_point]
    left = (offset >= 0) & (offset < width)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[left] for name in names})


def rig_chain(**changes):
    made = rig_problem(num_frames=8, rigs=(STEREO,), num_points=90, seed=4, **changes)
    return in_a_row(made, 3)


def prior_of(problem, named, *, factors=(), bounds=None, **settings):
    part = LocalPart(problem, named, factors, marginal=True)
    options = bundle.SolveOptions(**settings)
    return part, marginalize_rest(problem, part, options, bounds)


class Columns:
    """Columns of a dense form by ids, and which of them are free."""

    def __init__(self, problem, held, **loss):
        self.problem, self.dense = problem, Dense(problem, **loss)
        ids = {
            "image": problem.image_ids,
            "frame": problem.frame_ids,
            "camera": problem.camera_ids,
            "point": problem.point_ids,
        }
        self.at = {
            (kind, int(ids[kind][row]), k): column
            for (kind, row, k), column in self.dense.column.items()
            if kind != "sensor"
        }
        names = bundle.camera_models()["SIMPLE_RADIAL"]
        kept = [names.index("f"), names.index("k")]
        self.free = [
            name
            for name in self.at
            if name[:2] not in held and (name[0] != "camera" or name[2] in kept)
        ]

    def normal_equations(self, names):
        """J^T J and -J^T r by some columns, zero where this problem has none."""
        j = np.zeros((len(self.dense.residual), len(names)))
        for column, name in enumerate(names):
            if name in self.at:
                j[:, column] = self.dense.jacobian[:, self.at[name]]
        return j.T @ j, -j.T @ self.dense.residual


def left_perturbations(problem, prior, names):
    """Lambda and eta of a prior by (w, t) and parameters, at these names."""
    maps = []
    ids = {"image": problem.image_ids.tolist(), "frame": problem.frame_ids.tolist()}
    poses = {"image": problem.cam_from_world, "frame": problem.rig_from_world}
    rows = []
    for kind, key in prior.keys:
        if kind == "camera":
            size = len(prior.linearization_point[kind, key])
            maps.append(np.eye(size))
        else:
            turn = rotation_matrices(poses[kind][[ids[kind].index(key)], :4])[0]
            maps.append(np.kron(np.eye(2), turn))  # w = R phi, t = R rho
        rows += [(kind, key, k) for k in range(len(maps[-1]))]
    full = np.zeros((len(rows), len(rows)))
    first = 0
    for block in maps:
        size = len(block)
        full[first : first + size, first : first + size] = block
        first += size
    information, eta = full @ prior.Lambda @ full.T, full @ prior.eta
    place = {name: row for row, name in enumerate(rows)}
    unknown = [row for name, row in place.items() if name not in names]
    assert not information[unknown].any(), "of what is held, nothing is known"
    out, vector = np.zeros((len(names), len(names))), np.zeros(len(names))
    to = [column for column, name in enumerate(names) if name in place]
    of = [place[names[column]] for column in to]
    out[np.ix_(to, to)], vector[to] = information[np.ix_(of, of)], eta[of]
    return out, vector


def solve_scaled(matrix, vector):
    scale = 1 / np.sqrt(np.diag(matrix))
    return scale * np.linalg.lstsq(matrix * scale * scale[:, None], scale * vector, rcond=1e-13)[0]


CASES = {
    "own cameras": (lambda: chain(seed=3), {}),
    "one camera": (lambda: in_a_row(chain_of_one_camera(), 3), {}),
    "cauchy": (lambda: chain(seed=5), {"loss": "cauchy", "loss_scale": 1.0}),
    "sigmas": (
        lambda: with_sigmas(chain(seed=6)),
        {},
    ),
    "rig": (lambda: rig_chain(model="SIMPLE_RADIAL"), {}),
}


def chain_of_one_camera():
    return make_problem(num_images=9, num_points=90, shared=True, seed=8)


def with_sigmas(problem):
    sigmas = np.random.default_rng(0).uniform(0.5, 2, problem.num_observations)
    return problem.replace(observation_sigma=sigmas)


@pytest.mark.parametrize("name", CASES)
def test_a_step_of_the_part_is_that_of_the_whole(name):
    """Two images of the rest are fixed, so that nothing moves the world."""
    make, loss = CASES[name]
    problem = make()
    is_rig = problem.num_frames > 0
    unit = problem.image_frame if is_rig else np.arange(problem.num_images)
    named = problem.image_ids[np.isin(unit, [3])]
    fixed = problem.image_ids[np.isin(unit, [0, 7])]
    held = {("image", key) for key in fixed.tolist()}
    if is_rig:
        held |= {("frame", int(problem.frame_ids[row])) for row in (0, 7)}
    part, prior = prior_of(problem, named, fixed_image_ids=fixed.tolist(), **loss)
    assert prior.record.gauge_degrees == 0
    assert prior.record.num_images > 0 < prior.record.num_points
    whole = Columns(problem, held, **loss)
    matrix, vector = whole.normal_equations(whole.free)
    expected = dict(zip(whole.free, solve_scaled(matrix, vector), strict=True))
    near = Columns(part.problem, held, **loss)
    matrix, vector = near.normal_equations(near.free)
    information, eta = left_perturbations(part.problem, prior.factor, near.free)
    step = dict(zip(near.free, solve_scaled(matrix + information, vector + eta), strict=True))
    cameras = {("camera", int(key)) for key in problem.camera_ids[problem.image_camera[3:4]]}
    kept = {("image", int(key)) for key in named} | {
        ("point", int(key)) for key in problem.point_ids[part.seen]
    }
    names = [key for key in near.free if key[:2] in kept | cameras]
    assert len(names) > 60
    scale = max(abs(expected[key]) for key in names)
    for key in near.free:  # neighbours are kept, too
        assert step[key] == pytest.approx(expected[key], abs=1e-8 * scale, rel=1e-7), key
    dropped = dict(zip(near.free, solve_scaled(matrix, vector), strict=True))
    off = max(abs(dropped[key] - expected[key]) for key in names)
    assert off > 1e-3 * scale, "without the prior it is another step"


@pytest.mark.parametrize(
    ("fixed", "make", "degrees"),
    [
        ([], chain, 7),
        ([1], chain, 1),
        ([1, 2], chain, 0),
        ([5], chain, 1),
        ([], rig_chain, 6),
    ],
)
def test_the_world_that_nothing_holds_is_counted_and_held_by_the_neighbours(fixed, make, degrees):
    """The gauge's term moves no residual: it has no part in the information of anything else."""
    problem = make()
    named = problem.image_ids[[4, 5]]
    _, prior = prior_of(problem, named, fixed_image_ids=fixed)
    assert prior.holds_gauge
    assert prior.record.gauge_degrees == degrees
    size = prior.record.prior_size
    information = prior.factor.Lambda
    assert np.array_equal(information, information.T)
    scale = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1))
    values = np.linalg.eigvalsh(information / scale / scale[:, None])
    assert values[0] > -1e-12
    assert prior.record.prior_rank == (values > 1e-12).sum() <= size
    assert prior.record.prior_bytes == 8 * size**2


def test_nothing_moves_at_an_optimum(backend):
    problem = chain(num_points=80)
    whole = bundle.solve(problem, gauge="none", max_num_iterations=200, **TIGHT).problem
    for rest in ("fixed", "marginal"):
        settings = {**SOLVE, "rest": rest, "backend": backend}
        part = bundle.solve_rounds(whole, only_images=[5, 6], **settings).problem
        np.testing.assert_allclose(part.cam_from_world, whole.cam_from_world, atol=1e-7)
        np.testing.assert_allclose(part.points, whole.points, atol=1e-7)
        np.testing.assert_allclose(part.camera_params, whole.camera_params, rtol=1e-7)


def test_a_pull_moves_the_part_as_it_moves_the_whole(backend):
    """To first order where residuals are zero, so that Gauss-Newton's second derivatives are exact.

    A pull of half the size leaves a quarter of the difference, or less.
    """
    exact = make_problem(num_images=10, num_points=80, noise=0, perturbation=0, seed=7)
    optimum = in_a_row(exact, 3)
    fixed = {"fixed_image_ids": [1, 2], "gauge": "none", **TIGHT}
    shares = []
    for size in (4e-4, 2e-4):
        target = optimum.projection_centers[4] + [size, -size, size]
        pull = bundle.PositionFactor(("image", 5), target, 1e6)
        moved = bundle.solve(optimum, factors=[pull], max_num_iterations=200, **fixed).problem
        sees = np.unique(optimum.observation_point[optimum.observation_image == 4])
        far = np.abs(moved.points - optimum.points)[sees].max()
        off = {}
        for rest in ("fixed", "marginal"):
            settings = {**SOLVE, "rest": rest, "backend": backend, **fixed}
            result = bundle.solve_rounds(optimum, only_images=[5], factors=[pull], **settings)
            off[rest] = np.abs(result.problem.points - moved.points)[sees].max()
            assert len(result.factor_costs_after) == result.summary.num_factors == 1
        shares.append(off["marginal"] / far)
        assert off["fixed"] > 0.5 * far
    assert shares[0] < 0.05
    assert shares[1] < 0.6 * shares[0]


def test_it_comes_nearer_to_the_whole_than_a_fixed_rest():
    """New images off by much, in a model that was adjusted without their noise: the median."""
    ratios = []
    for seed in range(5):
        problem = chain(num_points=100, seed=20 + seed)
        settings = {"fixed_image_ids": [1, 10], "gauge": "none", **TIGHT}
        rng = np.random.default_rng(seed)
        start = bundle.solve(problem, max_num_iterations=100, **settings).problem
        in_named = np.isin(start.observation_image, [4, 5])
        xy = start.observation_xy + 2.0 * in_named[:, None] * rng.standard_normal(
            (len(in_named), 2)
        )
        pose = start.cam_from_world.copy()
        pose[[4, 5], 4:] += 0.02 * rng.standard_normal((2, 3))
        start = start.replace(observation_xy=xy, cam_from_world=pose)
        whole = bundle.solve(start, max_num_iterations=200, **settings).problem
        off = {}
        for rest in ("fixed", "marginal"):
            part = bundle.solve_rounds(
                start, only_images=[5, 6], **{**SOLVE, **settings, "rest": rest}
            )
            off[rest] = np.abs(part.problem.cam_from_world[4:6] - whole.cam_from_world[4:6]).max()
        ratios.append(off["marginal"] / off["fixed"])
    assert np.median(ratios) < 0.5


def test_what_is_not_named_keeps_its_bits(backend):
    problem = chain()
    result = bundle.solve_rounds(problem, only_images=[5, 6], backend=backend, **SOLVE)
    part, rest = result.part, result.part.rest
    moved = (result.problem.cam_from_world != problem.cam_from_world).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(moved), [4, 5])
    np.testing.assert_array_equal(
        np.flatnonzero((result.problem.camera_params != problem.camera_params).any(axis=1)), [4, 5]
    )
    seen = np.isin(problem.observation_image, [4, 5])
    points = np.unique(problem.observation_point[seen])
    left = (result.problem.points == problem.points).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(~left), points)
    assert (part.num_images, part.num_images_held, rest.num_images) == (2, 4, 4)
    assert rest.num_points <= problem.num_points - len(points)
    assert rest.cost_after > 0
    assert result.summary.num_factors == 0
    assert result.factor_costs_after.size == 0


def test_rigs_move_with_their_frames(backend):
    problem = rig_chain()
    named = problem.image_ids[problem.image_frame == 4]
    result = bundle.solve_rounds(problem, only_images=named[:1], backend=backend, **SOLVE)
    moved = (result.problem.rig_from_world != problem.rig_from_world).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(moved), [4])
    assert result.problem.sensor_from_rig.tobytes() == problem.sensor_from_rig.tobytes()
    assert result.part.num_images == len(named) == 2
    assert result.part.rest.gauge_degrees == 6


@pytest.mark.parametrize("named", ["*", "1"])
def test_all_images_or_one(named):
    problem = chain()
    result = bundle.solve_rounds(problem, only_images=named, **SOLVE)
    assert result.summary.is_solution_usable
    if named == "*":
        whole = bundle.solve(problem, **TIGHT)
        assert result.part.rest.prior_size == 0
        assert result.summary.final_cost == pytest.approx(whole.summary.final_cost, rel=1e-12)


def test_a_rest_without_a_common_point_speaks_through_a_common_camera_only():
    problem = chain_of_one_camera()
    apart = [p for p in range(90) if p % 2]
    left = np.where(np.isin(problem.observation_point, apart), problem.observation_image < 4,
                    problem.observation_image >= 4)  # fmt: skip
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    problem = problem.replace(**{name: getattr(problem, name)[left] for name in names})
    _, prior = prior_of(problem, [1, 2, 3, 4])
    assert prior.factor.keys == (("camera", 1),)
    assert not prior.holds_gauge, "the part has a world of its own"
    result = bundle.solve_rounds(problem, only_images=[1, 2, 3, 4], **SOLVE)
    whole = bundle.solve(problem, **TIGHT)
    assert result.problem.camera_params[0, 0] == pytest.approx(
        whole.problem.camera_params[0, 0], rel=1e-3
    )
    held = bundle.solve_rounds(problem, only_images=[1, 2, 3, 4], fixed_camera_ids=[1], **SOLVE)
    assert held.part.rest.prior_size == 0


def test_points_without_parallax_and_components_apart_have_no_influence():
    """A pair of images that sees points of its own, and points that one image sees twice."""
    problem = chain(num_points=80)
    _, expected = prior_of(problem, [5])
    alone = chain(num_points=30, num_images=3, seed=9)
    first = problem.num_images
    twice = np.flatnonzero(problem.observation_image == 8)[:3]  # an image of the rest
    points = problem.num_points + alone.num_points
    arrays = {
        "cam_from_world": [problem.cam_from_world, alone.cam_from_world],
        "image_camera": [problem.image_camera, alone.image_camera + first],
        "camera_params": [problem.camera_params, alone.camera_params],
        "camera_sizes": [problem.camera_sizes, alone.camera_sizes],
        "points": [problem.points, alone.points, problem.points[problem.observation_point[twice]]],
        "observation_image": [
            problem.observation_image,
            alone.observation_image + first,
            [8, 8] * 3,
        ],
        "observation_point": [
            problem.observation_point,
            alone.observation_point + problem.num_points,
            points + np.repeat(np.arange(3), 2),
        ],
        "observation_xy": [
            problem.observation_xy,
            alone.observation_xy,
            np.repeat(problem.observation_xy[twice], 2, axis=0) + 1.0,
        ],
    }
    both = bundle.Problem(
        **{name: np.concatenate(rows) for name, rows in arrays.items()},
        camera_models=("SIMPLE_RADIAL",) * (first + 3),
        image_ids=np.arange(1, first + 4),
        camera_ids=np.arange(1, first + 4),
    )
    _, prior = prior_of(both, [5])
    assert prior.record.num_points_without_parallax == 3
    assert prior.record.num_images == expected.record.num_images + 3
    assert prior.factor.keys == expected.factor.keys
    diagonal = np.diag(expected.factor.Lambda)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1))
    off = (prior.factor.Lambda - expected.factor.Lambda) / scale / scale[:, None]
    assert np.abs(off).max() < 1e-9
    np.testing.assert_allclose(prior.factor.eta / scale, expected.factor.eta / scale, atol=1e-6)


def test_eta_is_none_where_lambda_is_none():
    """Rounding along what the rest does not know would be a pull of its own.

    Lambda's unknown directions are known to rounding over the least eigenvalue of the others, 1e-10
    at worst, so that one scene proves nothing: without the projection the median is 3e-11.
    """
    pulls = []
    for seed in range(7):
        at = Similarity(1.0, np.eye(3), np.array([100.0, 0, 0]))
        _, prior = prior_of(moved(chain(seed=seed), at), [5])
        information, eta = np.asarray(prior.factor.Lambda), np.asarray(prior.factor.eta)
        known = np.diag(information) > 0
        root = np.sqrt(np.diag(information)[known])
        values, vectors = np.linalg.eigh(information[np.ix_(known, known)] / root / root[:, None])
        unknown = vectors[:, values < 1e-11 * values[-1]]
        assert unknown.shape[1] >= 6
        eta = eta[known] / root
        pulls.append(np.linalg.norm(unknown.T @ eta) / np.linalg.norm(eta))
    assert np.median(pulls) < 1e-12


def test_where_nothing_is_left_out_the_neighbours_hold_the_world_alone():
    problem = make_problem(num_images=3, num_points=40, model="SIMPLE_RADIAL")
    _, prior = prior_of(problem, [1])
    assert prior.record.num_points == 0
    assert prior.record.gauge_degrees == prior.record.prior_rank == 7
    result = bundle.solve_rounds(problem, only_images=[1], **SOLVE)
    whole = bundle.solve(problem, **TIGHT)
    assert result.summary.final_cost == pytest.approx(whole.summary.final_cost, rel=1e-9)


def test_points_that_one_image_sees_once_are_no_part_of_the_rest():
    problem = chain()
    image, point = problem.observation_image, problem.observation_point
    single = point < 30
    left = ~single | (np.diff(point, prepend=-1) != 0)
    fewer = with_observations(problem, left)
    _, prior = prior_of(fewer, [5])
    seen_by_five = np.unique(point[(image == 4) & ~single])
    others = np.setdiff1d(np.arange(30, problem.num_points), seen_by_five)
    assert prior.record.num_points == len(others)
    assert prior.record.num_points_without_parallax == 0


def test_factors_of_the_rest_go_into_the_prior():
    """As the dense form has them; one of a neighbour takes part itself."""
    problem = chain()
    centers = problem.projection_centers
    given = [
        bundle.PositionFactor(("image", 1), centers[0] + 0.01, 1e6),
        bundle.PositionFactor(("image", 10), centers[9] - 0.01, 1e6),
        bundle.PositionFactor(("image", 6), centers[5], 1e6),
    ]
    part, prior = prior_of(problem, [5], factors=given)
    assert part.factors == (given[2],)
    assert part.factors_of_rest == tuple(given[:2])
    _, without = prior_of(problem, [5], factors=given[2:])
    assert prior.record.gauge_degrees < without.record.gauge_degrees == 4
    more = np.linalg.eigvalsh(np.asarray(prior.factor.Lambda)).sum()
    assert more != np.linalg.eigvalsh(np.asarray(without.factor.Lambda)).sum()
    result = bundle.solve_rounds(problem, only_images=[5], factors=given, **SOLVE)
    assert len(result.factor_costs_after) == 1


def test_rounds_and_checkpoints(tmp_path):
    problem = chain(num_points=200)
    xy = problem.observation_xy.copy()
    xy[::13] += 60.0
    problem = problem.replace(observation_xy=xy)
    settings = {"only_images": [4, 5, 6], "rest": "marginal", "loss": "cauchy", "max_error": 6.0,
                "num_rounds": 3, "num_threads": 1, "deterministic": True}  # fmt: skip
    plain = bundle.solve_rounds(problem, **settings)
    assert plain.rounds[0].num_observations_removed > 5
    path = tmp_path / "run.ckpt"
    kept = bundle.solve_rounds(problem, checkpoint=path, checkpoint_interval=3, **settings)
    again = bundle.solve_rounds(problem, resume=path, checkpoint_interval=3, **settings)
    assert again.problem.points.tobytes() == kept.problem.points.tobytes()
    assert again.part == kept.part
    with pytest.raises(bundle.InputError, match="rest"):
        bundle.solve_rounds(
            problem, resume=path, checkpoint_interval=3, **{**settings, "rest": "fixed"}
        )


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"rest": "marginal"}, "^rest: marginal is valid only with only_images"),
        ({"rest": "free", "only_images": [1]}, "^rest: expected one of fixed, marginal"),
        (
            {"rest": "marginal", "only_images": [5], "constraints": ["cameras *: f fixed"]},
            "^rest: ",
        ),
    ],
)
def test_what_is_refused(settings, named):
    with pytest.raises(bundle.InputError, match=named + r"[^\n]*$"):
        bundle.solve_rounds(chain(), num_rounds=0, **settings)


def test_a_wide_prior_is_the_same_to_both_backends():
    """Its matrix products are of another kind than those of small factors."""
    problem = in_a_row(make_problem(num_images=24, num_points=200, perturbation=1e-3), 8)
    ends = []
    for backend in ("ceres", "fused"):
        result = bundle.solve_rounds(problem, only_images=[12], backend=backend, **SOLVE)
        assert result.part.rest.prior_size > 100
        ends.append(result)
    np.testing.assert_allclose(ends[0].problem.points, ends[1].problem.points, atol=1e-6)
    assert ends[0].summary.final_cost == pytest.approx(ends[1].summary.final_cost, rel=1e-9)


def test_too_large_a_prior_is_refused_beforehand(monkeypatch):
    monkeypatch.setattr("bundle._core.available_memory", lambda: 1e4)
    with pytest.raises(bundle.InputError, match=r"^rest: marginal needs [0-9.]+ kB [^\n]*fewer"):
        bundle.solve_rounds(chain(), only_images=[5], **SOLVE)


def test_nothing_moves_at_an_optimum_far_from_the_origin_which_is_refused_farther_out():
    problem = chain(num_points=80)
    near = bundle.solve(problem, gauge="none", max_num_iterations=200, **TIGHT).problem
    size = np.median(np.linalg.norm(near.points - np.median(near.projection_centers, 0), axis=1))

    def at(distance):
        shift = np.array([0.6, -0.8, 0]) * distance * size
        poses = near.cam_from_world.copy()
        poses[:, 4:] -= np.einsum("nij,j->ni", rotation_matrices(poses[:, :4]), shift)
        return near.replace(cam_from_world=poses, points=near.points + shift)

    problem = at(400)
    for tolerance in (SOLVE["function_tolerance"], 1e-10):
        settings = SOLVE | {"function_tolerance": tolerance}
        found = bundle.solve_rounds(problem, only_images=[5], **settings).problem
        np.testing.assert_allclose(found.points, problem.points, atol=1e-6 * size)
    with pytest.raises(bundle.InputError, match=r"^rest: [^\n]*origin[^\n]*$"):
        bundle.solve_rounds(at(600), only_images=[5], **SOLVE)


@pytest.mark.parametrize("refine", [("points",), ("poses",), ("poses", "points"), ("focal",)])
def test_what_is_not_refined_is_no_part_of_the_prior(refine):
    problem = chain()
    _, prior = prior_of(problem, [5], refine=refine)
    kinds = set() if prior.factor is None else {kind for kind, _ in prior.factor.keys}
    assert kinds == {
        *(["image"] if "poses" in refine else []),
        *(["camera"] if "focal" in refine else []),
    }
    result = bundle.solve_rounds(problem, only_images=[5], refine=refine, **SOLVE)
    assert result.summary.is_solution_usable


def test_the_command(run, tmp_path):
    bundle.save(chain(), tmp_path / "model")
    report = tmp_path / "report.json"
    line = ("refine", tmp_path / "model", "-o", tmp_path / "out", "--json", report)
    code, out, _ = run(*line, "--only-images", "4-5", "--rest", "marginal", "--verbose")
    assert code == 0
    found = json.loads(report.read_text())
    assert found["options"]["rest"] == "marginal"
    rest = found["part"]["rest"]
    assert rest["gauge_degrees"] == 7
    assert rest["prior_size"] > 0
    assert f"{rest['prior_size']} unknowns" in out
    code, _, _ = run(*line, "--only-images", "4-5")
    assert code == 0
    found = json.loads(report.read_text())
    assert (found["options"]["rest"], found["part"]["rest"]) == ("fixed", None)
    code, _, err = run(*line, "--rest", "marginal")
    assert code == 2
    assert err.startswith("error: --rest: ")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_deterministic_priors_do_not_depend_on_threads(seed):
    problem = make_problem(num_images=8, num_points=120, seed=seed, track=4)
    named = problem.image_ids[2:5].tolist()
    ends = {
        threads: bundle.solve_rounds(
            problem,
            num_rounds=0,
            only_images=named,
            rest="marginal",
            deterministic=True,
            num_threads=threads,
            max_num_iterations=5,
        ).problem
        for threads in (1, 2)
    }
    for name in ("points", "cam_from_world", "camera_params"):
        assert getattr(ends[1], name).tobytes() == getattr(ends[2], name).tobytes()
