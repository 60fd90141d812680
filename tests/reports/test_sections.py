"""Reports as data: columns find and write their cells, JSON holds all that tables round and cut."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass

import numpy as np
import pytest

from bundle.base.tables import render
from bundle.interface.finding import Finding
from bundle.reports.sections import Column, Report, Section, Table, dumps, plain, several
from bundle.reports.terminal.screen import fitted, laid_out


@dataclass(frozen=True)
class Inner:
    rmse: float


@dataclass(frozen=True)
class Row:
    name: str
    error: Inner
    count: int


ROWS = [Row(name, Inner(0.12345678 * k), k) for k, name in enumerate(["a", "b", "c"], 1)]
COLUMNS = (
    Column("name", "name"),
    Column("RMSE [px]", "error.rmse", "{:.2f}".format),
    Column("twice", lambda row: 2 * row.count),
)


def others(count):
    return f"{count} other rows"


def test_a_column_is_an_attribute_a_path_of_attributes_or_a_function():
    table = Table(COLUMNS, ROWS)
    assert table.head == ("name", "RMSE [px]", "twice")
    assert table.cells() == [("a", "0.12", "2"), ("b", "0.25", "4"), ("c", "0.37", "6")]
    assert Table.of(("x", "y"), [(1, "two")]).cells() == [(1, "two")]


def test_a_new_column_is_one_line():
    wider = Table((*COLUMNS, Column("count", "count")), ROWS)
    assert [row[:-1] for row in wider.cells()] == Table(COLUMNS, ROWS).cells()
    assert [row[-1] for row in wider.cells()] == ["1", "2", "3"]


@pytest.mark.parametrize(
    ("most", "shown", "rest"),
    [(None, 3, []), (3, 3, []), (2, 2, ["1 other rows"]), (0, 0, ["3 other rows"])],
)
def test_rows_that_are_not_shown_are_counted(most, shown, rest):
    table = Table(COLUMNS, ROWS, most=most, others=others)
    assert len(table.cells()) == shown
    assert table.rest() == rest


def report(**more):
    return Report(
        command="check",
        input={"path": "in"},
        sections=[
            Section(facts=[("input", "in")]),
            Section(tables=[Table(COLUMNS, ROWS, most=2, others=others, legend="of pixels")]),
            Section(notes=["First."], is_warning=True, is_joined=True),
            Section(command="bundle refine in -o out"),
        ],
        data={"rows": ROWS, "none": math.nan, "array": np.array([1.5, np.inf]), **more},
    )


def test_sections_are_laid_out_with_an_empty_line_between_each_two():
    lines = [line.strip() for line in render(*laid_out(report()), width=60).splitlines()]
    expected = ["input", "", "name", "a", "b", "of pixels", "- 1 other rows", "- First.", "",
                "bundle refine in -o out"]  # fmt: skip
    assert len(lines) == len(expected)
    for line, beginning in zip(lines, expected, strict=True):
        assert line.startswith(beginning) and bool(line) == bool(beginning)
    assert laid_out(report().sections[:1]) != []
    assert laid_out([Section(), Section()]) == []


def judged(count):
    """A report with a headline, a detail, and findings; the second finding has no command."""
    found = [
        Finding(kind=f"k{i}", sentence=f"Fact {i}.", command=f"bundle do {i}" if i != 1 else "")
        for i in range(count)
    ]
    return Report(
        command="check",
        headline=["All is well."],
        sections=[
            Section(facts=[("hidden", "first")], is_detail=True),
            Section(facts=[("shown", "second")], is_joined=True),
            Section(facts=[("hidden", "third")], is_detail=True),
        ],
        findings=found,
    )


def lines_of(made, verbose=False):
    return [" ".join(x.split()) for x in render(*laid_out(made, verbose), width=60).splitlines()]


def test_the_headline_comes_first_and_findings_with_their_commands_last():
    assert lines_of(judged(2)) == [
        "All is well.", "", "shown second", "", "- Fact 0.", "bundle do 0", "- Fact 1.",
    ]  # fmt: skip
    assert lines_of(Report(command="check", headline=["Done."])) == ["Done."]
    alone = Report(command="check", findings=judged(1).findings)
    assert lines_of(alone) == ["- Fact 0.", "bundle do 0"]


@pytest.mark.parametrize(("count", "shown", "counted"), [(3, 3, False), (4, 3, True), (9, 3, True)])
def test_details_and_findings_after_the_third_need_verbose(count, shown, counted):
    short, full = lines_of(judged(count)), lines_of(judged(count), verbose=True)
    assert sum("Fact" in line for line in short) == shown
    assert any(line.startswith(f"- {count - shown} more") for line in short) == counted
    assert not any("hidden" in line for line in short)
    assert sum("Fact" in line for line in full) == count
    assert full[:5] == ["All is well.", "", "hidden first", "shown second", ""]
    assert judged(count).json()["findings"][-1]["kind"] == f"k{count - 1}"


def test_json_has_every_row_unrounded_and_null_for_what_is_not_finite():
    made = report(more=(1, "x", None, {"k": np.int64(3)}))
    held = made.json()
    assert list(held) == [
        "schema", "command", "version", "input", "headline", "findings", "rows", "none", "array",
        "more",
    ]  # fmt: skip
    assert [row["error"]["rmse"] for row in held["rows"]] == [row.error.rmse for row in ROWS]
    assert held["none"] is None and held["array"] == [1.5, None]
    assert held["more"] == [1, "x", None, {"k": 3}]
    assert json.loads(dumps(held)) == held


def test_a_report_without_an_input_has_none_in_its_json():
    assert list(Report(command="synth").json()) == [
        "schema", "command", "version", "headline", "findings",
    ]  # fmt: skip
    both = several("info", [report(), report()])
    assert list(both.json())[3:] == ["headline", "findings", "reports"]
    assert both.json()["reports"][0] == report().json()
    assert len(both.sections) == 8


def test_types_are_no_records():
    assert plain({"type": Row})["type"] is Row


def test_a_long_report_shows_fewer_findings_but_one():
    def shown(num_facts):
        facts = [Section(facts=[(f"fact {i}", "x") for i in range(num_facts)])]
        parts = fitted(dataclasses.replace(judged(3), sections=facts), 60)
        lines = render(*parts, width=60).splitlines()
        return len(lines), sum("Fact" in line for line in lines)

    assert [shown(count)[1] for count in (1, 16, 18, 19, 40)] == [3, 3, 2, 1, 1]
    assert all(shown(count)[0] <= 25 for count in range(1, 20))
