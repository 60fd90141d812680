"""Factors: conventions against matrices, functions of the user, gradient checks, bad input."""

import pickle

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core

EYE = [0.0, 0, 0, 1]


def matrix(manifold, x):
    if manifold == "se2":
        c, s = np.cos(x[2]), np.sin(x[2])
        return np.array([[c, -s, x[0]], [s, c, x[1]], [0, 0, 1]])
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = Rotation.from_quat(x[:4]).as_matrix(), x[4:]
    return m


def hat(manifold, d):
    if manifold == "se2":
        return np.array([[0, -d[2], d[0]], [d[2], 0, d[1]], [0, 0, 0]])
    m = np.zeros((4, 4))
    m[:3, :3], m[:3, 3] = np.cross(np.eye(3), d[:3]), d[3:]
    return m


def random_pose(rng, manifold):
    x = rng.standard_normal({"se2": 3, "se3": 7}[manifold])
    if manifold == "se3":
        x[:4] /= np.linalg.norm(x[:4])
    return x


@pytest.mark.parametrize("manifold", ["se2", "se3"])
def test_steps_and_errors_are_those_of_matrices(manifold):
    rng = np.random.default_rng(1)
    for _ in range(5):
        a, b = random_pose(rng, manifold), random_pose(rng, manifold)
        d = rng.standard_normal(len(_core.local_coordinates(manifold, a, b)))
        moved = _core.retract(manifold, a, d)
        expected = matrix(manifold, a) @ expm(hat(manifold, d))
        np.testing.assert_allclose(matrix(manifold, moved), expected, atol=1e-13)
        z = random_pose(rng, manifold)
        graph = bundle.FactorGraph()
        graph.add_variable("a", a, manifold)
        graph.add_variable("b", b, manifold)
        graph.add_factor(bundle.BetweenFactor("a", "b", z, 4.0))
        inverse = np.linalg.inv
        error = logm(
            inverse(matrix(manifold, z)) @ inverse(matrix(manifold, a)) @ matrix(manifold, b)
        ).real
        if manifold == "se2":
            e = np.array([error[0, 2], error[1, 2], error[1, 0]])
        else:
            e = np.array([error[2, 1], error[0, 2], error[1, 0], *error[:3, 3]])
        assert graph.cost() == pytest.approx(0.5 * 4 * e @ e, rel=1e-10)


def project(values):
    """A pinhole camera of one's own: residual in pixels against (300, 250)."""
    pose, point = values
    rotation = Rotation.from_quat(pose[:4]).as_matrix()
    x, y, z = rotation @ point + pose[4:]
    residual = np.array([500 * x / z + 320, 500 * y / z + 240])
    by_point = 500 / z * np.array([[1, 0, -x / z], [0, 1, -y / z]])
    # X Exp(d): R (I + [w]x) p + t + R v
    by_pose = by_point @ rotation @ np.hstack([-np.cross(np.eye(3), point), np.eye(3)])
    return residual, [by_pose, by_point @ rotation]


def two_views(own):
    """Two poses, the first fixed and the distance held by a position, over nine points."""
    rng = np.random.default_rng(2)
    poses = [np.array([*EYE, 0, 0, 4]), np.array([0, 0.1, 0, 0.995, -1, 0.1, 4.2])]
    poses[1][:4] /= np.linalg.norm(poses[1][:4])
    points = rng.uniform(-1, 1, (9, 3))
    graph = bundle.FactorGraph()
    graph.add_variable("camera", [500.0, 320, 240], fixed=True)
    for i, pose in enumerate(poses):
        start = _core.retract("se3", pose, 0.02 * i * rng.standard_normal(6))
        graph.add_variable(("pose", i), start, "se3", fixed=i == 0)
    center = -matrix("se3", poses[1])[:3, :3].T @ poses[1][4:]
    graph.add_factor(bundle.PositionFactor(("pose", 1), center, 1e4))
    for j, point in enumerate(points):
        graph.add_variable(("point", j), point + 0.05 * rng.standard_normal(3))
        for i, pose in enumerate(poses):
            seen = project([pose, point])[0] + 0.3 * rng.standard_normal(2)
            keys = [("pose", i), ("point", j)]
            if own:
                graph.add_factor(bundle.FunctionFactor(
                    keys, lambda values, seen=seen: (project(values)[0] - seen, project(values)[1])
                ))  # fmt: skip
            else:
                graph.add_factor(
                    bundle.ReprojectionFactor(keys[0], "camera", keys[1], seen, "SIMPLE_PINHOLE")
                )
    return graph


