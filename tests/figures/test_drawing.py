"""One figure, two renderers: the same ranges, colours and legends, whatever is drawn."""

from __future__ import annotations

import math
import re
import time
import typing
from xml.etree import ElementTree

import numpy as np
import pytest

from bundle import pictures
from bundle.figures.marks import (
    Axis,
    Bars,
    Cells,
    Dots,
    Ellipses,
    Figure,
    Line,
    Mark,
    Matrix,
    Photo,
    Places,
    StackedBars,
    Steps,
    Vectors,
    line_figure,
    linear,
    logarithmic,
    over_image,
    round_down,
    square,
)
from bundle.figures.matplotlib import draw as matplotlib_draw
from bundle.reports.page import svg
from bundle.reports.page.page import asset
from bundle.reports.page.svg import drawing

HOSTILE = "</svg><script>alert(1)</script>&\"'"
RNG = np.random.default_rng(3)


def chart(*marks, x=None, y=None, **more):
    x = linear([0.0, 10.0], "across") if x is None else x
    y = linear([0.0, 4.0], "up") if y is None else y
    return Figure(name="f", title="Title", x=x, y=y, marks=marks, **more)


def plane(*marks):
    return over_image(np.array([0.0, 0.0, 640.0, 480.0]), "plane", "Plane", *marks)


def parsed(figure):
    """Return the markup of a figure, which must be well formed and without nan."""
    markup = drawing(figure)
    assert not re.search(r"\b(nan|inf)\b", re.sub(r">[^<]*<", "><", markup))
    return ElementTree.fromstring(f"<div>{markup}</div>")


def axis_of(figure):
    made, axes = pictures.figure()
    matplotlib_draw.draw(axes[0, 0], figure)
    made.canvas.draw()
    return axes[0, 0]


def corners(path):
    """Return the points of a path of absolute commands."""
    found, at = [], [0.0, 0.0]
    for letter, numbers in re.findall(r"([MLHV])([-\d. ]+)", path):
        values = [float(value) for value in numbers.split()]
        at = {"H": [values[0], at[1]], "V": [at[0], values[0]]}.get(letter, values)
        found.append(at)
    return np.array(found)


def in_data(points, figure):
    """Return places of a page in the coordinates of the axes."""
    share = (points - (svg.LEFT, svg.HEIGHT - svg.BOTTOM)) / (
        svg.WIDTH - svg.LEFT - svg.RIGHT,
        -(svg.HEIGHT - svg.TOP - svg.BOTTOM),
    )
    columns = []
    for values, axis in zip(share.T, (figure.x, figure.y), strict=True):
        low, high = (axis.low, axis.high)
        if axis.is_logarithmic:
            columns.append(low * (high / low) ** values)
        else:
            columns.append(low + values * (high - low))
    return np.column_stack(columns)


