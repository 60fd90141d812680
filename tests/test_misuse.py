"""Whatever is handed to the library: one clear line, no crash, no hang, nothing written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.misuse import rows

ROWS = [name for name, _, _ in rows()]
CALLS = sorted({row.partition("=")[0] for row in ROWS})


@pytest.fixture(scope="module")
def outcomes():
    """Outcome of each row, all made in one process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.misuse"],
        cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    ended = f"ended by {done.returncode} after {len(answers)} rows: {done.stderr[-500:]}"
    assert done.returncode == 0, ended
    assert done.stderr == ""
    return {answer["row"]: answer for answer in answers}


def test_there_are_as_many_rows_as_promised():
    assert len(ROWS) == len(set(ROWS))
    assert len(ROWS) >= 300


@pytest.mark.parametrize("call", CALLS)
def test_a_wrong_call_ends_in_one_clear_line(outcomes, call):
    for outcome in (outcomes[row] for row in ROWS if row.partition("=")[0] == call):
        assert outcome["error"] == "InputError", outcome
        assert outcome["message"].isprintable(), outcome
        assert 10 < len(outcome["message"]) < 700, outcome
        assert outcome["left"] == [], outcome
