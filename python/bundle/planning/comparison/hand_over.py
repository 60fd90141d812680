"""Problem on disk for other processes: one file per array, for fast reading from the disk cache.

Data that is needed only for writing a model (names, the original reconstruction) is not stored.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bundle.base.arrays import freeze
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter

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
        "rolling_shutter": _as_lists(problem.rolling_shutter),
    }
    (folder / _REST).write_text(json.dumps(rest))


def restore(folder: Path, mmap_mode: Literal["r"] | None = None) -> Problem:
    """Read a problem; with mmap_mode "r" only the accessed pages take memory."""
    # No other process writes to these files, so memory-mapped arrays need no copy.
    arrays: dict[str, Any] = {
        path.stem: freeze(np.load(path, mmap_mode=mmap_mode))
        for path in sorted(folder.glob("*.npy"))
    }
    rest = json.loads((folder / _REST).read_text())
    if rest["rolling_shutter"] is not None:
        rest["rolling_shutter"] = RollingShutter(**rest["rolling_shutter"])
    return Problem(**arrays, **rest)


def store_solution(problem: Problem, path: Path) -> None:
    """Write the values that a solve changes."""
    with path.open("wb") as file:
        np.savez(file, **dict[str, Any](estimates(problem)))


def restore_solution(problem: Problem, path: Path) -> Problem:
    """Return the problem with the values of a stored solution."""
    with np.load(path) as arrays:
        return with_estimates(problem, arrays, checked=True)


def _as_lists(shutter: RollingShutter | None) -> dict[str, Any] | None:
    """Return the fields of rolling shutters as JSON values, which keep every bit."""
    if shutter is None:
        return None
    fields = {field.name: getattr(shutter, field.name) for field in dataclasses.fields(shutter)}
    del fields["axis"]  # computed from the directions
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in fields.items()
    }
