"""Covariances of factor graphs: the same problem both ways, dense algebra, gauges, refusals."""

import pickle

import numpy as np
import pytest

import bundle
from bundle.graphs.factors.null_space import find_null_space
from bundle.model.rigid_motions import rotation_matrices
from tests.graphs.factors import both_ways
from tests.graphs.pose_graphs import graphs


def dense(graph, held=()):
    """H^-1 of the free coordinates by dense algebra, by key; ``held``: further coordinates."""
    from bundle import _core

    residual, jacobian = _core.graph_jacobian(*graph.core())
    sizes = [len(variable.coordinates) for variable in graph.variables.values()]
    constant = np.concatenate(
        [
            np.array(v.held or (False,) * n, bool)
            for v, n in zip(graph.variables.values(), sizes, strict=True)
        ]
    )
    constant[list(held)] = True
    inverse = np.zeros((len(constant),) * 2)
    free = np.flatnonzero(~constant)
    inverse[np.ix_(free, free)] = np.linalg.inv(jacobian[:, free].T @ jacobian[:, free])
    begin = np.cumsum([0, *sizes])
    place = {key: slice(begin[k], begin[k + 1]) for k, key in enumerate(graph.keys)}
    return inverse, place, residual, jacobian


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("gauge", ["first", "inner"])
@pytest.mark.parametrize("scale", ["unit", "sigma0"])
def test_a_pose_graph_has_the_covariance_of_its_file(dimension, gauge, scale, tmp_path):
    solved = bundle.solve(graphs.loop(dimension, num_poses=12, num_closures=5)).problem
    bundle.save(solved, tmp_path / "x.g2o")
    solved = bundle.load(tmp_path / "x.g2o")
    pairs = [(2, 9), (5, 4), (0, 11)]
    theirs = bundle.covariance(solved, gauge=gauge, scale=scale, relative=pairs)
    graph = both_ways.of_pose_graph(solved)
    free = bundle.FactorGraph()
    for key, variable in graph.variables.items():
        free.add_variable(key, variable.value, variable.manifold)
    for factor in graph.factors:
        free.add_factor(factor)
    ours = bundle.covariance(free, gauge=gauge, scale=scale, relative=pairs)
    close = {"rtol": 1e-9, "atol": 1e-9 * np.abs(theirs.pose_covariance).max()}
    found = np.array([ours.variable(int(key)) for key in theirs.pose_ids])
    np.testing.assert_allclose(found, theirs.pose_covariance, **close)
    np.testing.assert_allclose(
        [ours.relative(*pair) for pair in pairs], theirs.relative_covariance, **close
    )
    np.testing.assert_allclose((ours.sigma0, ours.dof), (theirs.sigma0, theirs.dof), rtol=1e-9)
    assert ours.num_gauge_freedoms == (3 if dimension == 2 else 6)


def scene(seed=3):
    scene = bundle.synthesize(bundle.SceneOptions(num_images=6, num_points=40, seed=seed))
    return bundle.solve(scene.problem, gauge="none", cheirality="algebraic").problem


