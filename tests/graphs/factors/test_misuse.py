"""Every argument of a factor graph with every kind of wrong value: one line names its place."""

import re

import numpy as np
import pytest

import bundle

EYE = [0.0, 0, 0, 1]
POSE = [*EYE, 0, 0, 1]
SQUARE = np.eye(2)


class Unprintable:
    def __repr__(self):
        raise RuntimeError("no repr")


class Unhashable:
    def __hash__(self):
        raise ValueError("no hash")


WRONG = {
    "complex": [1j, 2],
    "masked": np.ma.masked_array([1.0, 2.0], [0, 1]),
    "objects": np.array([Unprintable(), 1], dtype=object),
    "text": "abc",
    "texts": ["x", "y"],
    "empty": [],
    "nan": [np.nan, 1.0],
    "infinite": [np.inf, 1.0],
    "ragged": [[1.0], [1.0, 2.0]],
    "nested": [[1.0, 2.0]],
    "three": [1.0, 2.0, 3.0],
    "dict": {"q": 1},
    "set": {1.0, 2.0},
    "flags": [True, False],
    "huge": [10**400, 1],
    "bytes": b"ab",
    "dates": np.array(["2020-01-01", "2021-01-01"], "M8[D]"),
    "records": np.zeros(2, [("x", float)]),
    "nothing": np.array(None),
    "function": len,
    "object": Unprintable(),
}


def graph():
    made = bundle.FactorGraph()
    made.add_variable("a", [1.0, 2.0])
    made.add_variable("b", [1.0, 2.0])
    made.add_variable("pose", POSE, "se3")
    made.add_variable("camera", [500.0, 320, 240])
    made.add_variable("point", [0.0, 0, 3])
    return made


def solvable():
    made = bundle.FactorGraph()
    made.add_variable("a", [1.0, 2.0])
    made.add_factor(bundle.PriorFactor("a", [0, 0], 1.0))
    return made


def prior():
    return bundle.LinearPrior(SQUARE, [1, 2], {"a": [1, 2]}, ["a"])


def add(make, *args, **options):
    graph().add_factor(make(*args, **options))


def solve_function(function):
    made = bundle.FactorGraph()
    made.add_variable("a", [1.0, 2.0])
    made.add_factor(bundle.FunctionFactor(["a"], function))
    made.solve()


