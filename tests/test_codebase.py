"""One source for each fact: the version, the stub of the core, the commands that documents name."""

from __future__ import annotations

import ast
import graphlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
from tools import contents, quoted_outputs

import bundle
from bundle import _core
from bundle.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
STUB = ast.parse((ROOT / "python" / "bundle" / "_core.pyi").read_text())


def test_version_of_the_package_and_of_the_core_is_that_of_the_project() -> None:
    assert bundle.__version__ == VERSION
    assert _core.__version__ == VERSION


def test_version_stands_in_one_source() -> None:
    sources = [ROOT / "CMakeLists.txt", ROOT / "Makefile"]
    for folder in ("cpp", "python", "tools"):
        sources += [
            path
            for path in (ROOT / folder).rglob("*")
            if path.suffix not in {".so", ".pyc", ".zip"}
        ]
    written = re.compile(rf"(?<![\d.]){re.escape(VERSION)}(?![\d.])")
    found = [path for path in sources if path.is_file() and written.search(path.read_text())]
    assert not found


def test_changelog_describes_this_version() -> None:
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert VERSION in headings or headings[0] == "Unreleased"


def declared(body: list[ast.stmt]) -> dict[str, ast.stmt]:
    """Return the names that a stub's module or class declares."""
    found: dict[str, ast.stmt] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = node
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = node
    return found


def present(namespace: type | ModuleType) -> set[str]:
    """Return the names that a module or class of the core has of its own, but for Python's."""
    machinery = {"pybind11_type"}
    return {
        name
        for name in vars(namespace)
        if name not in machinery and not (name.startswith("__") or name.startswith("_pybind11"))
    }


def test_stub_names_what_the_core_has() -> None:
    stubbed = {name for name in declared(STUB.body) if not name.startswith("_")}
    assert stubbed == present(_core)


@pytest.mark.parametrize(
    "name", sorted(n for n in present(_core) if isinstance(getattr(_core, n), type))
)
def test_stub_names_what_a_class_has(name: str) -> None:
    node = declared(STUB.body)[name]
    assert isinstance(node, ast.ClassDef)
    stubbed = {entry for entry in declared(node.body) if not entry.startswith("__")}
    assert stubbed == present(getattr(_core, name))


