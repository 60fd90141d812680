"""The countable part of the English: beginnings of descriptions, ends of messages, subjects.

A description begins with a noun phrase or an imperative verb. A message names the cause or the
remedy; one that ends in "found none" names neither.
"""

import ast
import functools
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("benchmarks", "cpp", "examples", "python", "tests", "tools")
FIRST_COMMIT = "4464b28"  # subjects are held from here on
LONGEST_SUBJECT = 72
CLAUSE = re.compile(r"(what|whether|how|of|that)\b", re.IGNORECASE)
COMMENT = re.compile(r"^(?:_?[A-Z][A-Z0-9_]* = |    \w+: )[^#\n]*  # (.+)$", re.MULTILINE)
DUMMY = re.compile(r"\b(found (none|one|others?|some|without|with|neither)|which is none)$")
SUSPECT = re.compile(
    r"""["']\s*(what|whether|how|of|that)\b|\b(found|is)[\s"'f]+\w+["']""", re.IGNORECASE
)


def sources(*suffixes: str) -> Iterator[Path]:
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in suffixes:
                yield path


class Texts(NamedTuple):
    """Texts of a file with their lines."""

    descriptions: list[tuple[int, str]]
    messages: list[tuple[int, str]]


@functools.cache
def texts(path: Path) -> Texts:
    """Return docstrings, comments beside constants and fields, /// comments, and the literals.

    Python is parsed, which takes time, only where one of them may begin or end with wrong words.
    A comment may begin with "of": the unit of its number.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return of_cpp(text)
    found = of_python(text) if SUSPECT.search(text) else Texts([], [])
    for beside in COMMENT.finditer(text):
        if CLAUSE.match(beside[1]) and not beside[1].startswith("of "):
            found.descriptions.append((text.count("\n", 0, beside.start()) + 1, beside[1]))
    return found


def of_python(text: str) -> Texts:
    found = Texts([], [])
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant):
            if isinstance(node.value, str):
                found.messages.append((node.lineno, node.value))
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            for before, each in zip([None, *node.body], node.body, strict=False):
                value = each.value if isinstance(each, ast.Expr) else None
                describes = before is None or isinstance(before, ast.Assign | ast.AnnAssign)
                if describes and isinstance(value, ast.Constant):
                    found.descriptions.append((each.lineno, str(value.value).strip()))
    return found


def of_cpp(text: str) -> Texts:
    found = Texts([], [])
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        comment = re.search(r"///<? ?(.*)", line)
        if comment and (not inside or "///<" in line):
            found.descriptions.append((number, comment[1]))
        inside = comment is not None
    for literal in re.finditer(r'"((?:[^"\\\n]|\\.)*)"', text):
        found.messages.append((text.count("\n", 0, literal.start()) + 1, literal[1]))
    return found


def place(path: Path, line: int, text: str) -> str:
    return f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"


def test_descriptions_begin_with_a_noun_or_a_verb() -> None:
    found = [
        place(path, line, text)
        for path in sources(".py", ".h", ".cpp")
        for line, text in texts(path).descriptions
        if CLAUSE.match(text)
    ]
    assert found == []


def test_messages_name_what_they_found() -> None:
    found = [
        place(path, line, text)
        for path in sources(".py", ".h", ".cpp")
        for line, text in texts(path).messages
        if DUMMY.search(text)
    ]
    assert found == []


def test_subjects_of_commits_are_short() -> None:
    log = ["git", "-C", str(ROOT), "log", "--format=%s", f"{FIRST_COMMIT}..HEAD"]
    try:
        subjects = subprocess.run(log, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"no history back to {FIRST_COMMIT}: an export or a shallow clone")
    long = {line for line in subjects.splitlines() if len(line) > LONGEST_SUBJECT}
    assert long == set()
