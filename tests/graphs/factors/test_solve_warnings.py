"""Warnings of a solve of a graph: its Jacobians, its free directions, its parts and priors."""

import time
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np
import pytest

import bundle
from bundle.graphs.factors import check_solve


@pytest.fixture(autouse=True)
def enough_time(monkeypatch):
    """On a busy machine, too, every column is looked at."""
    monkeypatch.setattr(check_solve, "MOST_SECONDS", 5.0)


KINDS = {"suspicious_steps", "wrong_factor", "several_components", "free_directions"}


def factor(measured, mode):
    """Range and bearing of a landmark from a pose of the plane, perhaps with a mistake."""

    def function(values):
        pose, landmark = values
        dx, dy = landmark - pose[:2]
        square = dx * dx + dy * dy
        length = sqrt(square)
        off = atan2(dy, dx) - pose[2] - measured[1]
        turn = np.array([[cos(pose[2]), -sin(pose[2])], [sin(pose[2]), cos(pose[2])]])
        world = np.array([[-dx / length, -dy / length], [dy / square, -dx / square]])
        by_pose, by_landmark = np.hstack([world @ turn, [[0], [-1]]]), -world
        if mode == "sign":
            by_pose[1, 2] = 1
        if mode == "degrees":
            by_pose[:, 2] *= pi / 180
        if mode == "world":
            by_pose[:, :2] = world
        if mode == "scale":
            by_landmark = 1.3 * by_landmark
        if mode == "chain":
            by_pose[1, :2] *= length
        weights = np.array([[10], [50]])
        residual = [(length - measured[0]) / 0.1, atan2(sin(off), cos(off)) / 0.02]
        return residual, [by_pose * weights, by_landmark * weights]

    return function


def slam(mode, num_poses=6, num_landmarks=6, fixed=True):
    rng = np.random.default_rng(1)
    landmarks = np.random.default_rng(0).uniform(-10, 10, (num_landmarks, 2))
    poses = np.array([[i * 0.8, sin(i * 0.6), 0.2 * i] for i in range(num_poses)])
    graph = bundle.FactorGraph()
    for i, pose in enumerate(poses):
        start = pose + rng.normal(0, 0.05, 3) * (i > 0)
        graph.add_variable(f"x{i}", start, "se2", fixed=fixed and i == 0)
    for k, landmark in enumerate(landmarks):
        graph.add_variable(f"l{k}", landmark + rng.normal(0, 0.3, 2))
    for i, pose in enumerate(poses):
        for k, landmark in enumerate(landmarks):
            dx, dy = landmark - pose[:2]
            seen = hypot(dx, dy) + rng.normal(0, 0.1), atan2(dy, dx) - pose[2]
            graph.add_factor(bundle.FunctionFactor([f"x{i}", f"l{k}"], factor(seen, mode)))
    return graph


def kinds_of(graph, **options):
    return set(graph.solve(**options).summary.warning_kinds) & {*KINDS, "prior_spectrum"}


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("sign", ["x", "(angle)", "-1 times"]),
        ("degrees", ["x", "(angle)", "0.0175 times"]),
        ("world", ["x", "(x, y)", "differ"]),
        ("scale", ["l", "([0], [1])", "1.3 times"]),
        ("chain", ["x", "(x, y)", "differ"]),
    ],
)
def test_a_wrong_jacobian_of_a_function_is_said(mode, words, square_root):
    summary = slam(mode).solve(max_num_iterations=30, square_root=square_root).summary
    assert "wrong_factor" in summary.warning_kinds
    sentence = summary.warnings[summary.warning_kinds.index("wrong_factor")]
    for word in [*words, "FunctionFactor", "35 others", "FactorGraph.check_gradients"]:
        assert word in sentence, sentence
    assert "\n" not in sentence


def test_right_jacobians_are_not_suspected():
    assert kinds_of(slam("right")) == set()
    assert kinds_of(slam("right"), square_root=True) == set()
    assert kinds_of(slam("sign"), check_solution=False) == set()


@pytest.mark.parametrize("by", [1.01, 0.99, 1.0001])
def test_a_percent_is_enough(by):
    graph = bundle.FactorGraph()
    for key, value in (("a", [1.5, 0.5]), ("b", [0.2])):
        graph.add_variable(key, value)
        graph.add_factor(bundle.PriorFactor(key, value, 1.0))

    def function(values):
        (x, y), (z,) = values
        return [x * y + z, 1e5 * np.sin(x)], [[[y, x * by], [1e5 * np.cos(x), 0.0]], [[1.0], [0.0]]]

    graph.add_factor(bundle.FunctionFactor(["a", "b"], function))
    assert ("wrong_factor" in kinds_of(graph)) == (by != 1.0001)