FUNCTIONS = sorted(n for n in present(_core) if not isinstance(getattr(_core, n), type))
FUNCTIONS = [name for name in FUNCTIONS if callable(getattr(_core, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_stub_names_the_parameters_of_a_function(name: str) -> None:
    node = declared(STUB.body)[name]
    assert isinstance(node, ast.FunctionDef)
    signature = getattr(_core, name).__doc__.partition("\n")[0]
    (bound,) = ast.parse(f"def {signature}: ...").body
    assert isinstance(bound, ast.FunctionDef)
    assert parameters(node) == parameters(bound)


def parameters(function: ast.FunctionDef) -> list[str]:
    arguments = function.args
    return [
        argument.arg for argument in arguments.posonlyargs + arguments.args + arguments.kwonlyargs
    ]


def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("document", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", ".ci/run"])
def test_documents_name_make_targets_that_exist(document: str) -> None:
    text = (ROOT / document).read_text()
    code = (
        text
        if document == ".ci/run"
        else "\n".join(re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL))
    )
    named = set(re.findall(r"(?<!\w)make (?:[A-Z_]+=\S+ )*([a-z]+)", code))
    assert named <= make_targets()
    assert document != "README.md" or {"demo", "test"} <= named


@pytest.mark.parametrize("document", ["CONTRIBUTING.md", "cpp/README.md", "docs/libraries.md"])
def test_documents_name_files_that_exist(document: str) -> None:
    """A name in backticks is a path in the repository, or the end of one."""
    folders = [ROOT / name for name in ("benchmarks", "cpp", "docs", "python", "tests", "tools")]
    paths = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    known = {f"/{path.relative_to(ROOT).as_posix()}" for path in paths}
    known |= {f"/{path.name}" for path in ROOT.iterdir() if path.is_file()}
    named = re.findall(r"`([\w/]+\.(?:cpp|h|md|py|pyi))`", (ROOT / document).read_text())
    assert named
    missing = {name for name in named if not any(path.endswith(f"/{name}") for path in known)}
    assert missing == set()


def test_help_lists_every_target() -> None:
    shown = subprocess.run(
        ["make", "help"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    assert set(re.findall(r"^make ([a-z]+)", shown, re.MULTILINE)) == make_targets()


def test_the_page_of_camera_models_has_the_table_that_the_code_gives() -> None:
    script = [sys.executable, ROOT / "tools" / "camera_table.py"]
    table = subprocess.run(script, capture_output=True, text=True, check=True).stdout
    assert all(model in table for model in bundle.camera_models())
    page = (ROOT / "docs" / "camera_models.md").read_text()
    between = page.split("<!-- cameras:begin -->\n")[1].split("<!-- cameras:end -->")[0]
    assert between == table, "run `make quotes`"


def test_documents_quote_what_commands_print() -> None:
    """The words; numbers may differ in their last digits."""

    def rows(text: str) -> list[list[str]]:
        lines = [line.split() for line in text.splitlines() if line.strip()]
        return [[word for word in line if not re.match(r"[-\d.(]", word)] for line in lines]

    script = [sys.executable, ROOT / "tools" / "quoted_outputs.py"]
    printed = subprocess.run(script, capture_output=True, text=True, check=True).stdout
    texts = [page.read_text(encoding="utf-8") for page in quoted_outputs.documents()]
    shown = "\n".join(found[1] for text in texts for found in quoted_outputs.QUOTE.finditer(text))
    assert rows(shown) == rows(printed), "run `make quotes`"
    assert len(rows(shown)) > 10


def test_modules_have_names_of_their_own() -> None:
    """A command has its name in cli/ and, for what it prints, in reports/; no other repeats."""
    package = ROOT / "python" / "bundle"
    homes: dict[str, list[str]] = {}
    for path in package.rglob("*.py"):
        if path.name != "__init__.py":
            homes.setdefault(path.stem, []).append(str(path.parent.relative_to(package)))
    twins = {name: found for name, found in homes.items() if len(found) > 1}
    pair = ["cli", "reports/terminal"]
    assert {name for name, found in twins.items() if sorted(found) == pair} <= set(COMMANDS)
    assert {name: found for name, found in twins.items() if sorted(found) != pair} == {}


def test_no_files_import_each_other_in_a_circle() -> None:
    """Count imports in functions and those for types, too."""
    package = ROOT / "python" / "bundle"
    files = {
        ".".join(path.relative_to(package.parent).with_suffix("").parts): path
        for path in package.rglob("*.py")
        if path.name != "__init__.py"
    }
    graph: dict[str, set[str]] = {}
    for name, path in files.items():
        nodes = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
        names = {f"{node.module}.{alias.name}" for node in nodes for alias in node.names}
        graph[name] = (names | {str(node.module) for node in nodes}) & set(files)
    graphlib.TopologicalSorter(graph).prepare()  # CycleError names the files


@pytest.mark.parametrize("folder", contents.FOLDERS)
def test_every_file_says_what_it_contains(folder: str) -> None:
    files = list(contents.files_of(ROOT / folder))
    assert files
    assert [path.name for path in files if not contents.described(path)] == []


def test_contents_are_first_sentences_and_sections(tmp_path: Path) -> None:
    python, header, part, binding, script = (
        tmp_path / name for name in ("a.py", "b.h", "c.cpp", "d.cpp", "e.sh")
    )
    python.write_text(
        '"""Gauges (K. Ma), in\ntwo lines. More."""\n\n# One step.\nX = 1\n\n\n'
        "# Scales of\n# worlds. And more.\n#\n# Last.\n\n\nclass A: ...  # B.\n"
    )
    header.write_text("#pragma once\n\n#include <a>\n\n/// Sums of\n/// blocks:\n///\n///   x\n")
    part.write_text("/// Part of B (b.h): products.\n\n/// Another.\nint A();\n")
    binding.write_text('/* m */\n/// Inner.\nvoid F() { m.def("solve", 1).def("save", 2); }\n')
    script.write_text("#!/bin/sh\n# usage: e.sh A\n#\n# Builds A.\n")
    for face in ("__init__.py", "b.cpp"):  # names and source of what others describe
        (tmp_path / face).write_text("")
    assert {path.name: contents.described(path) for path in contents.files_of(tmp_path)} == {
        "a.py": "Gauges (K. Ma), in two lines.",
        "b.h": "Sums of blocks:",
        "c.cpp": "Part of B (b.h): products.",
        "d.cpp": "solve, save",
        "e.sh": "Builds A.",
    }
    assert contents.sections(python) == ["Scales of worlds."]
    assert contents.sections(header) == []