X = np.array([1.0, 2.0, 5.0, 10.0])
Y = np.array([1.0, 3.0, 2.0, 4.0])
LINES = (
    Line("first", X, Y, colour=0),
    Line("second", X, Y / 2, colour=1, dash=2),
    Steps("third", X, Y / 4, 5, 1),
    Line("limit", X, np.ones(4), colour=6, dash=3),
)
FIGURES = {
    "linear": chart(*LINES),
    "logarithmic": chart(*LINES, x=logarithmic(X), y=logarithmic([0.1, 10.0])),
    "square": chart(
        *LINES, is_plan=True,
        **dict(zip("xy", square((-4, -4), (14, 8), ("east", "north"), 0.0), strict=True)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_both_renderers_have_the_ranges_of_the_description(name):
    figure = FIGURES[name]
    ax = axis_of(figure)
    assert ax.get_xlim() == pytest.approx((figure.x.low, figure.x.high))
    assert ax.get_ylim() == pytest.approx((figure.y.low, figure.y.high))
    for axis, scale in ((figure.x, ax.get_xscale()), (figure.y, ax.get_yscale())):
        assert scale == ("log" if axis.is_logarithmic else "linear")
    assert (ax.get_xlabel(), ax.get_ylabel()) == (figure.x.label, figure.y.label)
    paths = parsed(figure).findall("./svg/path[@class='curve']")
    for path, line in zip(paths, ax.lines, strict=True):
        seen = in_data(corners(path.get("d")), figure)
        given = line.get_xydata()
        if "H" in path.get("d"):
            given = np.repeat(given, 2, axis=0)[1:]
            given = np.column_stack([given[:, 0], np.repeat(line.get_ydata(), 2)[:-1]])
            seen = seen[: len(given)]
        np.testing.assert_allclose(seen, given, rtol=0.01, atol=0.02)


@pytest.mark.parametrize("name", FIGURES)
def test_both_legends_have_the_same_names_colours_and_dashes(name):
    root, ax = parsed(FIGURES[name]), axis_of(FIGURES[name])
    entries = root.findall("./ul[@class='legend']/li")
    names = ["".join(entry.itertext()) for entry in entries]
    assert names == [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["first", "second", "third", "limit"]
    strokes = [entry.find("./svg/path") for entry in entries]
    drawn = root.findall("./svg/path[@class='curve']")
    for stroke, path, line in zip(strokes, drawn, ax.lines, strict=True):
        for found in (stroke, path):
            number = int(re.search(r"--c(\d)", found.get("style"))[1])
            assert line.get_color() == matplotlib_draw.COLOURS[number]
            dash = found.get("stroke-dasharray")
            assert line.get_linestyle() == matplotlib_draw.DASHES[svg.DASHES.index(dash)]


def test_the_palette_is_that_of_light_pages():
    light = asset("page.css").split("prefers-color-scheme: dark")[0]
    found = re.findall(r"--c\d: (#\w+);", light)
    assert tuple(found) == matplotlib_draw.COLOURS
    assert len(found) == len(set(found)) == 10


def test_an_image_plane_goes_down_and_has_its_corners():
    figure = plane(Cells(np.array([[1.0, np.nan], [3.0, 4.0]]), 5.0, "px"))
    ax = axis_of(figure)
    assert ax.get_xlim() == (0, 640) and ax.get_ylim() == (480, 0)
    root = parsed(figure)
    words = [text.text for text in root.findall("./svg/text")]
    assert words == ["0, 0", "640, 480 px"]
    cells = {
        int(cell.get("data-cell")): cell for cell in root.iter("rect") if cell.get("data-cell")
    }
    assert set(cells) == {0, 2, 3}
    shown = np.ma.filled(ax.images[0].get_array(), np.nan).ravel()
    low, high = ax.images[0].get_clim()
    for cell, rect in cells.items():
        share = (shown[cell] - low) / (high - low)
        assert float(rect.get("fill-opacity")) == pytest.approx(share, abs=1e-3)
    assert float(cells[2].get("x")) == pytest.approx(2.0)
    assert float(cells[2].get("y")) == pytest.approx(2.0 + 150)


def test_vectors_of_an_image_plane_start_where_they_are():
    at, step = np.array([[120.0, 60.0], [700.0, 500.0]]), np.array([[10.0, -20.0], [0.0, 30.0]])
    figure = over_image(np.array([100.0, 50.0, 740.0, 530.0]), "f", "", Vectors(at, step))
    (path,) = parsed(figure).findall("./svg/path")
    pairs = [part.split("l") for part in path.get("d")[1:].split("M")]
    for (start, way), place, vector in zip(pairs, at, step, strict=True):
        seen = [np.array(text.split(), float) * 640 / 400 for text in (start, way)]
        np.testing.assert_allclose(seen[0], place - (100, 50) + 2 * 1.6, atol=0.1)
        np.testing.assert_allclose(seen[1], vector, atol=0.1)
    lines = axis_of(figure).collections[0].get_segments()
    np.testing.assert_allclose(lines, np.stack([at, at + step], axis=1))


EACH = {
    Line: chart(Line("a", X, Y, colour=2, sigma=0.1 * Y, error=0.2 * Y)),
    Steps: chart(Steps("a", np.append(X, 11.0), Y)),
    Places: chart(Places({"here": 3.0, "there": 9.0})),
    Bars: chart(Bars({"a": 3.0, "b": math.nan, "c": 0.0}, str, ["a"])),
    StackedBars: chart(StackedBars({"run": {"a": 1.0, "rest": 2.0}}, " s")),
    Cells: plane(Cells(RNG.random((5, 7)), 1.0, "px", ("title",) * 35, (0.3, 0.6))),
    Vectors: plane(Vectors(640 * RNG.random((5, 2)), RNG.random((5, 2)))),
    Dots: chart(Dots(np.column_stack([X, Y]), (0, 1, 6, 0), tuple("abcd"), is_labelled=True)),
    Ellipses: chart(Ellipses(np.array([np.eye(2), np.diag([4.0, 1.0])]), 1)),
    Matrix: chart(Matrix(("f", "k"), np.array([[1.0, -0.25], [-0.25, 1.0]]))),
}


def test_each_mark_is_drawn_by_both():
    assert {*EACH, Photo} == set(typing.get_args(Mark))
    empty = len(drawing(chart()))
    for figure in EACH.values():
        assert len(drawing(figure)) != empty
        ax = axis_of(figure)
        assert ax.lines or ax.patches or ax.images or ax.collections
    picture = plane(Photo("data:image/png;base64,AA"))
    assert parsed(picture).find("./svg").get("class") == "photographed"
    assert len(axis_of(plane(Photo(np.zeros((3, 4))))).images) == 1


def test_bars_are_the_same_in_both():
    values = {"a": 3.0, "b": 3000.0, "none": math.nan, "zero": 0.0, "c": 40.0}
    for is_ordered, names in ((False, [*values]), (True, ["a", "b", "none", "c"])):
        figure = chart(Bars(values, "{:g}".format, ["c"], is_ordered=is_ordered))
        root, ax = parsed(figure), axis_of(figure)
        rows = ["".join(cell.itertext()) for cell in root.findall("./div/div")]
        assert rows[::2] == [tick.get_text() for tick in ax.get_yticklabels()] == names
        assert rows[1::2] == [text.get_text().replace("\n", ", ") for text in ax.texts]
        widths = [float(re.search(r"width:calc\(([\d.]+)", bar.get("style"))[1]) for bar in
                  root.findall("./div/div/div[@style]")]  # fmt: skip
        spans = [np.log(bar.get_x() + bar.get_width()) - np.log(bar.get_x()) for bar in ax.patches]
        np.testing.assert_allclose(np.divide(widths, max(widths)), spans / max(spans), atol=1e-3)


def test_correlations_are_the_same_in_both():
    values = np.array([[1.0, -0.25, 0.9], [-0.25, 1.0, 0.0], [0.9, 0.0, 1.0]])
    figure = chart(Matrix(("f", "k", "cx"), values))
    root, ax = parsed(figure), axis_of(figure)
    rows = [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]
    assert rows[0] == ["", "f", "k", "cx"]
    assert [row[0] for row in rows[1:]] == [tick.get_text() for tick in ax.get_yticklabels()]
    texts = [text for row in rows[1:] for text in row[1:]]
    assert texts == [text.get_text() for text in ax.texts]
    assert [float(text) for text in texts] == values.ravel().tolist()
    np.testing.assert_array_equal(ax.images[0].get_array(), values)


def test_a_curve_of_one_step_is_a_dot_in_both():
    figure = chart(Steps("once", np.array([3.0]), np.array([2.0]), colour=4))
    root, ax = parsed(figure), axis_of(figure)
    (dot,) = root.findall("./svg/circle")
    place = np.array([[float(dot.get("cx")), float(dot.get("cy"))]])
    np.testing.assert_allclose(in_data(place, figure), [[3.0, 2.0]], atol=0.02)
    assert "--c4" in dot.get("style")
    assert ax.lines[0].get_marker() == "."


def test_both_write_the_note():
    figure = chart(*LINES, note="A note about what is drawn, long enough for a second line.")
    assert figure.note in svg.draw(figure)
    ax = axis_of(figure)
    assert ax.texts[-1].get_text().replace("\n", " ") == figure.note
    assert not ax.texts[-1].get_window_extent().overlaps(ax.get_legend().get_window_extent())


def test_ellipses_dots_and_vectors_stand_where_they_are():
    x, y = square((-3.0, -3.0), (3.0, 3.0), ("east", "north"), 0.0)
    at, step = np.array([[1.0, 2.0]]), np.array([[0.5, -0.25]])
    figure = chart(
        Dots(at), Ellipses(np.array([np.diag([4.0, 1.0])]), 1), Vectors(at, step), x=x, y=y,
        is_plan=True,
    )  # fmt: skip
    root, ax = parsed(figure), axis_of(figure)
    outline = in_data(corners(root.find("./svg/path[@class='ellipse']").get("d")), figure)
    for border in (outline, ax.lines[1].get_xydata()):
        np.testing.assert_allclose((border**2 / (4.0, 1.0)).sum(axis=1), 1.0, atol=0.02)
    circle = root.find("./svg/circle")
    place = np.array([[float(circle.get("cx")), float(circle.get("cy"))]])
    np.testing.assert_allclose(in_data(place, figure), at, atol=0.02)
    path = next(p.get("d") for p in root.iter("path") if "l" in p.get("d"))
    start, way = (np.array(part.split(), float) for part in path[1:].split("l"))
    end = in_data((start + way)[None], figure)
    np.testing.assert_allclose(end, at + step, atol=0.03)
    np.testing.assert_allclose(ax.collections[0].get_segments(), [[at[0], (at + step)[0]]])


def named():
    return [
        Line(HOSTILE, X, Y), Steps(HOSTILE, X, Y), Places({HOSTILE: 2.0}),
        Dots(np.column_stack([X, Y]), names=(HOSTILE,) * 4, is_labelled=True),
    ]  # fmt: skip


def test_bands_and_error_bars_reach_one_sigma_to_both_sides():
    sigma, error = np.array([0.2, 0.4, 0.1, 0.3]), np.array([0.1, np.nan, 0.3, 0.2])
    figure = chart(Line("a", X, Y - 0.5, colour=1, sigma=sigma, error=error))
    root, ax = parsed(figure), axis_of(figure)
    band = in_data(corners(root.find("./svg/path[@class='band']").get("d").rstrip("Z")), figure)
    expected = np.concatenate([Y - 0.5 + sigma, (Y - 0.5 - sigma)[::-1]])
    np.testing.assert_allclose(band, np.column_stack([[*X, *X[::-1]], expected]), atol=0.02)
    known = np.isfinite(error)
    ends = np.stack([Y - 0.5 - error, Y - 0.5 + error], axis=1)[known]
    bars = root.findall("./svg/line[@style]")
    assert [bar.get("style") for bar in bars] == ["stroke:var(--c1)"] * 3
    for bar, at, heights in zip(bars, X[known], ends, strict=True):
        places = [[float(bar.get("x1")), float(bar.get(f"y{k}"))] for k in (1, 2)]
        seen = in_data(np.array(places), figure)
        np.testing.assert_allclose(seen, np.column_stack([[at, at], heights]), atol=0.02)
    segments = np.array(ax.collections[-1].get_segments())
    np.testing.assert_allclose(segments[..., 1], ends)


def test_names_are_escaped_and_no_formulas():
    label = "$x^$ " + HOSTILE
    marks = named()
    figure = chart(*marks, x=linear([9.0], label), y=linear([4.0], label), note=HOSTILE)
    assert "<script" not in svg.draw(figure)
    assert svg.draw(figure).count("&lt;script&gt;") >= 8
    parsed(figure)
    bars = chart(Bars({HOSTILE: 1.0}, str), StackedBars({HOSTILE: {HOSTILE: 1.0}}, HOSTILE))
    assert "<script" not in svg.draw(bars)


NOTHING = np.zeros(0)
LARGE = 1e308  # twice that overflows


@pytest.mark.parametrize(
    "x, y",
    [
        ([], []),
        ([math.nan, math.nan], [1.0, math.nan]),
        ([3.0], [2.0]),
        ([0.0, 0.0], [0.0, 0.0]),
        ([-LARGE, LARGE], [LARGE, -LARGE]),
        ([1.0, 2.0], [-1.0, math.inf]),
        ([1.0, 1.0 + 1e-15], [5.0, 5.0]),
        ([5e-324, 1e-310], [0.0, 5e-324]),
        ([LARGE / 10, LARGE / 10], [-LARGE / 10, -LARGE / 10]),
    ],
    ids=[
        "empty",
        "nan",
        "one",
        "zeros",
        "huge",
        "infinite",
        "equal but for rounding",
        "tiny",
        "same",
    ],
)
@pytest.mark.parametrize("is_logarithmic", [False, True])
@pytest.mark.parametrize("is_plan", [False, True])
def test_ugly_lines_are_drawn(x, y, is_logarithmic, is_plan):
    x, y = np.array(x, float), np.array(y, float)
    lines = (
        Line("a", x, y, sigma=np.ones(len(x))), Line("b", x, y, is_dotted=True),
        Line("c", x, y, is_limit=True),
    )  # fmt: skip
    with np.errstate(over="ignore", invalid="ignore"):
        figure = line_figure(
            name="f", title="", x_label="x", y_label="y", lines=lines,
            is_logarithmic=is_logarithmic, is_plan=is_plan,
        )  # fmt: skip
        for axis in (figure.x, figure.y):
            assert math.isfinite(axis.low) and axis.low < axis.high < math.inf
            assert all(math.isfinite(tick) for tick in axis.ticks) and len(axis.ticks) < 9
        root = parsed(figure)
    assert len(root.findall("./ul/li")) == 3
    circles = root.findall("./svg/circle")
    stands = np.isfinite(x) & np.isfinite(y)
    if figure.y.is_logarithmic:
        stands &= y > 0
    assert len(circles) == stands.sum() * (3 if len(x) == 1 else 1)


@pytest.mark.parametrize("box", [[0.0, 0.0, 1e300, 1e300], [5.0, 5.0, 5.0 + 1e-9, 6.0]])
def test_ugly_planes_are_drawn(box):
    cells = Cells(np.full((1, 1), np.nan), 0.0, "px")
    figure = over_image(np.array(box), "f", "", cells, Vectors(np.zeros((0, 2)), np.zeros((0, 2))))
    root = parsed(figure)
    assert not [rect for rect in root.iter("rect") if rect.get("data-cell")]


def test_ten_thousand_marks_take_no_minute():
    count = 10_000
    x = np.linspace(0.0, 10.0, count)
    marks = (
        Line("a", x, np.sin(x), is_dotted=True, sigma=0 * x + 0.1), Steps("b", x, np.cos(x)),
        Dots(np.column_stack([x, x % 4])),
    )  # fmt: skip
    begun = time.perf_counter()
    root = parsed(chart(*marks))
    assert len(root.findall("./svg/circle")) == 2 * count
    assert time.perf_counter() - begun < 20
    axis_of(chart(*marks))


def test_limits_of_a_line_figure_are_grey_and_others_take_colours_in_turn():
    lines = [Line(name, X, Y, is_limit=name in "bd") for name in "abcd"]
    figure = line_figure(name="f", title="", x_label="", y_label="", lines=lines)
    assert [line.colour for line in figure.marks] == [0, 6, 2, 6]
    assert [line.dash for line in figure.marks] == [0, 1, 0, 2]


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(0.3, 0.2), (7.0, 5.0), (1.0, 1.0), (20.0, 20.0), (0.0, 1.0), (math.inf, 1.0), (-3.0, 1.0)],
)
def test_factors_are_round(value, rounded):
    assert round_down(value) == pytest.approx(rounded)
    assert round_down(9.999, 1e-3) == pytest.approx(10.0)


def test_a_square_is_as_wide_by_high_as_the_area_of_a_chart():
    x, y = square((-1.0, -6.0), (3.0, 2.0), ("a", "b"), 0.25)
    width, height = svg.WIDTH - svg.LEFT - svg.RIGHT, svg.HEIGHT - svg.TOP - svg.BOTTOM
    assert (x.high - x.low) / width == pytest.approx((y.high - y.low) / height)
    assert (y.low, y.high) == (-7.0, 3.0)
    assert isinstance(x, Axis) and (x.label, y.label) == ("a", "b")
    wide, _ = square((-100.0, 0.0), (300.0, 1.0), ("", ""), 0.0)
    assert (wide.low, wide.high) == pytest.approx((-100.0, 300.0))
    place, _ = square((7.0, 7.0), (7.0, 7.0), ("", ""))
    assert place.low < 7.0 < place.high
    largest = np.finfo(float).max
    far, _ = square((-largest / 2, 0.0), (largest / 2, 0.0), ("", ""))
    assert math.isfinite(far.low) and math.isfinite(far.high)


@pytest.mark.parametrize(("y", "low"), [([2.0, 3.0], 0.0), ([-2.0, 3.0], -2.0)])
def test_axes_of_lines_begin_at_zero_unless_values_are_below(y, low):
    line = Line("a", np.array([1.0, 2.0]), np.array(y))
    lines = line_figure(name="f", title="", x_label="x", y_label="y", lines=(line,))
    axis = lines.y
    assert axis.low == 0.0 if low == 0.0 else axis.low <= low


def test_a_chart_refuses_marks_of_image_planes():
    with pytest.raises(KeyError):
        drawing(chart(Photo("data:,")))
