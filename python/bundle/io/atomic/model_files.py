"""The files that make a COLMAP model."""

from __future__ import annotations

import os
from pathlib import Path

DEPTH = 3
"""Depth of the search for models below a folder: projects store them in dense/0/sparse/."""
MOST_FOLDERS = 1000
"""Largest number of folders to search for a hint."""

_REQUIRED = ("cameras", "images", "points3D")
_OPTIONAL = ("rigs", "frames")
_SUFFIXES = (".bin", ".txt")

ROLLING_SHUTTER = "rolling_shutter.json"
"""File with the rolling shutters of a model; COLMAP does not know it."""
MODEL_FILES = frozenset(
    [*(stem + suffix for stem in _REQUIRED + _OPTIONAL for suffix in _SUFFIXES), ROLLING_SHUTTER]
)


def missing_model_files(folder: Path) -> tuple[str, ...]:
    """Return the files that a folder lacks to be a COLMAP model; () if the model is complete.

    The result is for the format, binary or text, with fewer missing files. On a tie it is for
    binary, which COLMAP prefers.
    """
    return min((_missing(folder, suffix) for suffix in _SUFFIXES), key=len)


def is_text_model(folder: Path) -> bool:
    """Return True if the folder holds a text COLMAP model but no binary one."""
    return bool(_missing(folder, ".bin")) and not _missing(folder, ".txt")


def _missing(folder: Path, suffix: str) -> tuple[str, ...]:
    names = (stem + suffix for stem in _REQUIRED)
    return tuple(name for name in names if not (folder / name).is_file())


def models_below(folder: Path) -> list[Path]:
    """Return the model folders below a folder, the least nested first.

    Links are not followed. Hidden folders, such as leftovers of killed runs, are skipped.
    """
    found: list[Path] = []
    level, seen = [folder], 0
    for _ in range(DEPTH):
        below = []
        for parent in level:
            try:
                children = sorted(entry.path for entry in os.scandir(parent) if _is_folder(entry))
            except OSError:  # no permission to read
                continue
            below += [Path(child) for child in children[: max(MOST_FOLDERS - seen, 0)]]
            seen += len(children)
        found += [child for child in below if not missing_model_files(child)]
        level = below
    return found


def _is_folder(entry: os.DirEntry[str]) -> bool:
    return entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")
