"""bundle.ProgressBar: one bar per solve."""

import io
import sys

import pytest

import bundle
from tests.scenes import make_problem


def test_each_solve_has_a_bar_with_its_last_iteration_and_cost():
    text = io.StringIO()
    problem = make_problem(num_images=3, num_points=12)
    with bundle.ProgressBar(file=text, mininterval=0, ascii=True) as bar:
        result = bundle.solve(problem, progress=bar)
        bundle.solve(problem, progress=bar, max_num_iterations=2)
    first, second = text.getvalue().strip().split("\n")
    last = first.split("\r")[-1]
    assert f"{len(result.iterations['cost']) - 1} iterations" in last
    assert f"cost {result.iterations['cost'][-1]:.6e}" in last
    assert "2 iterations" in second.split("\r")[-1]


def test_settings_are_those_of_tqdm():
    text = io.StringIO()
    bar = bundle.ProgressBar(file=text, desc="rounds", total=9)
    bundle.solve(make_problem(num_images=3, num_points=12), progress=bar, max_num_iterations=1)
    bar.close()
    bar.close()
    assert text.getvalue().strip().startswith("rounds:")
    assert "/9" in text.getvalue()


def test_without_tqdm_one_line_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with pytest.raises(bundle.InputError, match=r"expected the package tqdm.*pip install tqdm"):
        bundle.ProgressBar()
