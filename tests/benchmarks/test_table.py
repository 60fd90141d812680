from __future__ import annotations

import pytest
from benchmarks.measure import Spread
from benchmarks.rows import Row
from benchmarks.targets import Target

from benchmarks import table, targets


def row(solver, milliseconds, failure="", **changes):
    time = Spread(1e-3 * milliseconds, 0.5e-3 * milliseconds, 2e-3 * milliseconds)
    if failure:
        return Row("p", solver, failure)
    fields = {"used": "X", "num_steps": 7, "gap": 0.0, "cores": 1.0, **changes}
    return Row(
        "p", solver, failure, step=time, reached=(time, None), total=time, memory=time, **fields
    )


def cells(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]


@pytest.mark.parametrize(
    ("spread", "reference", "expected"),
    [
        (Spread(3.0, 2.0, 5.0), Spread(2.0, 1.0, 9.0), "1.50x (1.00x-2.50x)"),
        (Spread(3.0, 3.0, 3.0), Spread(2.0, 2.0, 2.0), "1.50x"),
        (Spread(1.0, 0.999, 1.001), Spread(1.0, 1.0, 1.0), "1.00x"),
        (None, Spread(2.0, 1.0, 9.0), "not reached"),
        (Spread(0.25, 0.2, 0.3), None, "0.25 s"),
    ],
)
def test_ratio(spread, reference, expected):
    assert table.ratio(spread, reference) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0123456, "0.0123 s"),
        (0.9996, "1 s"),
        (0.9994, "0.999 s"),
        (1234.5, "1234 s"),
        (12.34, "12.3 s"),
    ],
)
def test_times_have_one_unit(value, expected):
    assert table.seconds(value) == expected


def test_every_line_has_every_cell_and_failures_are_lines():
    text = table.of_problem([row("a b", 10), row("c d", 20), row("e f", 0, "it broke")])
    lines = cells(text)
    assert len({len(line) for line in lines}) == 1
    assert lines[2][:2] == ["**a b, absolute**", "0.01 s"]
    assert lines[3][:2] == ["a b (X)", "1.00x (0.50x-2.00x)"]
    assert lines[4][:3] == ["c d (X)", "2.00x (1.00x-4.00x)", "7"]
    assert lines[4][4] == "not reached"
    assert lines[5][1] == "no result: it broke"


def test_without_our_numbers_the_others_are_absolute():
    lines = cells(table.of_problem([row("a b", 0, "it broke"), row("c d", 20)]))
    assert lines[2][1] == "no result: it broke"
    assert lines[3][1] == "0.02 s"


def test_remarks_and_doubts_stand_in_the_row():
    text = table.of_problem([row("a b", 10, remark="1 of 2 runs: lost", doubt="says 3")])
    assert "**1 of 2 runs: lost**; **says 3**" in text


def test_pairs_are_theirs_over_ours():
    lines = cells(table.of_pair([(row("a", 10), row("b", 5)), (row("a", 10), row("b", 5, "gone"))]))
    assert lines[2][1:3] == ["0.01 s", "0.50x (0.25x-1.00x)"]
    assert lines[3][1] == "no result: b: gone"
    assert len({len(line) for line in lines}) == 1


@pytest.mark.parametrize(
    ("value", "is_least", "cells_expected"),
    [
        (0.75, False, ["w", "0.75", "at most 0.75", "yes"]),
        (0.751, False, ["w", "0.751", "at most 0.75", "no"]),
        (0.75, True, ["w", "0.75", "at least 0.75", "yes"]),
        (0.749, True, ["w", "0.749", "at least 0.75", "no"]),
        (None, False, ["w", "not measured", "at most 0.75", "no"]),
    ],
)
def test_targets_are_met_up_to_their_limit(value, is_least, cells_expected):
    assert cells(targets.as_table([Target("w", value, 0.75, is_least)]))[2] == cells_expected


def test_absolute_times_show_a_spread_that_can_be_seen():
    assert table.absolute(Spread(0.2, 0.1, 0.3)) == "0.2 s (0.1 s-0.3 s)"
    assert table.absolute(Spread(0.2, 0.20001, 0.20002)) == "0.2 s"
    assert table.absolute(None) == "not reached"
