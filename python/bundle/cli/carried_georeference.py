"""georeference.json next to an output; it always describes the model next to it.

A command that georeferences a model writes the file. A command that keeps the frame of its input
copies the input's file. If the input has no such file, the file of an earlier model at the output
is removed with that model (``bundle.io``).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.georeference_file import OWNER, georeference_of, owner_of, path_beside
from bundle.io.open import is_folder_format
from bundle.reports.sections import dumps, plain

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import Alignment
    from bundle.georeference.georeferenced import Georeference

IDENTITY = {
    "scale": 1.0,
    "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "translation": [0.0, 0.0, 0.0],
}
FRAME = ("reference_system", "origin", "pipeline")


def georeference_at(source: str) -> dict[str, Any] | None:
    """Return the georeference next to a model; None without one."""
    return georeference_of(Path(source), is_folder=Path(source).is_dir())


def check_georeference(path: str, format: str) -> None:
    """Refuse an output where a georeference cannot be written, or that of another model stands."""
    model = Path(path)
    beside = path_beside(model, is_folder=is_folder_format(format))
    if not beside.parent.is_dir():
        return
    atomic.check_file(beside)
    owner = owner_of(beside)
    if is_folder_format(format) or owner in (None, model.name):
        return
    if not owner or (beside.parent / owner).exists():
        what = shown(owner) if owner else "the model in its folder"
        raise InputError(
            f"{shown(path)}: expected a folder without the {beside.name} of another model, found "
            f"that of {what}"
        )


def write_georeference(
    georeference: Georeference | Alignment, path: str, format: str, reference: str | None = None
) -> None:
    """Write georeference.json completely or not at all; ``reference`` is a model in its frame."""
    found = plain(georeference.asdict())
    frame = None if reference is None else georeference_at(reference)
    _write(found | ({} if frame is None else _frame(frame)), path, format)


def carry_georeference(
    found: dict[str, Any] | None, path: str, format: str, changed: str = ""
) -> None:
    """Write the georeference of an input, if any, next to a model in the same frame.

    ``changed`` is a sentence about a change of the model, which drops the errors at measurements.
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
    if not is_folder_format(format):
        content[OWNER] = model.name
    beside = path_beside(model, is_folder=is_folder_format(format))
    atomic.write_text(beside, dumps(content))
