"""Layout of text: rich is the oracle for line breaks and styles; a pipe needs no rich."""

from __future__ import annotations

import io
import random
import subprocess
import sys

import pytest
from rich.console import Console
from rich.text import Text

from bundle.base import tables
from bundle.base.tables import cell_width, columns, facts, notes, print_styled, render, wrap

ALPHABETS = ("ab ", "abcdef  \t\n", "a\u4e2d\u6587 ", "e\u0301\u00df\u03c3 -")


@pytest.mark.parametrize("alphabet", ALPHABETS)
def test_lines_break_where_rich_breaks_them(alphabet):
    rng, console = random.Random(3), Console(width=80)
    for _ in range(300):
        text = "".join(rng.choices(alphabet, k=rng.randrange(60)))
        width = rng.randrange(2, 30)
        lines = Text(text.expandtabs(8)).wrap(console, width)
        assert wrap(text, width) == [line.plain.rstrip() for line in lines], (text, width)


def test_a_line_is_never_wider_than_the_terminal():
    rng = random.Random(4)
    for _ in range(200):
        rows = [
            [
                "".join(rng.choices("ab\u4e2d ", k=rng.randrange(90))),
                *map(str, rng.choices(range(10**9), k=6)),
            ]
            for _ in range(3)
        ]
        width = rng.randrange(60, 101)
        text = render(
            columns(("name", *"abcdef"), rows, left=2, keys=rng.choice((1, 2))), width=width
        )
        assert max(map(cell_width, text.splitlines())) <= width


def test_control_characters_do_not_move_the_cursor():
    assert render(facts([("label", "a\rb\bc\x07")])) == f"{'label':<16}  abc\n"


class Screen(io.StringIO):
    """A terminal of 72 columns."""

    def isatty(self):
        return True


@pytest.fixture
def screen(monkeypatch):
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "72")
    return Screen()


def test_a_terminal_shows_the_lines_of_a_pipe_in_styles(screen):
    blocks = [
        "A sentence that is longer than the line of the terminal, which has seventy-two columns.",
        facts([("label", "fact")]),
        *notes(["warning"], style="yellow"),
        columns(("head", "number"), [("total", "1")]),
    ]
    assert tables.is_terminal(screen)
    assert tables.screen_width(screen) == 72
    print_styled(blocks, screen)
    shown = screen.getvalue()
    plain = Text.from_ansi(shown).plain.splitlines()
    assert [line.rstrip() for line in plain] == render(*blocks, width=72).splitlines()
    assert "\x1b[33m" in shown
    assert "\x1b[1m" in shown


def test_no_color_is_respected(screen, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    print_styled(notes(["warning"], style="yellow"), screen)
    assert "\x1b[33m" not in screen.getvalue()


def test_a_pipe_needs_no_rich():
    code = (
        "import sys; from bundle.base.tables import *\n"
        "assert not is_terminal(sys.stdout) and screen_width(sys.stdout) == WIDEST\n"
        "print(render('text', columns(('a', 'b'), [('1', Bar(0.5))])))\n"
        "assert 'rich' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE)
