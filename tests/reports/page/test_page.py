"""The parts of a page: what is escaped, scales, images, places of vertices."""

from __future__ import annotations

import json
import math
import re

import cv2
import numpy as np
import pytest

import bundle
from bundle.figures.marks import linear, logarithmic, short
from bundle.reports.page.elimination_player import place
from bundle.reports.page.page import as_json, png, prose, tag, write_page
from bundle.reports.page.table import declared
from bundle.reports.sections import Table
from tests.reports.page.reader import Page, check_self_contained

HOSTILE = "</script><script>alert(1)</script><!-- & \u2028 \" ' \\"


def test_lines_do_not_break_within_an_arrow_or_an_option():
    option = '<span class="option">{}</span>'.format
    assert prose("1 -> 2 by --gcp") == f"1 {option('-&gt;')} 2 by {option('--gcp')}"


def test_json_cannot_end_its_script():
    text = as_json({HOSTILE: [HOSTILE, 1.5, None, True]})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {HOSTILE: [HOSTILE, 1.5, None, True]}


def test_numbers_that_json_has_not_are_null():
    data = {"a": [math.nan, math.inf, -math.inf, 1e308], "b": (math.nan,)}
    assert json.loads(as_json(data)) == {"a": [None, None, None, 1e308], "b": [None]}


def test_attributes_are_escaped_and_named():
    element = tag("p", "x", class_=HOSTILE, aria_label='"', hidden=True, title=None, id=False)
    assert element.startswith('<p class="&lt;/script&gt;') and element.endswith(" hidden>x</p>")
    assert ' aria-label="&quot;"' in element and "title" not in element and " id" not in element


def test_a_page_holds_its_data_whatever_the_names(tmp_path):
    path = tmp_path / "page.html"
    write_page(path, HOSTILE, [tag("p", "words")], {"name": HOSTILE})
    page = Page(path)
    check_self_contained(page)
    assert len(page.scripts) == 2
    assert json.loads(page.scripts[0]) == {"name": HOSTILE}
    assert page.words.count(HOSTILE) == 2  # title and heading


def test_a_page_that_cannot_be_written_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "page.html"
    path.write_text("old")
    monkeypatch.setattr("pathlib.Path.write_text", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_page(path, "new", [])
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(bundle.InputError, match="expected a file or a new path, found a folder"):
        write_page(tmp_path, "new", [])


@pytest.mark.parametrize("values", [[3.0], [0.0], [], [0.2, 7e9], [math.nan, 5.0]])
def test_linear_scales_have_round_ticks_within(values):
    scale = linear(values)
    assert scale.low == 0 < scale.high
    assert 2 <= len(scale.ticks) <= 7
    assert all(scale.low <= tick <= scale.high * (1 + 1e-9) for tick in scale.ticks)
    assert scale(scale.low) == 0 and scale(scale.high) == 1 == scale(2 * scale.high)


@pytest.mark.parametrize("values", [[3.0], [0.0], [], [1e-9, 7e9], [math.nan, 5.0], [10.0]])
def test_logarithmic_scales_hold_their_values(values):
    scale = logarithmic(values)
    assert 2 <= len(scale.ticks) <= 7
    assert scale(scale.low) == 0 and scale(scale.high) == 1
    middle = math.sqrt(scale.low * scale.high)
    assert scale(middle) == pytest.approx(0.5)
    for value in values:
        if value > 0:
            assert scale.low <= value <= scale.high


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (0.001, "0.001"), (1e-7, "1e-7"), (2500, "2500"), (25000, "25k"), (3e6, "3M"),
     (1.5e12, "1.5e12"), (0.0005, "5e-4")],
)  # fmt: skip
def test_ticks_are_short(value, text):
    assert short(value) == text


def test_images_are_read_back_as_they_were():
    image = np.random.default_rng(1).integers(0, 256, (13, 7, 4)).astype(np.uint8)
    decoded = cv2.imdecode(np.frombuffer(png(image), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded[..., [2, 1, 0, 3]], image)


def test_a_cycle_is_placed_on_a_circle():
    positions = place(9, [(i, (i + 1) % 9) for i in range(9)])
    radius = np.linalg.norm(positions - positions.mean(0), axis=1)
    assert np.ptp(radius) < 0.02 * radius.mean()


def test_a_chain_is_placed_in_its_order():
    positions = place(12, [(i, i + 1) for i in range(11)])
    apart = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert np.ptp(apart) < 0.1 * apart.mean()
    assert np.linalg.norm(positions[-1] - positions[0]) > 0.9 * apart.sum()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 60])
@pytest.mark.parametrize("edges", ["none", "star", "full", "halves"])
def test_no_two_vertices_share_a_place(count, edges):
    pairs = {
        "none": [],
        "star": [(0, leaf) for leaf in range(1, count)],
        "full": [(a, b) for b in range(count) for a in range(b)],
        "halves": [(a, a + 1) for a in range(count - 1) if a != count // 2],
    }[edges]
    positions = place(count, pairs)
    assert positions.shape == (count, 2)
    assert (positions >= -1e-9).all() and (positions <= 1 + 1e-9).all()
    apart = np.linalg.norm(positions[:, None] - positions, axis=2) + np.eye(count)
    assert count < 2 or apart.min() > 0.2 / count


def test_empty_columns_of_a_table_are_left_out():
    rows = [("a", "", "", 1), ("b", "", "x", 2)]
    head = ("name", "unit", "note", "size")
    source = declared(Table.of(head, rows, left=2))
    assert re.findall('<th scope="col"[^>]*>([^<]*)', source) == ["name", "unit", "note", "size"]
    source = declared(Table.of(head, rows, left=1))
    assert re.findall('<th scope="col"[^>]*>([^<]*)', source) == ["name", "note", "size"]
    assert re.findall("<td[^>]*>([^<]*)", source) == ["", "1", "x", "2"]
