"""The README's factor graph prints what the README says."""

import contextlib
import io
import re
from pathlib import Path

import pytest

README = (Path(__file__).parents[3] / "README.md").read_text()


def numbers(line):
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", line)]


def test_the_example_prints_what_the_readme_shows():
    section = README.split("<!-- graph:begin -->")[1].split("<!-- graph:end -->")[0]
    code, shown = re.findall(r"```(?:python)?\n(.*?)```", section, re.DOTALL)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    lines, expected = printed.getvalue().splitlines(), shown.splitlines()
    assert len(lines) == len(expected) == 3
    for line, wanted in zip(lines, expected, strict=True):
        assert re.split(r"[^A-Za-z]+", line) == re.split(r"[^A-Za-z]+", wanted)
        assert numbers(line) == pytest.approx(numbers(wanted), abs=1.1e-3)
