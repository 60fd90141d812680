"""Reading and writing of problems in the formats of the field."""

from __future__ import annotations

import os
from pathlib import Path

from bundle.problem import Problem

__all__ = ["load", "save"]


def load(path: str | os.PathLike[str]) -> Problem:
    raise NotImplementedError


def save(problem: Problem, path: str | os.PathLike[str], format: str | None = None) -> None:  # noqa: A002
    raise NotImplementedError
