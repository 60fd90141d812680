"""The files that make a COLMAP model."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["MODEL_FILES", "missing_model_files", "models_below"]

DEPTH = 3
"""Levels below a folder where models are looked for: a project has them in dense/0/sparse/."""
MOST_FOLDERS = 1000
"""Folders that are looked into: a hint is worth no more."""

_REQUIRED = ("cameras", "images", "points3D")
_OPTIONAL = ("rigs", "frames")
_SUFFIXES = (".bin", ".txt")

MODEL_FILES = frozenset(stem + suffix for stem in _REQUIRED + _OPTIONAL for suffix in _SUFFIXES)


def missing_model_files(folder: Path) -> tuple[str, ...]:
    """Return what the folder lacks to be a COLMAP model: () if it is one, binary or text.

    Of the two kinds the one that is nearer to complete is meant; binary where they tie, as COLMAP
    prefers it.
    """
    lacking = [
        tuple(stem + suffix for stem in _REQUIRED if not (folder / (stem + suffix)).is_file())
        for suffix in _SUFFIXES
    ]
    return min(lacking, key=len)


def models_below(folder: Path) -> list[Path]:
    """Return the models inside a folder, the nearest first; links are not followed."""
    found: list[Path] = []
    level, seen = [folder], 0
    for _ in range(DEPTH):
        below = []
        for parent in level:
            try:
                children = sorted(entry.path for entry in os.scandir(parent) if _is_folder(entry))
            except OSError:  # not ours to read
                continue
            below += [Path(child) for child in children[: max(MOST_FOLDERS - seen, 0)]]
            seen += len(children)
        found += [child for child in below if not missing_model_files(child)]
        level = below
    return found


def _is_folder(entry: os.DirEntry[str]) -> bool:
    return entry.is_dir(follow_symlinks=False)
