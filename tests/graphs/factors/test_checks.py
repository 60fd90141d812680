"""Checks of factors and of whole graphs: what is wrong, where, and in how many factors."""

import numpy as np
import pytest

import bundle


def measured_range(values):
    """A range from a pose in the plane to a landmark."""
    (x, y, angle), landmark = values
    offset = landmark - [x, y]
    length = np.hypot(*offset)
    direction = offset / length
    c, s = np.cos(angle), np.sin(angle)
    by_pose = np.append(-direction @ [[c, -s], [s, c]], 0)
    return np.array([length - 3, 2 * length]), [
        np.outer([1, 2], by_pose),
        np.outer([1, 2], direction),
    ]


def spoiled(values):
    residual, (by_pose, by_landmark) = measured_range(values)
    by_landmark[1, 0] *= -1
    return residual, [by_pose, by_landmark]


def make_graph(*functions, count=5):
    graph = bundle.FactorGraph()
    for i in range(count):
        graph.add_variable(f"x{i}", [i, 0.5, 0.3 + i], "se2")
        graph.add_variable(("l", i), [i + 2, 4.0])
        for function in functions:
            graph.add_factor(bundle.FunctionFactor([f"x{i}", ("l", i)], function))
        graph.add_factor(bundle.PriorFactor(f"x{i}", [i, 0, 0.3 + i], np.eye(3)))
    return graph


def test_one_mistake_of_the_code_is_one_finding():
    check = bundle.check_gradients(make_graph(measured_range, spoiled))
    assert (check.verdict, check.num_checked, len(check.wrong)) == ("wrong", 15, 5)
    (found,) = check.findings
    assert (found.kind, found.rows) == ("sign", (1,))
    assert (found.num_wrong, found.num_checked) == (5, 5)
    (position,) = {int(found.factor.split()[1].rstrip(","))} & set(range(1, 15, 3))
    assert found.keys == (f"('l', {position // 3})",)
    assert found.columns == (f"{found.keys[0]} [0]",)
    groups = {group.name: group for group in check.groups}
    assert groups["FunctionFactor measured_range"].verdict == "correct"
    assert groups["FunctionFactor spoiled"].num_wrong == 5
    (entry,) = check.worst
    assert (entry.place, entry.residual) == (found.factor, 1)
    assert entry.analytic == pytest.approx(-entry.reference)
    for word in (found.factor, found.keys[0], "row 1", "5 of 5"):
        assert word in " ".join(str(check).split())


