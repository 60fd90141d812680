"""Place of ``georeference.json``, and its model; ``georeferenced.py`` has its content.

It is in the folder of a COLMAP model, or in the folder that contains a BAL file. For a BAL file,
the entry "model" holds the name of the file. Without this entry it belongs to the COLMAP model in
its folder; if the folder has no such model, it belongs to any file in the folder. It is removed
when its model is replaced.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bundle.io.atomic.replaced_paths import missing_model_files

GEOREFERENCE = "georeference.json"
OWNER = "model"


def path_beside(model: Path, *, is_folder: bool) -> Path:
    """Return the path of the georeference of a model; the file need not exist."""
    return (model if is_folder else model.parent) / GEOREFERENCE


def georeference_of(model: Path, *, is_folder: bool) -> dict[str, Any] | None:
    """Return the georeference of a model; None if the file is missing or has other content."""
    path = path_beside(model, is_folder=is_folder)
    found = _content(path)
    if found is None or owner_of(path, found) not in (None, "" if is_folder else model.name):
        return None
    return found


def owner_of(path: Path, content: dict[str, Any] | None = None) -> str | None:
    """Return the name of the model file that a georeference.json belongs to.

    Returns:
        "" if it belongs to the model in its folder, None if it does not name a model.
    """
    found = _content(path) if content is None else content
    if found is None:
        return None
    if isinstance(found.get(OWNER), str):
        return str(found[OWNER])
    return None if missing_model_files(path.parent) else ""


def remove_georeference(model: Path, *, is_folder: bool) -> None:
    """Remove the georeference of a model that was replaced."""
    if georeference_of(model, is_folder=is_folder) is not None:
        path_beside(model, is_folder=is_folder).unlink(missing_ok=True)


def _content(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "reference_system" in found else None
