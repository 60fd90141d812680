"""Reading and writing of anything: reconstructions and pose graphs, told by their content."""

from __future__ import annotations

import os
from typing import Any

from bundle.errors import InputError
from bundle.io import open as io
from bundle.io.g2o_files import load_g2o, save_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

__all__ = ["load", "save"]


def load(path: str | os.PathLike[str]) -> Any:
    """Read a reconstruction or a pose graph; what it is, the content tells.

    Args:
        path: the folder of a COLMAP model (binary or text), a BAL file or a g2o file (both plain,
            gzip or bzip2).

    Returns:
        A :class:`bundle.Problem`, or a :class:`bundle.PoseGraph` for a g2o file.

    Raises:
        InputError: the content is not what its format says; one line with path, place, what was
            expected and what was found.
        OSError: the path does not exist or cannot be read.
    """
    return load_g2o(path) if is_pose_graph_file(path) else io.load(path)


def save(
    problem: Problem | PoseGraph,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> tuple[str, ...]:
    """Write a reconstruction or a pose graph; return what the format does not keep.

    What stood at ``path`` is replaced only when the new content is whole on the disk. Of a folder,
    which must be empty or a COLMAP model, only the model files are replaced.

    Args:
        problem: what to write; a pose graph becomes a g2o file.
        path: a file (BAL or g2o; ".gz" and ".bz2" at the end compress) or a folder (COLMAP).
        format: "bal", "colmap" (binary) or "colmap-text" for a reconstruction; None: by the path,
            then by where the problem comes from.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: the system refuses: no permission, disk full.
    """
    if not isinstance(problem, PoseGraph):
        return io.save(problem, path, format)
    if format is not None:
        raise InputError(f"format: expected none for a pose graph, found {format}")
    return save_g2o(problem, path)
