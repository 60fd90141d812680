"""What stands at a path that something else is about to replace."""

from __future__ import annotations

import re
from pathlib import Path

from bundle.io.model_files import MODEL_FILES, missing_model_files

__all__ = ["reconstruction_at"]

_HEADER = re.compile(rb"\s*\d+\s+\d+\s+\d+\s+\d+\s+\d+\s+[-+.\d]")  # counts, first observation
_ENOUGH = 512


def reconstruction_at(path: Path) -> str | None:
    """Return "a COLMAP model", "a file of a COLMAP model", "a BAL file", or None for all else."""
    if path.is_dir():
        return None if missing_model_files(path) else "a COLMAP model"
    if path.name in MODEL_FILES and path.exists() and not missing_model_files(path.parent):
        return "a file of a COLMAP model"
    if path.is_file() and _HEADER.match(_beginning(path)):
        return "a BAL file"
    return None


def _beginning(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            start = file.read(_ENOUGH)
        if start.startswith(b"\x1f\x8b"):
            import gzip

            with gzip.open(path, "rb") as packed:
                return packed.read(_ENOUGH)
        if start.startswith(b"BZh"):
            import bz2

            with bz2.open(path, "rb") as packed:
                return packed.read(_ENOUGH)
        return start
    except (OSError, EOFError):
        return b""
