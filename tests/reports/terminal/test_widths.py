"""No terminal is too narrow: every number and name of a wide report is in a narrow one."""

from __future__ import annotations

from collections import Counter

import pytest

import bundle
from bundle import _core
from bundle.base.tables import columns, render
from bundle.cli.main import main
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.screen import laid_out
from tests.planning.comparison.fakes import (
    CERES,
    DENSE,
    ITERATIVE,
    comparison,
    done,
    failed,
    prediction,
)
from tests.scenes import make_problem

LONG = "a_folder_of_a_long_name/and_another/IMG_20240229_{}_with_a_tail.jpg"


@pytest.fixture
def files(tmp_path):
    """A model with many kinds of cameras and long names, a BAL file and a graph."""
    problem = make_problem(model="RADIAL", num_images=12, num_points=60, track=4)
    names = [LONG.format(i) for i in range(12)]
    bundle.save(problem.replace(image_names=names), f"{tmp_path}/model/")
    bundle.save(make_problem(model="RADIAL", num_images=4), tmp_path / "b.txt")
    chain = "".join(f"variable{i} variable{(3 * i + 1) % 20}\n" for i in range(20))
    (tmp_path / "graph.txt").write_text(chain)
    return tmp_path


@pytest.fixture
def reports(monkeypatch, files):
    """Run a command and return what it showed, at any width."""
    shown = []
    monkeypatch.setattr("bundle.cli.output.show", lambda *parts: shown.extend(parts))

    def run(*words):
        assert main([word.replace("TMP", str(files)) for word in words] + ["--quiet"]) in (0, 1)
        return lambda width: render(*shown, width=width)

    return run


def check_nothing_is_lost(report):
    wide = Counter(report(200).split())
    for width in (60, 80, 100):
        text = report(width)
        # A word that is longer than its column goes on in the next line.
        lost = {word for word in wide - Counter(text.split()) if len(word) < 30}
        assert not {word for word in lost if set(word) not in ({"#"}, {"\\"})}, width
        # A word of a command cannot be broken: its line may be longer, alone with its backslash.
        long = [line for line in text.splitlines() if len(line) > width]
        assert all(len(line.rstrip("\\").split()) == 1 for line in long), (width, long)
        assert "\u2026" not in text


@pytest.mark.parametrize(
    "words",
    [
        ("info", "TMP/model", "TMP/b.txt"),
        ("refine", "TMP/model", "-o", "TMP/out/"),
        ("refine", "TMP/b.txt", "-o", "TMP/out.txt", "--backend", "ceres"),
        ("inspect", "TMP/model"),
        ("inspect", "--graph", "TMP/graph.txt", "--ordering", "amd"),
        ("check", "TMP/model", "--samples", "3"),
        ("convert", "TMP/model", "TMP/other.txt"),
        ("synth", "TMP/s.txt", "--images", "4", "--points", "30", "--track-length", "3"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
def test_commands(reports, words):
    check_nothing_is_lost(reports(*words))


def test_a_wrong_jacobian(reports, monkeypatch):
    original = _core.check_reprojections

    def spoilt(*arguments):
        analytic, *others = original(*arguments)
        analytic[..., 1] *= -1
        return (analytic, *others)

    monkeypatch.setattr(_core, "check_reprojections", spoilt)
    check_nothing_is_lost(reports("check", "TMP/model"))


def test_compare():
    told = prediction()
    made = comparison(
        done(DENSE, prediction=told), done(ITERATIVE, 1.5, prediction=told), failed(CERES)
    )
    check_nothing_is_lost(lambda width: render(*laid_out(compared(made)), width=width))
    narrow = render(*laid_out(compared(made)), width=60)
    assert narrow.count("MB") == render(*laid_out(compared(made)), width=200).count("MB")


def test_columns_that_do_not_fit_move_below():
    table = columns(("name", *"abcdef"), [("first", *["1234567890"] * 6), ("second", *"123456")])
    lines = render(table, width=60).splitlines()
    assert [line.split() for line in lines if line] == [
        ["name", "a", "b", "c"], ["first", *["1234567890"] * 3], ["second", *"123"],
        ["name", "d", "e", "f"], ["first", *["1234567890"] * 3], ["second", *"456"],
    ]  # fmt: skip
    assert len(render(table, width=100).splitlines()) == 3


def test_each_part_of_a_divided_table_says_what_its_rows_are():
    rows = [(f"camera {i}", "k1", *"123456789") for i in range(2)]
    table = columns(("camera", "parameter", *"abcdefghi"), rows, left=2, keys=2)
    text = render(table, width=40)
    assert text.count("parameter") == text.count("camera 1") > 1
    assert text.count("k1") == 2 * text.count("parameter")