# Argument: a call with it, what its message names, wrong values that are right here.
ARGUMENTS = {
    "value": (lambda v: graph().add_variable("n", v), "'n'", {"three"}),
    "value on se3": (lambda v: graph().add_variable("n", v, "se3"), "'n'", set()),
    "manifold": (lambda v: graph().add_variable("n", [1.0], v), "'n': manifold", set()),
    "lower": (lambda v: graph().add_variable("n", [9.0, 9], lower=v), "'n'", set()),
    "upper": (lambda v: graph().add_variable("n", [0, 0], upper=v), "'n'", {"infinite"}),
    "fixed": (lambda v: graph().add_variable("n", [1.0, 2], fixed=v), "'n': fixed", {"empty"}),
    "prior": (lambda v: add(bundle.PriorFactor, "a", v, 1.0), "PriorFactor('a')", set()),
    "information": (
        lambda v: add(bundle.PriorFactor, "a", [1, 2], v),
        "PriorFactor('a'): information",
        set(),
    ),
    "scalar": (
        lambda v: add(bundle.ScalarPriorFactor, "a", 0, v, 1.0),
        "ScalarPriorFactor('a'): value",
        set(),
    ),
    "index": (
        lambda v: add(bundle.ScalarPriorFactor, "a", v, 1.0, 1.0),
        "ScalarPriorFactor('a'): index",
        set(),
    ),
    "sigma": (
        lambda v: add(bundle.ScalarPriorFactor, "a", 0, 1.0, v),
        "ScalarPriorFactor('a'): sigma",
        set(),
    ),
    "measurement": (
        lambda v: add(bundle.BetweenFactor, "a", "b", v, 1.0),
        "BetweenFactor('a', 'b')",
        set(),
    ),
    "position": (
        lambda v: add(bundle.PositionFactor, "pose", v, 1.0),
        "PositionFactor('pose')",
        {"three"},
    ),
    "lever arm": (
        lambda v: add(bundle.PositionFactor, "pose", [1, 2, 3], 1.0, lever_arm=v),
        "PositionFactor('pose')",
        {"three"},
    ),
    "observation": (
        lambda v: add(bundle.ReprojectionFactor, "pose", "camera", "point", v, "SIMPLE_PINHOLE"),
        "ReprojectionFactor('pose', 'camera', 'point')",
        set(),
    ),
    "model": (
        lambda v: add(bundle.ReprojectionFactor, "pose", "camera", "point", [1, 2], v),
        "model",
        set(),
    ),
    "Lambda": (
        lambda v: add(bundle.LinearPrior, v, [1, 2], {"a": [1, 2]}, ["a"]),
        "LinearPrior('a')",
        set(),
    ),
    "eta": (lambda v: add(bundle.LinearPrior, SQUARE, v, {"a": [1, 2]}, ["a"]), "eta", set()),
    "point": (
        lambda v: add(bundle.LinearPrior, SQUARE, [1, 2], {"a": v}, ["a"]),
        "LinearPrior('a')",
        set(),
    ),
    "points": (
        lambda v: add(bundle.LinearPrior, SQUARE, [1, 2], v, ["a"]),
        "linearization_point",
        set(),
    ),
    "manifolds": (
        lambda v: bundle.LinearPrior(SQUARE, [1, 2], {"a": [1, 2]}, ["a"], manifolds=v),
        "manifold",
        set(),
    ),
    "values": (lambda v: graph().with_values({"a": v}), "variable 'a'", set()),
    "value by key": (lambda v: graph().with_values(v), "values: ", set()),
    "anchor": (lambda v: prior().reanchor({"a": v}), "variable 'a'", set()),
    "anchors": (lambda v: prior().reanchor(v), "values: ", set()),
    "loss": (lambda v: bundle.PriorFactor("a", [1, 2], 1.0, loss=v), "loss: ", set()),
    "scale": (
        lambda v: bundle.PriorFactor("a", [1, 2], 1.0, loss_scale=v),
        "PriorFactor('a'): loss_scale: ",
        set(),
    ),
    "factor": (lambda v: graph().add_factor(v), "factor: ", set()),
    "asked for": (lambda v: solvable().information(v), "keys: ", {"empty"}),
    "eliminated": (lambda v: solvable().marginalize(v), "keys: ", set()),
    "without": (lambda v: graph().without(v), "keys: ", set()),
    "checked": (lambda v: graph().check_gradients(v), "factors: ", {"empty"}),
    "options": (lambda v: graph().solve(v), "options: ", set()),
    "progress": (lambda v: solvable().solve(progress=v), "progress: ", {"function"}),
    "iterations": (lambda v: graph().solve(max_num_iterations=v), "max_num_iterations: ", set()),
    "own keys": (
        lambda v: add(bundle.FunctionFactor, v, len),
        "",
        set(),
    ),
    "own function": (
        lambda v: bundle.FunctionFactor(["a"], v),
        "FunctionFactor('a'): ",
        {"function"},
    ),
    "dependent": (
        lambda v: bundle.FunctionFactor(["a"], len, v),
        "FunctionFactor('a'): num_dependent: ",
        set(),
    ),
    "own answer": (
        lambda v: solve_function(lambda _: v),
        "factor 0, FunctionFactor('a'): ",
        set(),
    ),
    "own residual": (
        lambda v: solve_function(lambda _: (v, [SQUARE])),
        "factor 0, FunctionFactor('a'): ",
        {"nested"},
    ),
    "own Jacobians": (
        lambda v: solve_function(lambda _: ([1.0, 2.0], v)),
        "factor 0, FunctionFactor('a'): ",
        set(),
    ),
    "own Jacobian": (
        lambda v: solve_function(lambda _: ([1.0, 2.0], [v])),
        "factor 0, FunctionFactor('a'): variable 'a': ",
        set(),
    ),
}


