"""Georeference beside an output: georeference.json is always true of the model beside it.

A command that places a model writes it; one that leaves a model in its place carries that of its
input along; where there is none, that of an earlier model goes with that model (``bundle.io``).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.georeference_file import OWNER, georeference_of, owner_of, path_beside
from bundle.reports.sections import dumps, plain

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import Alignment
    from bundle.georeference.georeferenced import Georeference

__all__ = ["carry_georeference", "check_georeference", "georeference_at", "write_georeference"]

IDENTITY = {
    "scale": 1.0,
    "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "translation": [0.0, 0.0, 0.0],
}
FRAME = ("reference_system", "origin", "pipeline")


def georeference_at(source: str) -> dict[str, Any] | None:
    """Return what is said of the place of a model; None where nothing is."""
    return georeference_of(Path(source), is_folder=Path(source).is_dir())


def check_georeference(path: str, format: str) -> None:
    """Refuse now what could not be written later.

    Raises:
        InputError: something that is no file stands there, or it is of another model.
        OSError: there is no permission.
    """
    model = Path(path)
    beside = path_beside(model, is_folder=format != "bal")
    if not beside.parent.is_dir():
        return
    atomic.check_file(beside)
    owner = owner_of(beside)
    if format != "bal" or owner in (None, model.name):
        return
    if not owner or (beside.parent / owner).exists():
        what = shown(owner) if owner else "the model in its folder"
        raise InputError(
            f"{shown(path)}: expected a folder in which {beside.name} is not of another model, "
            f"found that of {what}"
        )


def write_georeference(
    georeference: Georeference | Alignment, path: str, format: str, reference: str | None = None
) -> None:
    """Write the file, whole or not at all.

    Args:
        georeference: of the model.
        path: of the model.
        format: of the model.
        reference: path of another model, whose frame it has.
    """
    found = plain(georeference.asdict())
    frame = None if reference is None else georeference_at(reference)
    _write(found | ({} if frame is None else _frame(frame)), path, format)


def carry_georeference(
    found: dict[str, Any] | None, path: str, format: str, changed: str = ""
) -> None:
    """Write what an input says of the place of its model, of a model in the same frame.

    Args:
        found: at the input; None: nothing.
        path: of the model.
        format: of the model.
        changed: a sentence on what happened to it, if it is not that of the input any more. What
            measurements say of it has gone then.
    """
    if found is None:
        return
    if changed:
        found = _frame(found) | {
            "similarity": IDENTITY,
            "gps": [],
            "gcps": [],
            "rms_enu": None,
            "rms_enu_check": None,
            "notes": [changed],
        }
    _write(found, path, format)


def _frame(found: dict[str, Any]) -> dict[str, Any]:
    return {name: found.get(name) for name in FRAME}


def _write(found: dict[str, Any], path: str, format: str) -> None:

    model = Path(path)
    content = {name: value for name, value in found.items() if name != OWNER}
    if format == "bal":
        content[OWNER] = model.name
    beside = path_beside(model, is_folder=format != "bal")
    atomic.write_text(beside, dumps(content))
