"""The files that make a COLMAP model."""

from __future__ import annotations

from pathlib import Path

__all__ = ["MODEL_FILES", "missing_model_files"]

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
