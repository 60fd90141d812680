"""Running the command, in this process and in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import bundle
from bundle.cli.main import main
from tests.made_up_machine import cache
from tests.scenes import scene


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Run in this process."""

    def call(*arguments: Any) -> Outcome:
        code = main([str(argument) for argument in arguments])
        return Outcome(code, *capsys.readouterr())

    return call


def environment() -> dict[str, str]:
    """The environment with this very package in front, and buffers as users have them.

    Processes calibrate nothing, and leave the user's cache alone.
    """
    package = str(Path(bundle.__file__).parent.parent)
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    own = {"PYTHONPATH": package, "PYTHONWARNINGS": "error", "XDG_CACHE_HOME": cache().name}
    return inherited | own


def command(*arguments: Any) -> list[str]:
    return [sys.executable, "-m", "bundle", *map(str, arguments)]


@pytest.fixture
def spawn() -> Callable[..., Outcome]:
    """Run in a process of its own."""

    def call(*arguments: Any, **settings: Any) -> Outcome:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        done = subprocess.run(
            command(*arguments), env=environment(), text=True, timeout=60, check=False,
            **{**pipes, **settings},
        )  # fmt: skip
        return Outcome(done.returncode, done.stdout, done.stderr)

    return call


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A small BAL file."""
    path = tmp_path / "problem.txt"
    bundle.save(scene(), path)
    return path
