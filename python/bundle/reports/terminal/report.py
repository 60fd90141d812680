"""What `bundle report` says of the page that it wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from bundle.base.memory_sizes import format_size
from bundle.base.tables import facts, format_name
from bundle.base.tables import notes as note_lines
from bundle.base.words import contents
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.reports.terminal import json
from bundle.reports.terminal.rig_tables import rig_fact

__all__ = ["as_json", "reported"]


def reported(path: str, problem: Problem, page: str, notes: Sequence[str]) -> list[RenderableType]:
    """Return what is in the input, where the page is, and what it could not show."""
    size = format_size(Path(page).stat().st_size) if Path(page).is_file() else ""
    rows = [
        ("input", f"{shown(path)} ({format_name(problem.format)})"),
        ("", contents(problem)),
        *rig_fact(problem),
        ("output", f"{shown(page)} ({size})" if size else shown(page)),
    ]
    return [facts(rows), *note_lines(notes, style="yellow")]


def as_json(
    path: str, problem: Problem, page: str, notes: Sequence[str], wall_time: float
) -> dict[str, Any]:
    """Return the report for programs; ``notes`` say what the page could not show."""
    return {
        **json.heading("report", path, problem),
        "notes": list(notes),
        "wall_time": {"total": wall_time},
        "output": {"path": page, "format": "html"},
    }
