"""The file that says where a model is, ``georeference.json``: in its folder, or beside its file.

It is of one model. Beside a file it has the name of that file under "model"; without it, it is of
the model in the folder, or where there is none of whatever file is asked about. When another model
takes the place of the one that it is of, it goes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bundle.io.atomic.model_files import missing_model_files

__all__ = ["GEOREFERENCE", "georeference_of", "owner_of", "path_beside", "remove_georeference"]

GEOREFERENCE = "georeference.json"
OWNER = "model"


def path_beside(model: Path, *, is_folder: bool) -> Path:
    """Return where the file of a model stands, whether or not there is one."""
    return (model if is_folder else model.parent) / GEOREFERENCE


def georeference_of(model: Path, *, is_folder: bool) -> dict[str, Any] | None:
    """Return what the file of a model says; None where there is none, or something else."""
    path = path_beside(model, is_folder=is_folder)
    found = _content(path)
    if found is None or owner_of(path, found) not in (None, "" if is_folder else model.name):
        return None
    return found


def owner_of(path: Path, content: dict[str, Any] | None = None) -> str | None:
    """Return the name of the file that a georeference.json is of.

    Returns:
        "" where it is of the folder that it is in, None where it does not say.
    """
    found = _content(path) if content is None else content
    if found is None:
        return None
    if isinstance(found.get(OWNER), str):
        return str(found[OWNER])
    return None if missing_model_files(path.parent) else ""


def remove_georeference(model: Path, *, is_folder: bool) -> None:
    """Remove the file of a model that is not there any more."""
    if georeference_of(model, is_folder=is_folder) is not None:
        path_beside(model, is_folder=is_folder).unlink(missing_ok=True)


def _content(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "reference_system" in found else None
