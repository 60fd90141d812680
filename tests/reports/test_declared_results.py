"""A result is declared once: terminal, JSON, page and DataFrame show it by its declaration."""

from __future__ import annotations

import argparse
import dataclasses
import json

import numpy as np
import pytest

from bundle.base.tables import render
from bundle.cli.output import publish
from bundle.figures.marks import Figure, Line, linear
from bundle.interface.tabular import Tabular
from bundle.reports.json_schema import record_schema
from bundle.reports.page.result_pages import write_reported
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.screen import laid_out
from tests.reports.page.reader import Page, check_self_contained


@dataclasses.dataclass(frozen=True)
class Plank:
    name: str
    length: float
    wood: str


@dataclasses.dataclass(frozen=True)
class Planks(Tabular):
    """A result that no command has."""

    planks: tuple[Plank, ...]
    cost: float


TOY = Planks((Plank("<a>", 2.5, "oak"), Plank("b", float("nan"), "fir")), 7.25)


def report_of(found, figures=()):
    columns = [
        Column("plank", "name"),
        Column("length [m]", "length", "{:.3f}".format),
        Column("wood", "wood", is_page_only=True),
    ]
    return Report(
        command="saw",
        title="Planks & more",
        headline=["2 planks.", "They float."],
        warnings=["One is too long."],
        sections=[
            Section(title="Planks", tables=[Table(columns, found.planks, best=0)]),
            Section(title="Costs", facts=[("cost", f"{found.cost:g} EUR")], is_detail=True),
            Section(title="Curves", text=["Drawn."], figures=figures, is_page_only=True),
        ],
        data=fields(found),
    )


def figure():
    line = Line("one", np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    axis = linear([0.0, 1.0], "x")
    return Figure(name="planks", title="Planks drawn", marks=(line,), x=axis, y=axis)


def test_the_terminal_shows_the_answer_and_on_request_the_details():
    short = render(*laid_out(report_of(TOY)), width=80)
    assert "2 planks." in short and "2.500" in short and "One is too long." in short
    for hidden in ("7.25 EUR", "wood", "oak", "Drawn.", "Planks & more"):
        assert hidden not in short
    long = render(*laid_out(report_of(TOY), verbose=True), width=80)
    assert "7.25 EUR" in long
    for hidden in ("wood", "oak", "Drawn."):
        assert hidden not in long
    assert "\n\n\n" not in long and not long.endswith("\n\n")


def test_the_page_shows_everything_and_makes_figures_on_request(tmp_path):
    made = []

    def figures():
        made.append(figure())
        return made

    report = report_of(TOY, figures)
    render(*laid_out(report, verbose=True), width=80)
    report.json()
    assert not made
    write_reported(report, tmp_path / "page.html")
    assert len(made) == 1
    page = Page(tmp_path / "page.html")
    check_self_contained(page)
    assert "<title>Planks &amp; more</title>" in page.source and "<h1>2 planks.</h1>" in page.source
    assert '<p class="warn">One is too long.</p>' in page.source
    assert ["plank", "length [m]", "wood"] in page.rows and ["<a>", "2.500", "oak"] in page.rows
    assert ["cost", "7.25 EUR"] in page.rows and 'data-figure="planks"' in page.source
    assert page.source.count('class="best"') == 1
    for sentence in ("They float.", "Drawn."):
        assert sentence in page.text
    write_reported(report_of(TOY, [figure()]), tmp_path / "same.html")
    assert (tmp_path / "same.html").read_text() == page.source


def test_a_page_without_a_headline_has_its_title(tmp_path):
    write_reported(Report(command="saw", title="Planks"), tmp_path / "page.html")
    assert "<h1>Planks</h1>" in (tmp_path / "page.html").read_text()


def test_one_function_writes_terminal_json_and_page(tmp_path, capsys):
    asked = argparse.Namespace(json=str(tmp_path / "r.json"), verbose=False, html=None)
    publish(report_of(TOY), asked)
    out = capsys.readouterr().out
    assert "2 planks." in out and not list(tmp_path.glob("*.html"))
    asked.html = str(tmp_path / "page.html")
    publish(report_of(TOY), asked)
    assert capsys.readouterr().out == out
    assert "<title>Planks &amp; more</title>" in (tmp_path / "page.html").read_text()
    written = json.loads((tmp_path / "r.json").read_text())
    assert written["command"] == "saw" and written["headline"] == ["2 planks.", "They float."]
    assert written["cost"] == 7.25
    assert written["planks"][1] == {"name": "b", "length": None, "wood": "fir"}
    (tmp_path / "page.html").unlink()
    publish(dataclasses.replace(report_of(TOY), title=""), asked)  # its command has another page
    assert not (tmp_path / "page.html").exists()


def test_the_schema_has_the_types_of_the_fields():
    text, number = {"type": "string"}, {"type": ["number", "null"]}
    records = {"type": "array", "items": {"type": "object"}}
    assert record_schema(Planks) == {
        "type": "object",
        "properties": {"planks": records, "cost": number},
        "required": ["planks", "cost"],
    }
    assert record_schema(Plank)["properties"] == {"name": text, "length": number, "wood": text}


def test_the_data_frame_has_a_row_per_record():
    pytest.importorskip("pandas")
    frame = TOY.to_dataframe()
    assert list(frame.columns) == ["name", "length", "wood"] and list(frame["wood"]) == [
        "oak",
        "fir",
    ]