def test_a_function_ends_where_the_built_in_factor_does():
    tight = {"function_tolerance": 1e-16, "gradient_tolerance": 0, "parameter_tolerance": 0}
    built_in, own = (two_views(own).solve(**tight) for own in (False, True))
    assert built_in.summary.final_cost < 0.1 * built_in.summary.initial_cost
    assert own.summary.final_cost == pytest.approx(built_in.summary.final_cost, rel=1e-9)
    for key, value in built_in.values.items():  # the cost at a minimum fixes half of its digits
        np.testing.assert_allclose(own.values[key], value, atol=1e-7)
    assert own.summary.num_threads_used == 1


@pytest.mark.parametrize("own", [True, False])
def test_right_jacobians_are_not_accused(own):
    """Tangent coordinates are zero at the start, which says nothing about steps or rounding."""
    report = two_views(own).check_gradients(num_samples=1)
    assert report and len(report.reports) == 19


def test_a_wrong_jacobian_is_found_and_its_factor_named():
    graph = two_views(own=True)

    def left(values):  # as if the pose moved to Exp(d) X
        residual, (by_pose, by_point) = project(values)
        return residual, [by_pose * [1, 1, 1, 1, 1, -1], by_point]

    wrong = bundle.FunctionFactor([("pose", 1), ("point", 0)], left)
    graph.add_factor(wrong)
    assert graph.check_gradients(graph.factors[1])
    report = graph.check_gradients(wrong)
    assert not report and len(report.wrong) == 1
    assert "factor 19" in str(report) and "translation z" in str(report)


def chain(function=None, keys=("a", "b")):
    graph = bundle.FactorGraph()
    graph.add_variable("a", [1.0, 2.0])
    graph.add_variable("b", [*EYE, 0, 0, 1], "se3")
    if function is not None:
        graph.add_factor(bundle.FunctionFactor(keys, function))
    return graph


def answer(residual=(1.0, 2.0), rows=2, columns=(2, 6), count=2):
    return lambda _: (residual, [np.zeros((rows, columns[i])) for i in range(count)])


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (answer(columns=(2, 7)), ["factor 0", "variable 'b'", "(2, 6)", "(2, 7)"]),
        (answer(rows=3), ["factor 0", "variable 'a'", "(2, 2)", "(3, 2)"]),
        (answer(count=1), ["factor 0", "2 Jacobians", "found 1"]),
        (answer(residual=(np.nan, 1.0)), ["factor 0", "'a', 'b'", "finite residual"]),
        (answer(residual=()), ["factor 0", "at least one"]),
        (lambda values: values[0], ["factor 0", "(residual, list of Jacobians)", "ndarray"]),
        (
            lambda _: ([1.0], [[[np.inf, 0]], np.zeros((1, 6))]),
            ["factor 0", "variable 'a'", "finite Jacobian", "column 0"],
        ),
    ],
)
def test_wrong_answers_of_a_function_are_refused(function, words):
    with pytest.raises(bundle.InputError) as caught:
        chain(function).solve()
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


@pytest.mark.parametrize("call", [1, 2, 3, 4, 6])
def test_what_a_function_raises_comes_out_of_the_solve(call):
    calls = []

    def function(values):
        calls.append(None)
        if len(calls) == call:
            raise ZeroDivisionError("mine")
        x, y = values[0]
        return [y - x * x, 1 - x], [[[-2 * x, 1], [-1, 0]]]

    with pytest.raises(ZeroDivisionError, match="mine"):
        graph = chain(function, ["a"])
        graph.without(["b"]).solve()
    assert len(calls) == call  # and no call after it


@pytest.mark.parametrize("call", range(9, 16))
def test_ctrl_c_in_a_function_keeps_the_best_state(call):
    calls = []

    def function(values):
        calls.append(None)
        if len(calls) == call:
            raise KeyboardInterrupt
        x, y = values[0]
        return [10 * (y - x * x), 1 - x], [[[-20 * x, 10], [-1, 0]]]

    graph = bundle.FactorGraph()
    graph.add_variable("a", [-1.2, 1.0])
    graph.add_factor(bundle.FunctionFactor(["a"], function))
    result = graph.solve()
    assert result.summary.interrupted and len(calls) == call
    kept = graph.with_values(result.values).cost()
    assert kept == pytest.approx(result.summary.final_cost, rel=1e-12)
    assert kept < result.summary.initial_cost


