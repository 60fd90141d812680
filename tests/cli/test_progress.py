"""The progress of a solve, on terminals of different widths and off them."""

import io
import sys
import time

import pytest

from bundle.cli.output import Progress

WIDEST = {
    "iteration": 999,
    "cost": 1.234567e-10,
    "cost_change": -1.6e-10,
    "gradient_max_norm": 3.5e12,
    "trust_region_radius": 9.9e15,
}


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def screen(monkeypatch):
    def make(width: int, term: str = "xterm") -> Screen:
        monkeypatch.setenv("TERM", term)
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setenv("NO_COLOR", "1")
        monkeypatch.setattr(sys, "stderr", Screen())
        return sys.stderr

    return make


def test_one_line_of_at_most_80_columns(screen):
    stream = screen(80)
    with Progress(quiet=False) as progress:
        progress.iteration(WIDEST)
        line = progress._line()
    assert "iter 999  cost 1.2346e-10  change -2e-10  gradient 4e+12  radius 1e+16" in line.plain
    assert len(line.plain) <= 80
    shown = stream.getvalue()
    assert "radius 1e+16" in shown
    assert shown.endswith("\x1b[2K")  # nothing of it stays


def test_narrow_terminal_gets_one_line_too(screen):
    stream = screen(60)
    with Progress(quiet=False) as progress:
        progress.iteration(WIDEST)
    assert "\N{HORIZONTAL ELLIPSIS}" in stream.getvalue()


def test_dumb_terminal_gets_plain_lines(screen):
    stream = screen(80, term="dumb")
    with Progress(quiet=False) as progress:
        progress.stage("building the problem")
        progress.iteration(WIDEST)
    assert "\x1b" not in stream.getvalue()
    assert stream.getvalue().splitlines()[0] == "building the problem ..."


def test_quiet_on_a_terminal(screen):
    stream = screen(80)
    with Progress(quiet=True) as progress:
        progress.stage("building the problem")
        progress.iteration(WIDEST)
    assert stream.getvalue() == ""


@pytest.mark.parametrize(
    ("elapsed", "shown"), [(0.04, "0.0 s"), (59.9, "59.9 s"), (61.5, "1:01"), (3725.5, "1:02:05")]
)
def test_elapsed(monkeypatch, elapsed, shown):
    progress = Progress(quiet=True)
    monkeypatch.setattr(time, "perf_counter", lambda: progress._started + elapsed)
    assert progress._elapsed() == shown


def test_shares_of_long_work(screen, monkeypatch):
    screen(80)
    with Progress(quiet=False) as progress:
        progress.stage("making a scene")
        progress.share(0.256)
        assert progress._line().plain.endswith("making a scene ... 26%")
        progress.text(3_400_000_000)
        assert progress._line().plain.endswith("making a scene ... 3.4 GB")
        progress.stage("writing it")
        assert progress._line().plain.endswith("writing it ...")
    stream = screen(80, term="dumb")
    with Progress(quiet=False) as progress:
        progress.stage("making a scene")
        progress.share(0.1)  # too soon for another line
        monkeypatch.setattr("bundle.cli.output._SECONDS_BETWEEN_LINES", 0.0)
        progress.share(0.5)
    first, second = stream.getvalue().splitlines()
    assert first == "making a scene ..."
    assert second.startswith("making a scene ... 50%, ")
