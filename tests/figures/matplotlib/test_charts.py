"""The pictures show the numbers of the comparison."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest

import bundle
from bundle import pictures
from bundle.figures.cost_figures import cost_curve, labels, profile_curve, styles
from tests.figures.matplotlib.comparisons import METHODS, comparison
from tests.scenes import make_problem


def axis():
    made, axes = pictures.figure()
    return made, axes[0, 0]


def test_cost_curves_fall_to_the_best_and_start_with_the_build():
    made = comparison()
    for index, run in enumerate(made.runs):
        times, gaps = cost_curve(made, index)
        if run.outcome == "out_of_memory":
            assert len(times) == len(gaps) == 0
            continue
        assert (np.diff(gaps) <= 0).all() and (np.diff(times) > 0).all()
        assert gaps[0] == pytest.approx(30, rel=0.01)
        if run.is_usable:
            final = run.final_cost / made.best_cost(run.problem) - 1
            assert gaps[-1] == pytest.approx(max(final, 1e-9), rel=1e-6)
            assert times[0] > run.measurement.build_time_in_seconds


def test_axis_of_costs_has_a_line_for_every_run_that_left_a_trace():
    made = comparison()
    _, ax = axis()
    pictures.draw_cost_against_time(ax, made, 1)
    names = [line.get_label() for line in ax.lines]
    traced = [run.method.name for run in made.runs_of(1) if run.outcome != "out_of_memory"]
    assert names == traced
    assert made.problems[1].name.endswith(ax.get_title().removeprefix("..."))
    first = made.runs.index(made.runs_of(1)[0])
    np.testing.assert_allclose(ax.lines[0].get_xdata(), cost_curve(made, first)[0])


def test_names_are_no_formulas(tmp_path):
    made, axes = pictures.figure(1, 2)
    pictures.draw_cost_against_time(axes[0, 0], comparison(), 1)
    pictures.draw_breakdown(axes[0, 1], comparison(), 1)
    made.savefig(tmp_path / "name.png")


def test_bars_of_a_breakdown_add_up_to_the_total():
    made = comparison()
    _, ax = axis()
    pictures.draw_breakdown(ax, made)
    runs = sorted(made.runs_of(0), key=lambda run: run.total_time_in_seconds)
    names = [" ".join(label.get_text().split()) for label in ax.get_yticklabels()]
    assert names == [run.method.name for run in runs]
    ends = np.zeros(len(runs))
    for container in ax.containers:
        ends += [bar.get_width() for bar in container]
    np.testing.assert_allclose(ends, [run.total_time_in_seconds for run in runs])


def test_profiles_are_stairs_through_the_shares():
    made = comparison()
    for profile in made.profiles:
        factors, shares = profile_curve(profile, 40.0)
        assert factors[0] == 1.0 and factors[-1] == 40.0
        for factor, share in zip(factors[:-1], shares[:-1], strict=True):
            assert share == profile.share(factor)
            assert factor == 1.0 or profile.share(factor * (1 - 1e-9)) < share
    _, ax = axis()
    pictures.draw_performance_profile(ax, made, 1e-3)
    assert len(ax.lines) == len(METHODS)


def test_one_problem_has_no_profile_and_nothing_to_fail_on():
    _, ax = axis()
    pictures.draw_performance_profile(ax, comparison(1))
    assert not ax.lines


def test_methods_differ_in_colour_or_line():
    looks = styles(METHODS)
    assert len(set(looks.values())) == len(METHODS)
    same_solver = [looks[METHODS[0]], looks[METHODS[3]]]
    assert same_solver[0].colour == same_solver[1].colour
    assert same_solver[0].line != same_solver[1].line
    assert labels(METHODS)[METHODS[0]] == "fused SPARSE_SCHUR"


def test_flops_are_bars_and_what_does_not_fit_is_hatched():
    _, ax = axis()
    pictures.draw_flops(ax, {"a": 1e12, "b": 1e6, "c": float("nan")}, impossible=["a"])
    bars = [bar for (bar,) in ax.containers]
    ends = [bar.get_x() + bar.get_width() for bar in bars]
    assert ends == pytest.approx([1e12, 1e6, ax.get_xlim()[0]])
    assert [bool(bar.get_hatch()) for bar in bars] == [True, False, False]
    assert ax.get_xscale() == "log"
    words = [text.get_text().split() for text in ax.texts]
    assert [word[0] for word in words] == ["1e+12", "1e+06", "none"]
    assert [len(word) > 1 for word in words] == [True, False, False]  # says that it does not fit


@pytest.mark.parametrize("flops", [{}, {"a": float("nan")}, {"a": 0.0}])
def test_nothing_to_draw_draws_nothing(flops, tmp_path):
    made, axes = pictures.figure(1, 2)
    pictures.draw_flops(axes[0, 0], flops)
    pictures.draw_column_counts(axes[0, 1], {})
    made.savefig(tmp_path / "empty.png")


def test_column_counts_cover_the_width_whatever_their_bins():
    _, ax = axis()
    pictures.draw_column_counts(ax, {"natural": [2, 2, 2, 2, 1, 0], "amd": [1.0, 0.0]})
    values, edges, _ = ax.patches[0].get_data()
    assert values.tolist() == [2, 2, 2, 2, 1, 0]
    assert edges[0] == 0 and edges[-1] == 1
    assert ax.patches[1].get_data().edges.tolist() == [0, 0.5, 1]


def test_figures_are_written_as_png_and_svg(tmp_path: Path):
    star = pictures.MatrixPattern.from_edges(7, [(0, leaf) for leaf in range(1, 7)], 6)
    made = pictures.draw_orderings(star, {"hub first": None, "hub last": [1, 2, 3, 4, 5, 6, 0]})
    assert len(made.axes) == 4
    words = [ax.get_xlabel() for ax in made.axes]
    # 7 + 2 * 6 blocks of 36; L: 7 triangles of 21 and 21 or 6 blocks of 36.
    assert words[0].startswith("684 nonzeros, both triangles")
    assert words[2].startswith("903 nonzeros, lower triangle")
    assert words[3].startswith("363 nonzeros, lower triangle")
    for name in ("orders.png", "orders.svg"):
        made.savefig(tmp_path / name)
    picture = cv2.imread(str(tmp_path / "orders.png"))
    assert (picture == 0).all(2).any(), "no entry is black"
    orange = np.abs(picture.astype(int) - (15, 72, 217)).max(2) < 20  # blue, green, red
    assert orange.any()
    assert ElementTree.parse(tmp_path / "orders.svg").getroot().tag.endswith("svg")


def test_orders_are_found_by_their_names():
    problem = make_problem(num_images=6, num_points=40, track=2, seed=3)
    options = bundle.SolveOptions(gauge="none")
    reduced = pictures.reduced_pattern(problem, options)
    made = pictures.draw_orderings(reduced, ["natural", "amd"])
    assert [ax.get_title() for ax in made.axes] == ["S, natural", "S, amd", "L, natural", "L, amd"]
    whole = pictures.information_pattern(problem, options)
    assert whole.sizes.tolist() == [3] * 40 + [8] * 6
    # A point of two images: its own block, two with its images, both triangles.
    assert whole.num_nonzeros == 40 * (9 + 2 * 2 * 24) + 6 * 64
    with pytest.raises(bundle.InputError, match="ordering"):
        pictures.order_blocks(reduced, "best")


def test_empty_matrix_is_drawn_empty(tmp_path: Path):
    made, ax = axis()
    pictures.spy(ax, (np.empty(0, int), np.zeros(1, int), np.empty(0, int)))
    made.savefig(tmp_path / "empty.png")


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(bundle.InputError, match="pip install matplotlib") as caught:
        pictures.figure()
    assert "\n" not in str(caught.value)


def test_matplotlib_waits_until_something_is_drawn():
    code = "import sys, bundle.pictures, bundle.html; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