def test_bounds_and_fixed_coordinates_hold():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.5, 0.5, 0.5], lower=0, upper=[1, 1, np.inf], fixed=[1])
    graph.add_factor(bundle.PriorFactor("x", [-3.0, 7.0, 9.0], 1.0))
    found = graph.solve(function_tolerance=0).values["x"]
    np.testing.assert_allclose(found, [0, 0.5, 9], atol=1e-9)


def test_losses_reject_an_outlier():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.3])
    for z in (0.0, 0.1, -0.1, 50.0):
        graph.add_factor(bundle.PriorFactor("x", [z], 100.0, loss="cauchy", loss_scale=1.0))
    assert abs(graph.solve(max_num_iterations=200).values["x"][0]) < 0.02


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda g: g.add_variable("a", [1.0]), ["variable 'a'", "new key"]),
        (lambda g: g.add_variable("c", [0, 0, 0, 0, 1, 2, 3], "se3"), ["variable 'c'", "norm 0"]),
        (lambda g: g.add_variable("c", [1.0, 2], "se2"), ["variable 'c'", "3 numbers"]),
        (lambda g: g.add_variable("c", [np.inf]), ["variable 'c'", "finite"]),
        (lambda g: g.add_variable("c", [2.0], upper=1.0), ["variable 'c'", "bounds", "2"]),
        (lambda g: g.add_variable("c", [1.0], "sim3"), ["variable 'c'", "euclidean"]),
        (
            lambda g: g.add_factor(bundle.PriorFactor("z", [1.0], 1.0)),
            ["factor 0, PriorFactor('z')", "variable 'z'"],
        ),
        (
            lambda g: g.add_factor(bundle.PriorFactor("a", [0, 0], [[1, 2], [2, 1]])),
            ["factor 0, PriorFactor('a')", "information", "-1"],
        ),
        (
            lambda g: g.add_factor(bundle.PriorFactor("a", [0, 0], [[1, 0], [0, 0]])),
            ["factor 0, PriorFactor('a')", "information", "from 0 to 1"],
        ),
        (
            lambda g: g.add_factor(bundle.BetweenFactor("a", "b", [0, 0], 1.0)),
            ["factor 0, BetweenFactor('a', 'b')"],
        ),
        (
            lambda g: g.add_factor(bundle.PositionFactor("a", [0, 0, 0], 1.0)),
            ["factor 0, PositionFactor('a')", "variable 'a'", "se3", "euclidean of 2"],
        ),
        (lambda g: g.information(["q"]), ["keys", "variable 'q'"]),
        (lambda g: g.without(["a", "a"]), ["keys", "'a' twice"]),
        (lambda g: g.marginalize(["a"]), ["variable 'a'", "factor"]),
        (lambda g: g.solve(), ["factors", "found 0"]),
        (lambda g: g.solve(loss="huber"), ["loss"]),
        (lambda g: g.solve(backend="fused"), []),
    ],
)
def test_bad_input_is_one_line_that_names_its_place(build, words):
    with pytest.raises(bundle.InputError) as caught:
        build(chain())
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


def test_a_variable_without_factors_is_named_and_so_is_one_that_nothing_determines():
    graph = chain()
    graph.add_factor(bundle.PriorFactor("a", [0, 0], 1.0))
    with pytest.raises(bundle.InputError, match=r"^variable 'b': expected at least one factor"):
        graph.solve()
    graph = bundle.FactorGraph()
    for key in "pqrs":
        graph.add_variable(key, [0.0])
    graph.add_factor(bundle.PriorFactor("s", [0.0], 1.0))
    graph.add_factor(bundle.BetweenFactor("r", "s", [1.0], 1.0))
    graph.add_factor(bundle.BetweenFactor("p", "q", [1.0], 1.0))
    with pytest.raises(bundle.InputError, match=r"^variable '[pq]': .*determine"):
        graph.information(["r"])


def test_graphs_and_factors_pickle():
    graph = two_views(own=False)
    again = pickle.loads(pickle.dumps(graph))
    assert again.cost() == graph.cost()
    prior = graph.marginalize([("point", 0)])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(prior)).Lambda, prior.Lambda)
