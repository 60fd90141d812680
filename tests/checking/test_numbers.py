"""The numbers that verdicts and sentences are made of."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.checking.comparison import Comparison


@pytest.mark.parametrize(
    ("factor", "words"), [(0.25, "4.000 times too small"), (2.5, "2.500 times too large")]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_factor_is_named_with_its_direction(factor, words, sign):
    def function(blocks):
        return np.sin(blocks[0]), [sign * factor * np.diag(np.cos(blocks[0]))]

    report = bundle.check_gradients(function, [[0.3]])
    assert report.findings[0].kind == "factor"
    assert report.findings[0].factor == pytest.approx(sign * factor)
    assert words in report.findings[0].sentence
    assert ("sign" in report.findings[0].sentence) == (sign < 0)


def comparison(reference, deviation, uncertainty):
    reference = np.array(reference, float).reshape(-1, 1, 1)
    shape = reference.shape
    return Comparison(
        reference + np.reshape(deviation, shape), reference, np.reshape(uncertainty, shape)
    )


def test_small_entries_are_measured_by_a_thousandth_of_the_usual_size():
    found = comparison([1.0, 1.0, 1e-6], [0.0, 0.0, 1e-4], [0.0, 0.0, 0.0])
    assert found.scale.ravel() == pytest.approx([1.0, 1.0, 1e-3])
    assert found.deviation.ravel() == pytest.approx([0.0, 0.0, 0.1])


def test_what_the_reference_does_not_know_is_no_error():
    found = comparison([2.0, 2.0, 2.0], [0.4, 0.1, 0.1], [0.1, 0.2, np.inf])
    assert found.doubt.ravel() == pytest.approx([0.05, 0.1, np.inf])
    assert found.error.ravel() == pytest.approx([0.15, 0.0, 0.0])
