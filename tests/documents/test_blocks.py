"""Every code block of the documents runs: Python as it stands, commands of bundle one by one.

A page begins in a folder with the files that it names (workspace.py) and goes on from block to
block. What a block shows under a command with a prompt is what the command prints, and a block of
language "output" is what the Python block above it prints (UPDATE_GOLDEN=1 rewrites it). Quotes of
tools/quoted_outputs.py are held by tests/test_codebase.py. `bundle compare` starts a process per
method: its flags are held by tests/cli, and Python blocks that call it run two solvers of our own
backend once. `bundle validate` whose output is not shown fits a small model in two folds.
"""

from __future__ import annotations

import functools
import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tools.quoted_outputs import QUOTE

import bundle
from bundle.cli.main import COMMANDS, main
from tests.documents import workspace
from tests.inertial.once import compute_once

ROOT = workspace.REPOSITORY
WITH_DATA: dict[str, Callable[[Path, Path], None]] = {
    "docs/from_your_tool.md": workspace.other_programs,
    "docs/compare.md": workspace.measured,
    "docs/certificates.md": workspace.graphs,
    "docs/pose-graphs.md": workspace.graphs,
    "docs/triage.md": workspace.graphs,
    "docs/vio.md": workspace.sequence,
    "docs/drone_block.md": workspace.flights,
    "docs/align.md": workspace.one_flight,
    "docs/rounds.md": workspace.tracked,
    "docs/faster_mapping.md": workspace.tracked,
    "docs/evaluate.md": workspace.photographs,
}


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each block."""
    text = QUOTE.sub("", page.read_text(encoding="utf-8"))
    return re.findall(r"^```([^\n]*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(block: str) -> list[list[str]]:
    """The commands of bundle in a block, with or without a prompt, but for `bundle compare`."""
    found = []
    for line in block.replace("\\\n", " ").splitlines():
        line = line.removeprefix("$ ").removeprefix(".venv/bin/")
        words = shlex.split(line, comments=True) if line.startswith("bundle ") else []
        if words[1:] and words[1] in COMMANDS and words[1] != "compare":
            found.append(words[1:])
    return found


def shown_lines(block: str) -> list[str]:
    """Return the output that a block shows: the lines under a prompt."""
    if not block.startswith("$ "):
        return []
    return [line for line in block.splitlines()[1:] if line.strip() not in ("", "...")]


def agree(shown: str, printed: str) -> bool:
    """Return whether two lines have the same words, and numbers that round to the same."""
    words, others = shown.split(), printed.split()
    return len(words) == len(others) and all(map(same_word, words, others))


def same_word(shown: str, printed: str) -> bool:
    """Return whether two words are equal, or numbers within 2 % or the second decimal."""
    try:
        return float(printed) == pytest.approx(float(shown), rel=0.02, abs=0.02)
    except ValueError:
        return shown == printed


PAGES = [
    path
    for path in sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])
    if any(
        kind == "python" or (kind in ("", "sh") and commands(text)) for kind, text in blocks(path)
    )
]


@pytest.fixture
def few_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"solvers": ["dense_schur", "sparse_schur"], "backends": ["fused"], "repeat": 1}
    compare = bundle.compare
    quick = functools.wraps(compare)(lambda *args, **given: compare(*args, **{**given, **few}))
    monkeypatch.setattr(bundle, "compare", quick)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
@pytest.mark.usefixtures("few_methods")
def test_the_blocks_of_a_page_run(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name = page.relative_to(ROOT).as_posix()
    monkeypatch.chdir(tmp_path)
    compute_once(monkeypatch)  # pages name a flight in many commands
    if name == "docs/merge.md":
        workspace.two_pieces(tmp_path)
    elif name == "docs/vio_input.md":
        workspace.images(tmp_path)
    elif name == "docs/rolling_shutter.md":
        workspace.video(tmp_path)
    else:
        workspace.base(tmp_path)
    if name in WITH_DATA:
        WITH_DATA[name](tmp_path, request.getfixturevalue("bundle_data"))
    names, said = dict[str, Any](), ""
    for number, (language, text) in enumerate(blocks(page)):
        if language == "python":
            capsys.readouterr()
            exec(compile(text, f"{name}, block {number}", "exec"), names)
            said = capsys.readouterr().out
        elif language == "output":
            check_output(page, text, said)
        elif language in ("", "sh"):
            for words in commands(text):
                if words[0] == "validate" and not shown_lines(text):
                    words = [words[0], "sparse/0", *words[2:], "--folds", "2"]
                words.append("--quiet")
                assert main(words) == 0, f"{name}, block {number}: {words}"
            printed = capsys.readouterr().out.splitlines()
            for line in shown_lines(text):
                assert any(agree(line, other) for other in printed), f"{name}: {line}"


def check_output(page: Path, shown: str, said: str) -> None:
    """Compare the output that a page shows with the one that was printed, or rewrite the page."""
    if os.environ.get("UPDATE_GOLDEN") == "1":
        text = page.read_text(encoding="utf-8")
        assert text.count(f"```output\n{shown}```") == 1
        page.write_text(text.replace(f"```output\n{shown}```", f"```output\n{said}```"), "utf-8")
        return
    lines, others = shown.splitlines(), said.splitlines()
    assert len(lines) == len(others) and all(map(agree, lines, others)), f"{page}: {said}"


def test_there_are_blocks() -> None:
    found = [block for page in PAGES for block in blocks(page)]
    assert sum(language == "python" for language, _ in found) > 15
    assert sum(len(commands(text)) for language, text in found if language in ("", "sh")) > 35