def check_line(call, value, words):
    with pytest.raises(bundle.InputError) as caught:
        call(value)
    message = str(caught.value)
    assert message.isprintable() and len(message) < 500, message
    assert words in message
    return message


@pytest.mark.parametrize("argument", ARGUMENTS)
def test_wrong_values_are_refused_in_one_line_that_names_the_argument(argument):
    call, words, right = ARGUMENTS[argument]
    for name, value in WRONG.items():
        if name in right:
            call(value)
        else:
            check_line(call, value, words)


KEYS = {
    "list": [],
    "array": np.zeros(3),
    "tuple of a list": ([],),
    "hash that fails": Unhashable(),
    "none that is there": "q",
    "control characters": "a\n\x1b[31mb\u202e",
    "half a character": "\ud800",
    "long": "x" * 100_000,
    "digits": 10**5000,
    "None": None,
    "no repr": Unprintable(),
}
UNKNOWN = list(KEYS)[4:]


@pytest.mark.parametrize("kind", KEYS)
@pytest.mark.parametrize(
    "call",
    [
        lambda key: graph().add_factor(bundle.PriorFactor(key, [1, 2], 1.0)),
        lambda key: graph().add_factor(bundle.BetweenFactor("a", key, [1, 2], 1.0)),
        lambda key: graph().add_factor(bundle.FunctionFactor([key], len)),
        lambda key: add(bundle.LinearPrior, SQUARE, [1, 2], {"a": [1, 2]}, [key]),
        lambda key: graph().information([key]),
        lambda key: graph().without(["a", key]),
        lambda key: (graph().add_variable(key, [1.0]), bundle.FunctionFactor([key, key], len)),
    ],
)
def test_unknown_keys_and_what_can_be_none_are_refused(call, kind):
    check_line(call, KEYS[kind], "")


@pytest.mark.parametrize("kind", UNKNOWN)
def test_any_hashable_object_is_a_key(kind):
    key = KEYS[kind]
    made = bundle.FactorGraph()
    made.add_variable(key, [1.0])
    check_line(lambda k: made.add_variable(k, [1.0]), key, "expected a new key")
    made.add_factor(bundle.PriorFactor(key, [0.0], 4.0))
    made.add_factor(bundle.FunctionFactor([key], lambda values: (values[0] * 2, [[[2.0]]])))
    result = made.solve()
    np.testing.assert_allclose(result.values[key], 0, atol=1e-6)
    np.testing.assert_allclose(made.information([key])[0], 8)
    for shown in (made, *made.factors, result, made.check_gradients()):
        assert len(repr(shown)) < 1000
        assert repr(shown).replace("\n", "").isprintable()


@pytest.mark.parametrize(
    ("information", "words"),
    [
        ([[1, 2], [0, 1]], "symmetric"),
        ([[1, 2], [2, 1]], "from -1 to 3"),
        ([[1, 1], [1, 1]], "from 0 to 2"),
        ([[1, np.nan], [np.nan, 1]], "finite"),
        (np.zeros((2, 2)), "from 0 to 0"),
        (0.0, "from 0 to 0"),
        (-1.0, "from -1 to -1"),
        (np.eye(3), "(2, 2)"),
        ([[1, 0]], "(2, 2)"),
        ([1, 1, 1], "(2, 2)"),
        ([1, -1], "from -1 to 1"),
    ],
)
def test_information_is_symmetric_and_positive_definite(information, words):
    for make in (
        lambda: bundle.PriorFactor("a", [1, 2], information),
        lambda: bundle.BetweenFactor("a", "b", [1, 2], information),
        lambda: bundle.ReprojectionFactor(
            "pose", "camera", "point", [1, 2], "SIMPLE_PINHOLE", information
        ),
    ):
        message = check_line(lambda make: graph().add_factor(make()), make, words)
        assert message.startswith("factor 0, ") and "information" in message


