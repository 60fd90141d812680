"""Reading and writing of problems in the formats of the field.

Formats are told from content when reading. Writing is atomic: see ``bundle.io.atomic``.
"""

from __future__ import annotations

import os
from pathlib import Path

from bundle import address_space
from bundle.errors import InputError, shown
from bundle.io import atomic, bal
from bundle.io.model_files import MODEL_FILES, missing_model_files
from bundle.problem import Problem

__all__ = ["FORMATS", "check_target", "load", "output_format", "save"]

FORMATS = ("bal", "colmap", "colmap-text")

_BAL_SUFFIXES = (".txt", ".txt.gz", ".txt.bz2")


def load(path: str | os.PathLike[str]) -> Problem:
    """Read a COLMAP model folder (binary or text) or a BAL file (plain, gzip or bzip2).

    Raises:
        InputError: the content is not what its format says; one line with path, place, what was
            expected and what was found.
        OSError: the path does not exist or cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        _check_model(path)
        address_space.require("pycolmap", address_space.PYCOLMAP)
        from bundle.io import colmap  # pycolmap takes a while to import

        return colmap.load(path)
    if path.name in MODEL_FILES and not missing_model_files(path.parent):
        raise InputError(
            f"{shown(path)}: expected the folder of a COLMAP model, found one of its files"
        )
    return bal.load(path)


def save(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> tuple[str, ...]:
    """Write a problem; return what the format does not keep, one sentence each.

    What stood at ``path`` is replaced only when the new content is whole on the disk. Of a folder,
    which must be empty or a COLMAP model, only the model files are replaced.

    Args:
        problem: what to write.
        path: a file (BAL; ".gz" and ".bz2" at the end compress) or a folder (COLMAP).
        format: "bal", "colmap" (binary) or "colmap-text"; None: see ``output_format``.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: the system refuses: no permission, disk full.
    """
    chosen = output_format(problem, path, format)
    path = Path(path)
    if chosen == "bal":
        lost = bal.losses(problem)
        with atomic.replace_file(path) as temporary:
            bal.save(problem, temporary, _compression(path))
        return lost
    from bundle.io import colmap

    with atomic.replace_folder(path) as temporary:
        return colmap.save(problem, temporary, binary=chosen == "colmap")


def output_format(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> str:
    """Return the format in which ``save`` writes: "bal", "colmap" or "colmap-text".

    An explicit format counts first; then the path: ".txt", ".txt.gz" and ".txt.bz2" are BAL, an
    existing folder or a trailing slash is COLMAP; then the format in which the problem came, and
    COLMAP for one from memory.

    Raises:
        InputError: the explicit format is none of these.
    """
    if format is not None:
        if format not in FORMATS:
            raise InputError(f"format: expected one of {', '.join(FORMATS)}, found {format!r}")
        return format
    name = os.fspath(path)
    if name.endswith("/") or Path(path).is_dir():
        return "colmap"
    if name.lower().endswith(_BAL_SUFFIXES):
        return "bal"
    return "bal" if problem.format == "bal" else "colmap"


def check_target(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> None:
    """Raise now what ``save`` would refuse later, before hours go into a solve.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: there is no permission to write.
    """
    if output_format(problem, path, format) == "bal":
        bal.radial_params(problem)
        atomic.check_file(Path(path))
    else:
        atomic.check_folder(Path(path))


def _compression(path: Path) -> str:
    return {".gz": "gzip", ".bz2": "bzip2"}.get(path.suffix.lower(), "")


def _check_model(folder: Path) -> None:
    """Raise an InputError that says what a folder lacks to be a COLMAP model."""
    missing = missing_model_files(folder)
    if not missing:
        return
    found = f"found a folder without {', '.join(missing)}"
    models = [
        shown(child.name)
        for child in sorted(folder.iterdir())
        if child.is_dir() and not missing_model_files(child)
    ]
    if models:
        found += f"; there are models inside: {', '.join(models[:5])}"
    raise InputError(f"{shown(folder)}: expected a COLMAP model, {found}")
