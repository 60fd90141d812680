"""Every command that a page of docs/ or the README shows has flags that there are."""

import re
import shlex
from pathlib import Path

import pytest

from bundle.cli.main import COMMANDS, command_parser

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])


def commands(page):
    """The lines of code blocks that begin with bundle, after a prompt or not."""
    found = []
    for block in re.findall(r"^```(?:sh)?\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.removeprefix("$ ")
            words = shlex.split(line, comments=True) if line.startswith("bundle ") else []
            if words[:1] == ["bundle"] and words[1:2] and words[1] in COMMANDS:
                found.append(words[1:])
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_flags_parse(page):
    for words in commands(page):
        command_parser().parse_args(words)


def test_there_are_commands():
    assert len(commands(ROOT / "docs" / "drone_block.md")) > 7
