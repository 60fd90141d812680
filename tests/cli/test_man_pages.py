"""Manual pages: every command and every flag of it, in valid roff."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from tools import man_pages

from bundle.cli.commands import COMMANDS
from bundle.cli.main import command_parser


@pytest.fixture(scope="module")
def pages():
    return man_pages.pages()


def test_each_command_has_a_page_with_its_flags(pages):
    assert set(pages) == {"bundle.1", *(f"bundle-{name}.1" for name in COMMANDS)}
    for name, parser in command_parser().commands().items():
        text = pages[f"bundle-{name}.1"].replace("\\-", "-").replace("\\:", "")
        for action in parser._actions:
            assert all(flag in text for flag in action.option_strings)
        assert f"bundle-{name} - {COMMANDS[name].help}" in " ".join(text.split())
        assert f"\\fB{name}\\fR" in pages["bundle.1"]


def test_text_of_a_help_is_no_request():
    assert man_pages.plain(".txt and\n  C:\\x --a") == "\\&.txt and C:\\ex \\-\\-a"
    assert man_pages.plain("'left'") == "\\&'left'"


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_groff_has_no_warning(pages):
    text = "".join(pages.values())
    done = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-z"],
        input=text,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