def test_reprojections_have_the_covariance_of_their_problem():
    problem = scene()
    fixed = tuple(problem.image_ids[:2].tolist())
    pairs = [tuple(problem.image_ids[[3, 5]].tolist())]
    options = {"fixed_image_ids": fixed, "cheirality": "algebraic"}
    theirs = bundle.covariance(problem, gauge="none", relative=pairs, **options)
    graph = both_ways.of_problem(problem, fixed_images=fixed, held=(1, 2))
    keys = [(("image", a), ("image", b)) for a, b in pairs]
    ours = bundle.covariance(graph, gauge="none", relative=keys)

    def left(rotation):
        """From X Exp(d) to the left perturbation of the rotation, then the translation."""
        return np.kron(np.eye(2), rotation)

    for k, image in enumerate(problem.image_ids.tolist()):
        turn = left(rotation_matrices(problem.cam_from_world[k : k + 1, :4])[0])
        found = turn @ ours.variable(("image", image)) @ turn.T
        np.testing.assert_allclose(
            found, theirs.pose_covariance[k], rtol=1e-7, atol=1e-9 * np.abs(found).max()
        )
    for k, point in enumerate(theirs.point_ids.tolist()):
        found = ours.variable(("point", point))
        np.testing.assert_allclose(found, theirs.point_covariance[k], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose((ours.sigma0, ours.dof), (theirs.sigma0, theirs.dof), rtol=1e-9)
    rotations = rotation_matrices(problem.cam_from_world[[5, 3], :4])
    turn = left(rotations[0] @ rotations[1].T)
    found = turn @ ours.relative(*keys[0]) @ turn.T
    # the left perturbation of B = X_b X_a^-1 moves its translation with the rotation's lever arm
    np.testing.assert_allclose(
        np.diag(found)[:3], np.diag(theirs.relative_covariance[0])[:3], rtol=1e-7
    )


def landmarks(*, ranges_only=False):
    """Poses, velocities, a partly fixed bias and landmarks, with losses."""
    rng = np.random.default_rng(7)
    graph = bundle.FactorGraph()
    graph.add_variable("bias", [0.1, -0.2], fixed=[1])
    graph.add_factor(bundle.PriorFactor("bias", [0, 0], 2.0))
    for k in range(4):
        graph.add_variable(f"x{k}", [k, 0.1 * k, 0.05 * k], "se2")
        graph.add_variable(f"r{k}", 0.1 * k, "so2")
    graph.add_variable("m", [2.0, 1.0])
    for k in range(3):
        a, b = f"x{k}", f"x{k + 1}"
        graph.add_factor(
            bundle.BetweenFactor(a, b, [1, 0.1, 0.04], np.diag([4, 9, 16.0]), loss="cauchy")
        )
        graph.add_factor(bundle.BetweenFactor(f"r{k}", f"r{k + 1}", 0.1, 5.0))
    graph.add_factor(bundle.PriorFactor("r0", 0.0, 1.0))

    def landmark(values):
        pose, point, bias = values
        c, s = np.cos(pose[2]), np.sin(pose[2])
        d = point - pose[:2]
        rows = np.array([[c, s], [-s, c]])
        error = rows @ d + np.array([bias[0], 0.0])
        into_pose = np.column_stack([-np.eye(2), [error[1], -(error[0] - bias[0])]])
        jacobians = [into_pose, rows, np.array([[1.0, 0], [0, 0]])]
        if ranges_only:
            return error[:1], [j[:1] for j in jacobians]
        return error, jacobians

    for k in range(1 if ranges_only else 4):
        graph.add_factor(bundle.FunctionFactor((f"x{k}", "m", "bias"), landmark))
    _ = rng
    return graph


@pytest.mark.parametrize("dimension", [2, 3])
def test_covariances_of_two_poses_are_those_of_dense_algebra(dimension):
    """In two components, one of which a constant pose holds."""
    graph = bundle.FactorGraph()
    for part in range(2):
        one = both_ways.of_pose_graph(bundle.solve(graphs.loop(dimension, num_poses=6)).problem)
        for key, variable in one.variables.items():
            graph.add_variable(
                6 * part + key, variable.value, variable.manifold, fixed=key == 3 and part == 1
            )
        for f in one.factors:
            graph.add_factor(
                bundle.BetweenFactor(6 * part + f.a, 6 * part + f.b, f.measurement, f.information)
            )
    pairs = [(1, 4), (5, 0), (7, 10), (8, 9), (10, 6)]
    size = 3 if dimension == 2 else 6
    first, place, _, jacobian = dense(graph, range(size))
    free = np.setdiff1d(np.arange(12 * size), np.arange(9 * size, 10 * size))
    inner = np.zeros_like(first)
    inner[np.ix_(free, free)] = np.linalg.pinv(
        jacobian[:, free].T @ jacobian[:, free], rcond=1e-10, hermitian=True
    )
    for gauge, expected in (("first", first), ("inner", inner)):
        found = bundle.covariance(graph, relative=pairs, gauge=gauge)
        for a, b in pairs:
            np.testing.assert_allclose(
                found.cross_covariances[a, b],
                expected[place[a], place[b]],
                rtol=1e-8, atol=1e-8 * expected.max(),
            )  # fmt: skip
        np.testing.assert_allclose(found.variable(2), expected[place[2], place[2]], rtol=1e-7)
        scaled = bundle.covariance(graph, relative=pairs, gauge=gauge, scale="sigma0")
        np.testing.assert_allclose(
            scaled.cross_covariances[1, 4],
            found.sigma0**2 * found.cross_covariances[1, 4],
        )
        np.testing.assert_array_equal(found.variable(9), 0)


def test_any_number_of_components_has_covariances():
    graph, information = bundle.FactorGraph(), np.diag([4.0, 9.0, 16.0])
    keys = list(range(1000, 798, -1))
    for key in keys:
        graph.add_variable(key, [0.0, 0.0, 0.0], "se2")
    for a, b in zip(keys[::2], keys[1::2], strict=True):
        graph.add_factor(bundle.BetweenFactor(a, b, [0.0, 0, 0], information))
    found = bundle.covariance(graph, of=[799, 1000])
    assert found.num_gauge_freedoms == 303 and list(found.covariances) == [799, 1000]
    np.testing.assert_allclose(found.variable(799), np.linalg.inv(information), atol=1e-12)
    np.testing.assert_array_equal(found.variable(1000), 0)
    (kind,) = bundle.chi2_kinds(graph)
    assert (kind.kind, kind.count, kind.degrees) == ("BetweenFactor", 101, 0)
    with pytest.raises(bundle.InputError, match=r"^relative: .*\b999\b.*\b998\b"):
        bundle.covariance(graph, relative=[(999, 998)])


def test_mixed_variables_are_those_of_dense_algebra():
    graph = landmarks()
    space = find_null_space(graph)
    assert space.nullity == space.gauge == 3 and space.is_exact
    held = np.flatnonzero(space.held() & ~space.constant)
    inverse, place, _, jacobian = dense(graph, held)
    pairs = [("x1", "x3"), ("r1", "r2")]
    cov = bundle.covariance(graph, relative=pairs)
    for key, where in place.items():
        np.testing.assert_allclose(cov.variable(key), inverse[where, where], atol=1e-9, rtol=1e-9)
    np.testing.assert_allclose(
        cov.cross_covariances["x1", "x3"], inverse[place["x1"], place["x3"]], atol=1e-9
    )
    pseudo = np.linalg.pinv(np.delete(jacobian, 1, axis=1).T @ np.delete(jacobian, 1, axis=1))
    inner = bundle.covariance(graph, gauge="inner", relative=pairs)
    whole = np.insert(np.insert(pseudo, 1, 0, axis=0), 1, 0, axis=1)
    for key, where in place.items():
        np.testing.assert_allclose(inner.variable(key), whole[where, where], atol=1e-9)
    for pair in pairs:
        np.testing.assert_allclose(inner.relative(*pair), cov.relative(*pair), atol=1e-9)
    turn = inverse[place["r1"], place["r1"]] + inverse[place["r2"], place["r2"]]
    turn = turn - 2 * inverse[place["r1"], place["r2"]]
    np.testing.assert_allclose(cov.relative("r1", "r2"), turn, rtol=1e-9)


def test_some_keys_pickles_and_files(tmp_path):
    cov = bundle.covariance(landmarks(), of=["m", "x2"], relative=[("x0", "x2")])
    assert list(cov.covariances) == ["m", "x2"] and cov.variable("m").shape == (2, 2)
    again = pickle.loads(pickle.dumps(cov))
    np.testing.assert_array_equal(again.variable("x2"), cov.variable("x2"))
    cov.save(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as data:
        assert data["keys"].tolist() == ["m", "x2"]
        np.testing.assert_array_equal(data["covariance_0"], cov.variable("m"))
        assert data["relative_keys"].tolist() == [["x0", "x2"]]


def test_the_result_of_a_graph_points_to_the_graph_with_its_values():
    graph = landmarks()
    result = graph.solve()
    with pytest.raises(bundle.InputError, match=r"graph\.with_values"):
        bundle.covariance(result)
    found = bundle.covariance(graph.with_values(result.values))
    assert found.variable("m").shape == (2, 2)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"of": ["y"]}, r"^of: there is no variable 'y'"),
        ({"of": ["mm"]}, r"^of: there is no variable 'mm'; did you mean m"),
        ({"relative": [("x0", "y")]}, r"^relative: there is no variable 'y'"),
        ({"relative": [("x0", "x0")]}, r"^relative: expected two different"),
        ({"relative": [("x0", "m")]}, r"^relative: variable 'x0' and variable 'm'"),
        ({"relative": ["x0"]}, r"^relative: expected pairs"),
        ({"gauge": "two_cameras"}, r"^gauge: expected one of first, inner, none"),
        ({"gauge": "none"}, r"^gauge: expected factors"),
        ({"robust": "sandwich"}, r"^robust: expected only with"),
    ],
)
def test_wrong_arguments_are_one_line(given, words):
    with pytest.raises(bundle.InputError, match=words) as error:
        bundle.covariance(landmarks(), **given)
    assert "\n" not in str(error.value)


