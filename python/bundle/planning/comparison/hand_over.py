"""Problem on disk for other processes: one file per array, for fast reading from the disk cache.

Data that is needed only for writing a model (names, the original reconstruction) is not stored.
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
    """Write a problem into a new folder."""
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
    """Read a problem; with mmap_mode "r" only the accessed pages take memory."""
    # No other process writes to these files, so memory-mapped arrays need no copy.
    arrays: dict[str, Any] = {
        path.stem: freeze(np.load(path, mmap_mode=mmap_mode))
        for path in sorted(folder.glob("*.npy"))
    }
    return Problem(**arrays, **json.loads((folder / _REST).read_text()))
