"""What `bundle convert` says."""

from __future__ import annotations

from rich.console import RenderableType

from bundle.base.tables import facts, format_name, notes
from bundle.base.words import contents
from bundle.editing.cameras.edit_record import CameraEdits
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.reports.terminal.camera_edit_rows import edit_rows

__all__ = ["conversion"]


def conversion(
    path: str,
    problem: Problem,
    output: dict[str, str],
    lost: tuple[str, ...],
    edits: CameraEdits | None = None,
) -> list[RenderableType]:
    """Return what was read, what was written and what was lost between them."""
    rows = [
        ("input", f"{shown(path)} ({format_name(problem.format)})"),
        ("", contents(problem)),
        *edit_rows(edits),
        ("output", f"{shown(output['path'])} ({format_name(output['format'])})"),
        ("lost", "" if lost else "nothing"),
    ]
    warnings = () if edits is None else edits.warnings
    return [facts(rows), *notes(lost), *notes(warnings, style="yellow")]
