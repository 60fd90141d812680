"""Errors of the last digits: of one entry, of a constant, of single precision, of differences."""

import numpy as np
import pytest

import bundle

START = [[1.3, 2.1]]


def residual(x, y):
    return np.array([x * y, x + y**2, np.sin(x) * y])


def jacobian(x, y):
    return np.array([[y, x], [1, 2 * y], [np.cos(x) * y, np.sin(x)]])


def found(change, values=residual, derivatives=jacobian):
    """Return kind, columns and rows of the findings about a Jacobian with a mistake."""

    def function(blocks):
        x, y = blocks[0]
        wrong = derivatives(x, y)
        change(wrong, x, y)
        return values(x, y), [wrong]

    report = bundle.check_gradients(function, START)
    assert report.verdict == "wrong"
    return report.findings


@pytest.mark.parametrize("size", [5e-7, 4.37e-6, 9.9e-5, 1e-4, 2e-4, -3e-6])
def test_one_entry_with_another_factor(size):
    """A constant factor, however near to 1, is no rounding."""

    def change(wrong, _x, _y):
        wrong[0, 0] *= 1 + size

    (finding,) = found(change)
    assert (finding.kind, finding.columns, finding.rows) == ("factor", ("block 0 [0]",), (0,))
    assert finding.factor - 1 == pytest.approx(size, rel=0.01)
    times = 1 + size if size > 0 else 1 / (1 + size)
    word = "large" if size > 0 else "small"
    digits = finding.sentence.split(" times too ")[0].split()[-1]
    assert f" times too {word}, in residual 0 only" in finding.sentence
    assert float(digits) - 1 == pytest.approx(times - 1, rel=0.01)


@pytest.mark.parametrize("size", [2e-6, 3e-5])
def test_one_entry_with_a_small_term(size):
    def change(wrong, x, y):
        wrong[2, 0] += size * x * y

    (finding,) = found(change)
    assert (finding.kind, finding.columns, finding.rows) == ("small_part", ("block 0 [0]",), (2,))
    assert "last digits of residual 2 only" in finding.sentence


def test_two_of_three_entries_are_most():
    """Errors without a pattern in most entries may be those of rounding."""

    def change(wrong, x, y):
        wrong[:2, 0] *= 1 + 2e-5 * np.sin([5e3 * x, 7e3 * y])

    (finding,) = found(change)
    assert (finding.kind, finding.rows) == ("float_precision", (0, 1))


def test_one_residual_is_compared_with_its_other_columns():
    def values(x, y):
        return np.array([np.exp(x) * y])

    def derivatives(x, y):
        return np.array([[np.exp(x) * y, np.exp(x)]])

    def first(wrong, x, _y):
        wrong[0, 0] *= 1 + 1e-5 * np.sin(5e3 * x)

    def both(wrong, x, y):
        wrong[0] *= 1 + 1e-5 * np.sin([5e3 * x, 7e3 * y])

    assert [one.kind for one in found(first, values, derivatives)] == ["small_part"]
    assert [one.kind for one in found(both, values, derivatives)] == ["float_precision"]


@pytest.mark.parametrize("step", [1e-6, 1e-5])
def test_differences_of_curved_functions_are_no_single_entries(step):
    def values(x, y):
        return np.array([np.sin(x * y), np.exp(x) * y**2, x**3 * np.cos(y)])

    def differences(wrong, x, y):
        here = values(x, y)
        wrong[:, 0] = (values(x + step, y) - here) / step
        wrong[:, 1] = (values(x, y + step) - here) / step

    findings = found(differences, values)
    assert {one.kind for one in findings} == {"float_precision"}
