"""Nothing is cut at the edge of a picture, and no legend covers what is drawn."""

from __future__ import annotations

import dataclasses
import itertools

import pytest

from bundle import pictures
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from tests.figures.matplotlib.comparisons import comparison
from tests.scenes import make_problem

LONG = "SPARSE_NORMAL_CHOLESKY amd"
PROFILES = {f"SPARSE_SCHUR order {i}": [5, 4 + i, 3, 1, 0] for i in range(7)}
PICTURES = {
    "cost": lambda ax: pictures.draw_cost_against_time(ax, comparison(), 1),
    "breakdown": lambda ax: pictures.draw_breakdown(ax, comparison()),
    "profile": lambda ax: pictures.draw_performance_profile(ax, comparison()),
    "flops": lambda ax: pictures.draw_flops(
        ax, {LONG: 1e12, "b": 1e6, "c": float("nan")}, impossible=[LONG]
    ),
    "columns": lambda ax: pictures.draw_column_counts(ax, PROFILES),
    "covisibility": lambda ax: pictures.draw_covisibility(ax, make_problem(num_images=9)),
}


def check_everything_shows(made):
    made.draw_without_rendering()  # lays out
    page = made.bbox
    for ax in made.axes:
        drawn, whole = ax.get_window_extent(), ax.get_tightbbox()  # with all that is written
        assert page.x0 <= whole.x0 + 1 and whole.x1 <= page.x1 + 1
        assert page.y0 <= whole.y0 + 1 and whole.y1 <= page.y1 + 1
        least = 0.35 * page.width / len(made.axes) ** 0.5
        assert drawn.width > least
        assert drawn.height > least or ax.get_aspect() != "auto"
        legend = ax.get_legend()
        if legend is None:
            continue
        box = legend.get_window_extent()
        assert not box.overlaps(drawn)
        assert not box.overlaps(ax.xaxis.label.get_window_extent())
        assert page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0


@pytest.mark.parametrize("width", [3.4, 4.0])
@pytest.mark.parametrize("name", PICTURES)
def test_one_picture(name, width):
    made, axes = pictures.figure(width=width)
    PICTURES[name](axes[0, 0])
    check_everything_shows(made)


def doubled(made):
    """Every method also with a dogleg: fourteen curves."""
    more = [
        dataclasses.replace(
            run, method=dataclasses.replace(run.method, trust_region_strategy_type="dogleg")
        )
        for run in made.runs
    ]
    return dataclasses.replace(made, runs=(*made.runs, *more))


@pytest.mark.parametrize("draw", [pictures.draw_cost_against_time, pictures.draw_breakdown])
def test_a_column_of_a_paper_holds_fourteen_methods(draw):
    made, axes = pictures.figure(width=3.4, height=2.6)
    draw(axes[0, 0], doubled(comparison(1)))
    check_everything_shows(made)
    ax = axes[0, 0]
    assert made.get_figwidth() == 3.4 and ax.get_window_extent().height / made.dpi > 1.5
    texts = [*ax.get_xticklabels(), *ax.get_yticklabels(), *ax.get_legend().get_texts()]
    assert {text.get_fontsize() for text in texts} <= {7.0, 8.0}
    rows = [text.get_window_extent() for text in ax.get_yticklabels() if text.get_text()]
    apart = sorted(rows, key=lambda box: box.y0)
    assert all(one.y1 <= other.y0 + 1 for one, other in itertools.pairwise(apart))
    colours = {(line.get_color(), line.get_linestyle()) for line in ax.lines}
    assert len(colours) == len(ax.lines)


def test_pictures_side_by_side():
    made, axes = pictures.figure(2, 2, width=3.4)
    for ax, name in zip(axes.flat, ["cost", "breakdown", "profile", "columns"], strict=True):
        PICTURES[name](ax)
    check_everything_shows(made)


def test_orderings():
    star = MatrixPattern.from_edges(7, [(0, leaf) for leaf in range(1, 7)], 600)
    check_everything_shows(pictures.draw_orderings(star, ["natural", "amd"]))


def test_of_a_long_name_the_end_is_shown():
    _, axes = pictures.figure()
    name = "/a/long/way/to/" + 5 * "projects/" + "garden/sparse/0"
    made = comparison(name=name)
    pictures.draw_breakdown(axes[0, 0], made)
    title = axes[0, 0].get_title("right")  # the axis is narrower than its names
    assert name.endswith(title.removeprefix("...")) and 40 < len(title) < 50