def test_an_open_landmark_is_named():
    with pytest.raises(bundle.InputError, match=r"variable 'm' with an undetermined direction"):
        bundle.covariance(landmarks(ranges_only=True))
    empty = bundle.FactorGraph()
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one variable, found 0"):
        bundle.covariance(empty)
    held = bundle.FactorGraph()
    held.add_variable("x", [0.0], fixed=True)
    held.add_factor(bundle.PriorFactor("x", [1.0], 1))
    poses = bundle.FactorGraph()
    for key in "ab":
        poses.add_variable(key, [0.0, 0, 0], "se2", fixed=True)
    poses.add_factor(bundle.BetweenFactor("a", "b", [0.0, 0, 0], 1))
    for graph in (held, poses):
        with pytest.raises(bundle.InputError, match=r"^graph: expected a free coordinate"):
            bundle.covariance(graph)


def test_a_gauge_is_held_per_component():
    graph = landmarks()
    for k in range(3):
        graph.add_variable(("other", k), [k, 0, 0], "se2")
    for k in range(2):
        graph.add_factor(bundle.BetweenFactor(("other", k), ("other", k + 1), [1, 0, 0], 1.0))
    space = find_null_space(graph)
    assert space.nullity == space.gauge == 6
    cov = bundle.covariance(graph)
    assert not cov.variable("x0").any() and not cov.variable(("other", 0)).any()
    assert cov.variable("x1").any()


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("is_lens_free", [True, False])
def test_a_model_in_any_unit_has_the_covariances_of_its_factor_graph(unit, is_lens_free):
    given = bundle.synthesize(scene="orbit", num_images=6, num_points=250, seed=5).problem
    poses = given.cam_from_world * np.array([1, 1, 1, 1, unit, unit, unit])
    options = {"refine": ("poses", "points", *(("focal", "extra") if is_lens_free else ()))}
    options |= {"cheirality": "algebraic"}
    given = given.replace(cam_from_world=poses, points=given.points * unit)
    problem = bundle.solve(given, **options).problem
    graph = both_ways.of_problem(problem, held=(1, 2) if is_lens_free else True)
    ids = problem.image_ids.tolist()
    theirs = bundle.covariance(problem, gauge="inner", relative=[(ids[0], ids[3])], **options)
    ours = bundle.covariance(
        graph, gauge="inner", relative=[(("image", ids[0]), ("image", ids[3]))]
    )
    close = {"rtol": 1e-7, "atol": 1e-7 * np.abs(theirs.point_covariance).max()}
    for key in problem.point_ids.tolist():
        np.testing.assert_allclose(ours.variable(("point", key)), theirs.point(key), **close)
    for key, turn in zip(ids, rotation_matrices(problem.cam_from_world[:, :4]), strict=True):
        into = np.kron(np.eye(2), turn)  # X Exp(d) in the axes of the camera
        sigmas = np.sqrt(np.diag(theirs.pose(key)))
        found = into @ ours.variable(("image", key)) @ into.T
        np.testing.assert_allclose(
            found / np.outer(sigmas, sigmas), theirs.pose(key) / np.outer(sigmas, sigmas), atol=1e-6
        )


def test_a_monocular_scene_has_a_gauge_of_seven():
    problem = scene()
    graph = both_ways.of_problem(problem, held=(1, 2))
    space = find_null_space(graph)
    assert space.nullity == space.gauge == 7 and int(space.held().sum()) - 7 == 2 * len(
        problem.camera_ids
    )
    theirs = bundle.covariance(problem, gauge="inner", cheirality="algebraic")
    ours = bundle.covariance(graph, gauge="inner")
    np.testing.assert_allclose((ours.sigma0, ours.dof), (theirs.sigma0, theirs.dof), rtol=1e-9)
    # angles between rays do not depend on the gauge
    np.testing.assert_allclose(
        ours.variable(("camera", int(problem.camera_ids[0])))[0, 0],
        theirs.camera_covariance[0, 0, 0],
        rtol=1e-6,
    )
