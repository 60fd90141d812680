"""Help in two levels: the options that people use, in the order of use, and all of them."""

from __future__ import annotations

import re

import pytest

from bundle.cli.main import COMMANDS, command_parser, main
from bundle.cli.parser import MOST_FLAGS, Parser


@pytest.fixture(scope="module")
def parsers() -> dict[str, Parser]:
    return command_parser().commands()


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    assert ended.value.code in (0, None)
    return capsys.readouterr().out


def flags_in(text: str) -> list[str]:
    """Return the long flags that a help explains, in its order."""
    entries = re.findall(r"^  (-.*)$", text, re.MULTILINE)
    found = [re.findall(r"--[a-z][a-z0-9-]*", re.split(r"  +", entry)[0]) for entry in entries]
    return [flags[0] for flags in found if flags]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_the_flags_in_use_and_help_all_every_flag(name, parsers, capsys):
    actions = [a for a in parsers[name]._actions if a.option_strings]
    every = {next(f for f in a.option_strings if f.startswith("--")) for a in actions}
    uses = {
        next(f for f in a.option_strings if f.startswith("--")): vars(a).get("use", 0)
        for a in actions
    }
    assert set(flags_in(printed(capsys, name, "--help-all"))) == every
    short = printed(capsys, name, "--help")
    for action in parsers[name]._actions:
        assert action.option_strings or f"  {action.metavar}" in short
    if len(actions) <= MOST_FLAGS:
        assert set(flags_in(short)) == every
        return
    used = sorted((flag for flag in every if uses[flag]), key=lambda flag: uses[flag])
    assert flags_in(short) == [*used, "--help", "--help-all"]
    assert 8 <= len(used) <= 20
    assert len({uses[flag] for flag in used}) == len(used), "two flags with one place"
    assert str(len(actions)) in short


def test_refine_begins_with_the_output_and_ends_with_reports(capsys):
    shown = flags_in(printed(capsys, "refine", "--help"))
    assert shown[0] == "--output"
    order = [shown.index(flag) for flag in ("--loss", "--rounds", "--refine", "--gps", "--threads")]
    assert order == sorted(order)
    assert "--min-lm-diagonal" not in shown


@pytest.mark.parametrize("name", ["refine", "check", ""])
def test_help_is_also_a_command(name, capsys):
    words = [name] if name else []
    assert printed(capsys, "help", *words) == printed(capsys, *words, "--help")
