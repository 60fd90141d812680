"""`UserFunction`: what it accepts of a user's function, and what it refuses, with its place."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.checking.function import UserFunction, called
from bundle.errors import InputError

X = [np.array([1.0, 2.0])]


def test_the_first_answer_counts_the_residuals():
    sizes = iter([2, 2, 3])
    user = UserFunction(lambda _: (np.ones(next(sizes)), [np.ones((2, 2))]), [2], "mine")
    residual, jacobians = user(X, True)
    assert user.num_residuals == len(residual) == 2 and len(jacobians) == 1
    assert user(X, False)[1] is None
    with pytest.raises(InputError, match=r"^mine: .*2 residuals .*3$"):
        user(X, False)


def test_only_a_vector_is_refused_as_a_matrix():
    def function(_):
        return np.ones((2, 2)), [np.ones((4, 2))]

    assert UserFunction(function, [2])(X, True)[0].shape == (4,)
    with pytest.raises(InputError, match=r"\(2, 2\)"):
        UserFunction(function, [2], is_vector=True)(X, True)
    column = UserFunction(lambda _: (np.ones((4, 1)), []), [], is_vector=True)
    assert column([], False)[0].shape == (4,)
    graph = bundle.FactorGraph()
    graph.add_variable("x", X[0], "euclidean")
    graph.add_factor(bundle.FunctionFactor(["x"], function))
    with pytest.raises(InputError, match=r"factor 0.*residual.*\(2, 2\)"):
        graph.solve()


def test_the_jacobian_of_a_factor_is_named_by_its_variable():
    user = UserFunction(lambda _: (np.ones(2), np.ones((1, 3, 2))), [2], "mine", ["its slope"])
    with pytest.raises(InputError, match=r"^mine: its slope: .*\(2, 2\).*\(3, 2\)$"):
        user(X, True)


@pytest.mark.parametrize("given", [np.float64(1.0), np.ones((2, 2, 2)), [], None])
def test_another_number_of_jacobians_is_refused(given):
    with pytest.raises(InputError, match="1 Jacobian"):
        UserFunction(lambda _: (np.ones(2), given), [2])(X, True)


def test_values_of_a_buffer_that_is_used_again_are_kept():
    buffer = np.zeros(2)

    def function(blocks):
        buffer[:] = blocks[0]
        return buffer, [np.eye(2)]

    user = UserFunction.at(function, X)
    found = user.core(X, False)[0], user.evaluate(X)[0]
    buffer[:] = 7
    np.testing.assert_array_equal(found, [X[0], X[0]])


def test_a_residual_may_have_no_value():
    def function(blocks):
        return [1 / float(blocks[0][0])], [np.ones((1, 2))]

    user, zero = UserFunction.at(function, X), [np.zeros(2)]
    assert user.core(zero, True) is None
    assert np.isnan(user.evaluate(zero)[0]).all()
    with pytest.raises(ZeroDivisionError):
        user(zero, True)


def changing(values):
    values[0] += 1
    return np.ones(1), [np.ones((1, 3))]


def test_a_change_of_the_arguments_is_refused():
    with pytest.raises(InputError, match=r"mine: .*block 0"):
        called("mine", changing, X)
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.0, 0, 0, 1], "so3")  # the checker passes steps of it
    graph.add_factor(bundle.FunctionFactor(["x"], changing))
    with pytest.raises(InputError, match=r"FunctionFactor\('x'\).*block 0"):
        graph.check_gradients()
