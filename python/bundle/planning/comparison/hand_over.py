"""A problem on disk for other processes: one file an array, read as fast as the disk cache allows.

What only writing back needs (names, the reconstruction that was read) stays behind.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bundle.base.arrays import freeze
from bundle.model.problem import Problem

__all__ = ["restore", "store"]

_REST = "problem.json"


def store(problem: Problem, folder: Path) -> None:
    """Write a problem into a folder, which is made."""
    folder.mkdir()
    for name, value in vars(problem).items():
        if isinstance(value, np.ndarray):
            np.save(folder / f"{name}.npy", value)
    rest = {
        "camera_models": problem.camera_models,
        "image_names": problem.image_names,
        "format": problem.format,
    }
    (folder / _REST).write_text(json.dumps(rest))


def restore(folder: Path, mmap_mode: Literal["r"] | None = None) -> Problem:
    """Read it back; with mmap_mode "r" only what is touched takes memory."""
    # Nobody else writes to these files, so what is mapped need not be copied.
    arrays: dict[str, Any] = {
        path.stem: freeze(np.load(path, mmap_mode=mmap_mode))
        for path in sorted(folder.glob("*.npy"))
    }
    return Problem(**arrays, **json.loads((folder / _REST).read_text()))