@pytest.mark.parametrize(
    ("lower", "upper", "words"),
    [
        (2.0, None, "2"),
        (None, 0.5, "0.5"),
        ([0, 2.5], None, "2.5"),
        (3.0, -3.0, "3"),
        (np.nan, None, "nan"),
        (None, [0, np.nan], "nan"),
        (np.inf, None, "inf"),
        (None, -np.inf, "inf"),
    ],
)
def test_bounds_include_the_start(lower, upper, words):
    def call(_):
        graph().add_variable("n", [1.0, 2.0], lower=lower, upper=upper)

    assert words in check_line(call, None, "variable 'n'")


def test_a_value_outside_the_bounds_is_refused_later_too():
    made = bundle.FactorGraph()
    made.add_variable("n", [1.0], lower=0)
    check_line(made.with_values, {"n": [-1.0]}, "variable 'n'")


def test_a_residual_that_is_not_finite_rejects_steps_and_names_its_factor_at_the_start():
    def root(values):
        x = values[0]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(x) - 0.1, [0.5 / np.sqrt(x)[None]]

    made = bundle.FactorGraph()
    made.add_variable("n", [4.0])
    made.add_factor(bundle.FunctionFactor(["n"], root))
    result = made.solve()  # the first step leads to -3.6
    assert result.summary.num_unsuccessful_steps >= 1
    np.testing.assert_allclose(result.values["n"], 0.01, rtol=1e-3)
    bad = made.with_values({"n": [-1.0]})
    for call in (bad.solve, bad.cost, bad.information):
        message = check_line(lambda call: call(), call, "factor 0, FunctionFactor('n')")
        assert "'n'" in message and "finite" in message


def test_a_wrong_entry_of_a_jacobian_is_named_with_factor_and_variable():
    def wrong(values):
        x, y = values[0], values[1]
        by_y = np.array([[1.0, 0], [0, 3.0]])  # [1, 1] should be 1
        return x + y, [SQUARE, by_y]

    made = graph()
    made.add_factor(bundle.PriorFactor("a", [0, 0], 1.0))
    made.add_factor(bundle.FunctionFactor(["a", "b"], wrong))
    check = made.check_gradients()
    (name,) = check.wrong
    assert name.startswith("factor 1, FunctionFactor('a', 'b')")
    assert "'b' [1]: 3.000 times too large" in str(check.wrong[name])
    assert name in str(check)


@pytest.mark.parametrize("apart", [1e-12, 1e-8, 1e-4])
def test_numbers_across_a_diagonal_are_told_apart(apart):
    """Or taken for equal, where they differ by rounding."""
    matrix = np.array([[3.0, -2.0], [-2.0 + apart, 2.0]])
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.0, 0.0])
    factor = bundle.PriorFactor("x", [0.0, 0.0], matrix)
    if apart < 1e-9:
        graph.add_factor(factor)
        return
    with pytest.raises(bundle.InputError) as caught:
        graph.add_factor(factor)
    found = str(caught.value).split("found ")[1]
    one, other = re.findall(r"-[\d.]+", found)
    assert float(one) != float(other)
    edge = bundle.PoseGraph(
        poses=np.zeros((2, 3)),
        edges=[[0, 1]],
        measurements=[[1.0, 0, 0]],
        information=[np.block([[matrix, np.zeros((2, 1))], [np.zeros((1, 2)), 1.0]])],
    )
    with pytest.raises(bundle.InputError, match="symmetric") as caught:
        bundle.solve(edge)
    one, other = re.findall(r"-[\d.]+", str(caught.value).split("found ")[1])
    assert float(one) != float(other)