def test_a_sample_of_each_kind_is_checked():
    graph = make_graph(measured_range, spoiled, count=8)
    check = bundle.check_jacobians(graph, samples_per_image=4)
    assert (check.num_checked, check.num_factors) == (12, 24)
    assert [group.num_checked for group in check.groups] == [4, 4, 4]
    assert [found.num_wrong for found in check.findings] == [4]
    positions = [int(name.split()[1].rstrip(",")) // 3 for name in check.reports]
    assert set(positions) == {0, 2, 4, 6}
    assert bundle.check_jacobians(graph, samples_per_image=None).num_checked == 24


def test_functions_with_other_manifolds_are_another_kind():
    graph = bundle.FactorGraph()
    for key, manifold in (("a", "so2"), ("b", "euclidean"), ("c", "euclidean")):
        graph.add_variable(key, [0.5], manifold)
        graph.add_factor(bundle.FunctionFactor([key], lambda v: (v[0], [[[1.0]]])))
    assert [group.num_checked for group in graph.check_gradients().groups] == [1, 2]


@pytest.mark.parametrize("by_key", [True, False])
def test_a_factor_alone(by_key):
    factor = bundle.FunctionFactor(["x", "l"], spoiled)
    values, manifolds = [[1, 2, 0.3], [4, 5]], ["se2", None]
    if by_key:
        values = dict(zip("lx", values[::-1], strict=True))
        manifolds = {"x": "se2"}
    check = bundle.check_gradients(factor, values, manifolds)
    assert check.kinds == {"sign"}
    assert bundle.check_gradients(
        bundle.FunctionFactor(["x", "l"], measured_range), values, manifolds
    )


@pytest.mark.parametrize("error", ["log", "g2o", "ceres"])
@pytest.mark.parametrize("size", [3, 7])
def test_the_edges_of_a_pose_graph(error, size, tmp_path):
    rng = np.random.default_rng(size)
    poses, n = rng.normal(size=(6, size)), 3 if size == 3 else 6
    edges = [(k, k + 1) for k in range(5)] + [(0, 5)]
    graph = bundle.PoseGraph(
        poses=poses,
        edges=edges,
        measurements=rng.normal(size=(6, size)),
        information=np.tile(np.eye(n), (6, 1, 1)),
    )
    check = bundle.check_jacobians(graph, error=error)
    assert check
    assert {group.name: group.num_checked for group in check.groups} == {
        "edge, odometry": 5,
        "edge, closure": 1,
    }
    bundle.save(graph, tmp_path / "x.g2o")
    again = bundle.check_jacobians(tmp_path / "x.g2o", error=error)
    assert "line" in next(iter(again.reports))


def test_a_wrong_edge_is_named(monkeypatch):
    graph = bundle.PoseGraph(
        poses=[[0, 0, 0], [1, 0, 0.3], [2, 1, 0.5]],
        edges=[[0, 1], [1, 2]],
        measurements=[[1, 0, 0.2], [1, 1, 0.3]],
        information=np.tile(np.eye(3), (2, 1, 1)),
        ids=[7, 8, 9],
    )
    right = bundle._core.relative_pose_error

    def wrong(*arguments):
        residual, first, second = right(*arguments)
        second[:, 2] *= -1
        return residual, first, second

    monkeypatch.setattr(bundle._core, "relative_pose_error", wrong)
    (found,) = bundle.check_jacobians(graph).findings
    assert (found.kind, found.num_wrong) == ("sign", 2)
    assert found.columns in (("8 angle",), ("9 angle",))
    assert found.keys in (("8",), ("9",))


MISUSES = [
    (lambda: bundle.check_gradients(make_graph(measured_range), [[1.0]]), "blocks: "),
    (lambda: bundle.check_gradients(make_graph(measured_range), manifolds=["se2"]), "manifolds: "),
    (lambda: bundle.check_gradients(make_graph(), names=["a"]), "names: "),
    (lambda: bundle.check_gradients(measured_range), "blocks: "),
    (
        lambda: bundle.check_gradients(
            bundle.PoseGraph(
                poses=np.eye(3)[:2],
                edges=[[0, 1]],
                measurements=np.eye(3)[:1],
                information=[np.eye(3)],
            )
        ),
        "pose graph.*check_jacobians",
    ),
    (lambda: bundle.check_gradients(bundle.PriorFactor("x", 0, 1), {}), "blocks: .*'x'"),
    (lambda: bundle.check_gradients(bundle.PriorFactor("x", 0, 1), [1, 2]), "blocks: "),
    (
        lambda: bundle.check_gradients(bundle.PriorFactor("x", 0, 1), {"x": 0, "y": 1}),
        "blocks: .*'y'",
    ),
    (
        lambda: bundle.check_gradients(bundle.PriorFactor("x", 0, 1), [0], {"x": "se4"}),
        "manifold",
    ),
    (lambda: make_graph().check_gradients(most_of_a_kind=0), "most_of_a_kind: "),
    (lambda: make_graph().check_gradients(progress=3), "progress: "),
]


@pytest.mark.parametrize(("call", "message"), MISUSES)
def test_misuse_is_one_line(call, message):
    with pytest.raises(bundle.InputError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_an_exception_of_a_function_keeps_the_name_of_the_factor():
    calls = []

    def fails_later(values):
        calls.append(1)
        if len(calls) > 3:
            raise RuntimeError("far away")
        return measured_range(values)

    with pytest.raises(RuntimeError) as caught:
        make_graph(fails_later, count=1).check_gradients()
    assert "factor 0" in caught.value.__notes__[0]


def test_a_tangent_is_that_of_its_library():
    """The order of g2o in space, and its translation of the world in the plane."""

    def between(values):
        residual, jacobians = measured_range(values)
        c, s = np.cos(values[0][2]), np.sin(values[0][2])
        turn = np.eye(3)
        turn[:2, :2] = [[c, s], [-s, c]]
        return residual, [jacobians[0] @ turn, jacobians[1]]

    values, manifolds = [[1, 2, 0.3], [4, 5]], ["se2", None]
    assert bundle.check_gradients(between, values, manifolds, tangent="g2o")
    found = bundle.check_gradients(between, values, manifolds, tangent="manif", names=["x", "l"])
    assert found.kinds == {"frame"}
    assert "g2o" in found.findings[0].sentence
    with pytest.raises(bundle.InputError, match=r"tangent: .*gtsam.*found 'sophia'"):
        bundle.check_gradients(between, values, manifolds, tangent="sophia")
    with pytest.raises(bundle.InputError, match="one argument"):
        bundle.check_gradients(lambda a, b: between([a, b]), values, manifolds, tangent="g2o")
    with pytest.raises(bundle.InputError, match="blocks: "):
        bundle.check_gradients(between, np.zeros(3), ["se2"], tangent="g2o")
    for names in ([1, 2], ["x"], "xl"):
        with pytest.raises(bundle.InputError, match="names: "):
            bundle.check_gradients(between, values, manifolds, tangent="g2o", names=names)


def test_built_in_factors_keep_their_tangent():
    graph = make_graph(count=1)
    assert graph.check_gradients(tangent="g2o_expmap")
