"""Places of curves and bars on a page, computed from what they show."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from bundle.base.words import amount
from bundle.figures.marks import Bars, Figure, StackedBars, Steps, linear, logarithmic
from bundle.reports.page import svg
from bundle.reports.page.svg_planes import contours

LEFT, RIGHT = svg.LEFT, svg.WIDTH - svg.RIGHT
TOP, BOTTOM = svg.TOP, svg.HEIGHT - svg.BOTTOM


def curves(steps, x, y):
    marks = tuple(Steps("a", np.array(xs), np.array(ys)) for xs, ys in steps)
    return svg.drawing(Figure(name="f", title="", x=x, y=y, marks=marks))


def bars(values, **look):
    return svg.drawing(Figure(name="f", title="", marks=(Bars(values, amount, **look),)))


def stacked_bars(rows, unit):
    return svg.drawing(Figure(name="f", title="", marks=(StackedBars(rows, unit),)))


def corners(markup):
    """The corners of the first curve: M x y, then H x V y, and so on."""
    path = re.search(r' d="M([\d.]+) ([\d.]+)((?:H[\d.]+V[\d.]+)*)"', markup)
    found = [(float(path[1]), float(path[2]))]
    found += [(float(x), float(y)) for x, y in re.findall(r"H([\d.]+)V([\d.]+)", path[3])]
    return found


def test_labels_of_bars_break_at_underscores():
    assert "SPARSE_<wbr>SCHUR" in bars({"SPARSE_SCHUR": 1.0})


def test_larger_values_stand_higher_and_further_right():
    line = [0.0, 5.0, 10.0], [0.0, 1.0, 4.0]
    found = corners(curves([line], linear([10.0]), linear([4.0])))
    middle = LEFT + 0.5 * (RIGHT - LEFT)
    quarter = BOTTOM - 0.25 * (BOTTOM - TOP)
    expected = [(LEFT, BOTTOM), (middle, quarter), (RIGHT, TOP)]
    for corner, place in zip(found, expected, strict=True):
        assert corner == pytest.approx(place, abs=0.06)


def test_a_value_holds_until_the_next():
    """First along the x axis at the old value, then up or down: H before V."""
    line = [1.0, 2.0], [9.0, 3.0]
    markup = curves([line], linear([2.0]), linear([9.0]))
    assert re.search(r"M[\d.]+ [\d.]+H[\d.]+V[\d.]+\"", markup)


def test_ticks_stand_at_their_values():
    markup = curves([], linear([10.0], "across"), linear([4.0], "up"))
    lines = [
        tuple(float(number) for number in found)
        for found in re.findall(r'x1="([\d.]+)" x2="([\d.]+)" y1="([\d.]+)" y2="([\d.]+)"', markup)
    ]
    upright = [x1 for x1, x2, y1, y2 in lines if (x1, y1, y2) == (x2, TOP, BOTTOM)]
    level = [y1 for x1, x2, y1, y2 in lines if (x1, x2, y1) == (LEFT, RIGHT, y2)]
    width, height = RIGHT - LEFT, BOTTOM - TOP
    assert upright == pytest.approx([LEFT + width * k / 5 for k in range(6)], abs=0.06)
    assert level == pytest.approx([BOTTOM - height * k / 4 for k in range(5)], abs=0.06)
    words = re.findall(r">([^<>]+)</text>", markup)
    assert words == ["0", "2", "4", "6", "8", "10", "0", "1", "2", "3", "4", "across", "up"]


def test_a_logarithmic_axis_has_equal_steps_for_equal_ratios():
    scale = logarithmic([1e-3, 1.0])
    line = [1.0, 2.0, 3.0, 4.0], [1e-3, 1e-2, 1e-1, 1.0]
    heights = [y for _, y in corners(curves([line], linear([4.0]), scale))]
    third = (BOTTOM - TOP) / 3
    assert heights == pytest.approx([BOTTOM - third * k for k in range(4)], abs=0.06)


def widths(markup):
    """The shares of the room that the texts leave."""
    return [float(width) for width in re.findall(r"width:calc\(([\d.]+)\*", markup)]


def rooms(markup):
    """The widths that are kept for the texts, in em."""
    return {float(room) for room in re.findall(r"100% - ([\d.]+)em", markup)}


def test_bars_are_as_long_as_their_values_on_the_scale():
    values = {"a": 1.0, "b": 10.0, "c": 100.0, "none": math.nan, "nothing": 0.0}
    found = widths(bars(values))
    scale = logarithmic([1 / 3, 1.0, 100.0])
    assert found == pytest.approx([scale(v) for v in (1.0, 10.0, 100.0)] + [0, 0], abs=1e-4)
    assert found[2] - found[1] == pytest.approx(found[1] - found[0], abs=2e-4) != 0
    (room,), (more,) = rooms(bars(values)), rooms(bars(values, impossible=["c"]))
    assert room > 0.6 * len("none") and more > room  # the words of the impossible bar are longer
    hatched = [row for row in bars(values, impossible=["c"]).split("<div") if "impossible" in row]
    assert len(hatched) == 1


def test_folded_bars_share_the_scale():
    values = {name: 10.0**power for power, name in enumerate("abcdefgh")}
    folded = bars(values, most=5)
    assert widths(folded) == widths(bars(values))
    assert folded.index(">e<") < folded.index("<details") < folded.index(">f<")
    assert "<details" not in bars(values, most=7)


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (640, 640)])
def test_the_longer_side_of_an_image_is_400(size):
    """A portrait is no larger than a landscape: a limit of the height would shrink its letters."""
    x, y = (linear([float(length)]) for length in size)
    markup = svg.drawing(Figure(name="f", title="", x=x, y=y, marks=(), is_image=True))
    drawn = [float(found) for found in re.findall(r'(?:width|height)="([\d.]+)"', markup)]
    assert drawn == pytest.approx([400 * length / max(size) for length in size], abs=0.1)


def test_labels_of_contours_do_not_meet():
    """Both levels run through a corner, where there is room for one label."""
    corner = np.zeros((12, 12))
    corner[-1, -1], corner[-2, -1], corner[-1, -2] = 4.0, 2.0, 2.0
    places = re.findall(r'<text x="([\d.]+)" y="([\d.]+)"', contours(corner, (1, 3), (9, 9), 2))
    assert len(places) == 1
    apart = contours(np.linspace(0, 4, 12) * np.ones((12, 1)), (1, 3), (30, 30), 2)
    assert apart.count("<text") == 2


def test_stacked_bars_add_up_to_their_totals():
    rows = {"fast": {"a": 1.0, "rest": 1.0}, "slow": {"a": 3.0, "rest": 5.0}}
    found = widths(stacked_bars(rows, " s"))
    assert found == pytest.approx([1 / 8, 1 / 8, 3 / 8, 5 / 8], abs=1e-4)
    assert re.findall(r">([\d.]+) s<", stacked_bars(rows, " s")) == ["2", "8"]
    colours = re.findall(r"background:var\(--(\w+)\)", stacked_bars(rows, " s"))
    assert colours == ["c0", "rest"] * 3  # two bars and the legend


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([4.0], [0, 1, 2, 3, 4]),
        ([9.0], [0, 2, 4, 6, 8]),
        ([23.0], [0, 5, 10, 15, 20]),
        ([0.7], [0, 0.2, 0.4, 0.6]),
        ([10.0], [0, 2, 4, 6, 8, 10]),
        ([51.0], [0, 20, 40]),
    ],
)
def test_steps_of_a_linear_axis_are_1_2_or_5(values, ticks):
    assert list(linear(values).ticks) == pytest.approx(ticks)


def test_a_linear_axis_may_start_elsewhere():
    scale = linear([7.0, 9.0], low=None)
    assert (scale.low, scale.high) == (7.0, 9.0)
    assert scale(8.0) == 0.5
    assert list(scale.ticks) == pytest.approx([7, 7.5, 8, 8.5, 9])


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([1.0, 1000.0], [0, 1, 2, 3]),
        ([5.0, 70.0], [0, 1, 2]),
        ([1e-9, 1e3], [-9, -7, -5, -3, -1, 1, 3]),
        ([10.0], [1, 2]),
    ],
)
def test_steps_of_a_logarithmic_axis_are_powers_of_ten(values, ticks):
    scale = logarithmic(values)
    assert [math.log10(tick) for tick in scale.ticks] == pytest.approx(ticks)
    assert (scale.low, scale.high) == pytest.approx((scale.ticks[0], scale.ticks[-1]))
