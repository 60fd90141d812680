"""SolveOptions of Python and of C++: the same names, defaults and choices."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from bundle import SolveOptions, _core
from bundle.interface.option_fields import REFINABLE

HEADER = (Path(__file__).parents[2] / "cpp" / "core" / "interface" / "options.h").read_text()
PYTHON = {field.name: field for field in dataclasses.fields(SolveOptions)}

# name -> (type, default as written or ""), of the C++ struct.
STRUCT = {
    name: (type_, default)
    for type_, name, default in re.findall(
        r"^  ([\w:<>]+) (\w+)(?: = ([^;]+))?;",
        HEADER[HEADER.index("struct SolveOptions") :].partition("};")[0],
        re.MULTILINE,
    )
}
# Enumeration -> {value as Python names it: enumerator}.
ENUMERATIONS = {
    enum: dict(re.findall(rf'\{{"(\w+)", {enum}::(\w+)\}}', body))
    for enum, body in re.findall(r"NamedValue<(\w+)> \w+\[\] = \{(.*?)\};", HEADER, re.DOTALL)
}
SWITCHES = {f"refine_{what}" for what in REFINABLE}
FLAGS = sorted(
    name for name, (type_, _) in STRUCT.items() if type_ == "bool" and name not in SWITCHES
)
CHOSEN = sorted(name for name, (type_, _) in STRUCT.items() if type_ in ENUMERATIONS)
NUMBERS = sorted(name for name, (type_, _) in STRUCT.items() if type_ in {"int", "double"})
LISTS = sorted(name for name, (type_, _) in STRUCT.items() if type_.startswith("std::vector"))

# Where Python's "auto" depends on the input's format, which the core is not told.
RESOLVED_IN_PYTHON = {"gauge"}


def test_names_agree() -> None:
    assert set(STRUCT) >= SWITCHES
    assert set(STRUCT) - SWITCHES == set(PYTHON) - {"refine", "twist_sigma"}
    assert set(STRUCT) - SWITCHES == {*CHOSEN, *NUMBERS, *LISTS, *FLAGS}


def test_visitors_list_every_member() -> None:
    """The lists have each member once, and name what a Solver may change."""
    listed = re.findall(r'visit\(k(\w+), "(\w+)", &Options::(\w+)', HEADER)
    assert {member for _, _, member in listed} == set(STRUCT) - SWITCHES
    assert all(name == member for _, name, member in listed)
    changeable = [member for change, _, member in listed if change == "BetweenSolves"]
    assert changeable == _core.changeable_options()
    named = dict(re.findall(r'visit\("(\w+)", &SolveOptions::(\w+)\)', HEADER))
    assert named == {what: f"refine_{what}" for what in REFINABLE}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_agree(name: str) -> None:
    type_, default = STRUCT[name]
    assert type(PYTHON[name].default).__name__ == {"int": "int", "double": "float"}[type_]
    assert float(default) == PYTHON[name].default


@pytest.mark.parametrize("name", CHOSEN)
def test_choices_agree(name: str) -> None:
    type_, default = STRUCT[name]
    named = ENUMERATIONS[type_]
    choices = PYTHON[name].metadata["choices"]
    if name in RESOLVED_IN_PYTHON:
        assert (PYTHON[name].default, *named) == choices == ("auto", *named)
    else:
        assert tuple(named) == choices
        assert f"{type_}::{named[PYTHON[name].default]}" == default
    assert set(named.values()) == enumerators(type_)


@pytest.mark.parametrize("name", FLAGS)
def test_flags_agree(name: str) -> None:
    assert {"true": True, "false": False}[STRUCT[name][1]] is PYTHON[name].default


@pytest.mark.parametrize("what", REFINABLE)
def test_what_is_refined_agrees(what: str) -> None:
    default = {"true": True, "false": False}[STRUCT[f"refine_{what}"][1]]
    assert default == (what in PYTHON["refine"].default)


@pytest.mark.parametrize("name", LISTS)
def test_lists_are_empty(name: str) -> None:
    assert STRUCT[name][1] == ""
    assert PYTHON[name].default == ()


def enumerators(name: str) -> set[str]:
    """Return what a C++ enumeration declares, in whichever header of the core it stands."""
    core = Path(__file__).parents[2] / "cpp" / "core"
    declaration = re.compile(rf"^enum class {name}\b[^{{]*\{{(.*?)\}}", re.MULTILINE | re.DOTALL)
    (body,) = [
        found[1] for path in core.rglob("*.h") for found in declaration.finditer(path.read_text())
    ]
    return set(re.findall(r"\bk[A-Z]\w*", re.sub(r"//.*", "", body)))