def test_a_pose_graph_is_watched(monkeypatch):
    seen = []

    def watch(iterations, advice):
        seen.append(len(iterations["cost"]))
        return f"It lies; {advice}."

    monkeypatch.setattr(bundle._core, "watch_convergence", watch)
    pose_graph = bundle.PoseGraph(
        poses=[[0, 0, 0], [1.1, 0, 0], [2.0, 0.1, 0]],
        edges=[[0, 1], [1, 2], [0, 2]],
        measurements=[[1, 0, 0], [1, 0, 0], [2, 0, 0.01]],
        information=np.array([np.eye(3)] * 3),
    )
    for backend in ("auto", "ceres"):
        result = bundle.solve(pose_graph, backend=backend)
        place = result.summary.warning_kinds.index("suspicious_steps")
        assert result.summary.warnings[place].startswith("It lies; ")
        assert seen[-1] == len(result.iterations["cost"])


def test_the_watch_sees_every_solve_of_a_graph():
    for square_root in (False, True):
        summary = slam("sign").solve(square_root=square_root).summary
        place = summary.warning_kinds.index("suspicious_steps")
        assert "FactorGraph.check_gradients" in summary.warnings[place]
        assert "bundle check" not in summary.warnings[place]


def test_a_mistake_of_one_kind_among_others_is_found():
    """A kind is a code: many right ones do not hide a wrong one."""
    graph = slam("right", num_poses=10, num_landmarks=10)
    graph.add_factor(bundle.FunctionFactor(["x1"], lambda v: ([v[0][0] - 0.8], [[[1.0, 0, 0]]])))
    sentence = graph.solve().summary.warnings[-1]
    assert "factor 100" in sentence
    assert "variable 'x1' (x, y)" in sentence  # in the frame of the pose, x of the world is both


def test_what_is_held_need_not_be_known():
    graph = bundle.FactorGraph()
    graph.add_variable("a", [1.0, 2.0], fixed=[1])
    graph.add_variable("b", [3.0], fixed=True)
    graph.add_factor(
        bundle.FunctionFactor(
            ["a", "b"], lambda v: ([v[0][0] * v[0][1] - v[1][0]], [[[v[0][1], 0.0]], [[0.0]]])
        )
    )
    assert kinds_of(graph) == set()


def test_kinks_jumps_and_borders_accuse_nobody():
    """A hinge at its corner, a floor, a root at zero, a value that must not be left."""

    def border(values):
        if values[0][0] < 2:
            raise ValueError("beyond the border")
        return [values[0][0] - 2], [[[1.0]]]

    functions = {
        "hinge": lambda v: ([max(0.0, v[0][0] - 2)], [[[float(v[0][0] > 2)]]]),
        "floor": lambda v: ([np.floor(1e9 * v[0][0]) / 1e9 - 2], [[[1.0]]]),
        "root": lambda v: ([np.sqrt(max(v[0][0] - 2, 0))], [[[0.5]]]),
        "single": lambda v: ([np.float32(v[0][0]) - 2], [[[1.0]]]),
        "border": border,
    }
    for function in functions.values():
        graph = bundle.FactorGraph()
        graph.add_variable("x", [2.0])
        graph.add_factor(bundle.FunctionFactor(["x"], function))
        graph.add_factor(bundle.PriorFactor("x", [2.0], 1.0))
        assert kinds_of(graph) == set()


def test_a_check_takes_no_time_from_slow_functions(monkeypatch):
    """Twenty thousandths of a second a call: a few calls, in one direction of all variables."""
    monkeypatch.setattr(check_solve, "MOST_SECONDS", 0.3)
    calls = []

    def function(values):
        calls.append(0)
        time.sleep(20e-3)
        return values[0] ** 2 - 1, [np.diag(2 * values[0]) * (1 + 1e-1 * np.eye(20)[3])]

    counts = []
    for check_solution in (False, True):
        graph = bundle.FactorGraph()
        graph.add_variable("x", np.linspace(1, 2, 20))
        graph.add_factor(bundle.FunctionFactor(["x"], function))
        calls.clear()
        summary = graph.solve(check_solution=check_solution, max_num_iterations=3).summary
        counts.append(len(calls))
        assert ("wrong_factor" in summary.warning_kinds) == check_solution
    assert counts[1] - counts[0] <= 25  # 50 ms


def chain(manifold, count, prefix="", anchored=False):
    values = {
        "euclidean": [0.0, 0.0],
        "so2": [0.0],
        "so3": [0, 0, 0, 1],
        "se2": [0, 0, 0],
        "se3": [0, 0, 0, 1, 0, 0, 0],
    }
    graph = bundle.FactorGraph()
    return extend(graph, values[manifold], manifold, count, prefix, anchored)


def extend(graph, value, manifold, count, prefix, anchored):
    for i in range(count):
        graph.add_variable(f"{prefix}{i}", value, manifold, fixed=anchored and i == 0)
    for i in range(count - 1):
        graph.add_factor(bundle.BetweenFactor(f"{prefix}{i}", f"{prefix}{i + 1}", value, 4.0))
    return graph


@pytest.mark.parametrize(
    ("manifold", "free"), [("euclidean", 2), ("so2", 1), ("so3", 3), ("se2", 3), ("se3", 6)]
)
def test_a_chain_without_a_place_says_so(manifold, free):
    summary = chain(manifold, 5, "p").solve().summary
    assert summary.warning_kinds == ("free_directions",)
    (sentence,) = summary.warnings
    assert f" {free} of " in sentence
    assert "5 variables with 'p0'" in sentence
    assert kinds_of(chain(manifold, 5, "p", anchored=True)) == set()
    assert kinds_of(chain(manifold, 5, "p"), check_solution=False) == set()


def test_free_directions_of_functions_and_of_large_graphs():
    assert kinds_of(slam("right", fixed=False)) == {"free_directions"}
    large = chain("se3", 600, "p")  # too many columns to look at all: by what its factors are
    sentence = large.solve(linear_solver_type="sparse_normal_cholesky").summary.warnings[-1]
    assert "at least 6 of " in sentence
    held = chain("se3", 600, "p", anchored=True)
    assert kinds_of(held, linear_solver_type="sparse_normal_cholesky") == set()


def test_parts_that_no_factor_joins():
    graph = chain("se2", 4, "a", anchored=True)
    extend(graph, [0, 0, 0], "se2", 3, "b", anchored=False)
    summary = graph.solve().summary
    assert set(summary.warning_kinds) == {"several_components", "free_directions"}
    first, second = (
        summary.warnings[summary.warning_kinds.index(kind)]
        for kind in ("several_components", "free_directions")
    )
    assert "4 variables with 'a0', 3 variables with 'b0'" in first
    assert "3 of 18 directions (3 in the part of 3 variables with 'b0')" in second
    graph.add_factor(bundle.PriorFactor("b1", [0, 0, 0], 1.0))  # both have a place
    assert kinds_of(graph) == set()


def test_a_prior_that_alarms_is_said():
    graph = bundle.FactorGraph()
    for key in "ab":
        graph.add_variable(key, [0.0])
    points = {"a": [0.0], "b": [0.0]}
    tired = bundle.LinearPrior(np.diag([1.0, 1e-12]), [0, 0], points, ("a", "b"))
    graph.add_factor(tired)
    summary = graph.solve().summary
    assert summary.warning_kinds == ("prior_spectrum",)
    assert tired.spectrum.warning in summary.warnings[0]
    assert "factor 0, LinearPrior" in summary.warnings[0]
    healthy = bundle.FactorGraph()
    for key in "ab":
        healthy.add_variable(key, [0.0])
    healthy.add_factor(bundle.LinearPrior(np.diag([1.0, 1e-3]), [0, 0], points, ("a", "b")))
    assert kinds_of(healthy) == set()


def test_ripples_that_long_steps_do_not_see_accuse_nobody():
    """The slope over 1e-4 and over 1e-2 is 1, and of the ripples another at each place."""

    def function(values):
        x = values[0][0]
        return [x + 1e-7 * np.sin(1e7 * x)], [[[1 + np.cos(1e7 * x)]]]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0])
    graph.add_factor(bundle.PriorFactor("x", [1.0], 1e6))
    graph.add_factor(bundle.FunctionFactor(["x"], function))
    assert "wrong_factor" not in kinds_of(graph)


@pytest.mark.parametrize("at", ["start", "end"])
def test_a_jacobian_that_is_right_at_one_of_both_ends_is_found(at):
    """One that is never renewed; and one that is right where the residual is zero."""

    def function(values):
        x = values[0][0]
        return [x * x - 1], [[[4.0 if at == "start" else 2.0]]]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [2.0])
    graph.add_factor(bundle.FunctionFactor(["x"], function))
    result = graph.solve(max_num_iterations=60)
    assert result.values["x"][0] == pytest.approx(1, abs=1e-3)
    assert "wrong_factor" in result.summary.warning_kinds
