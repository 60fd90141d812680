"""Files of loop closures: a csv of stamps and relative poses, or the edges of a g2o file.

A line of the csv is ``first_timestamp_ns, second_timestamp_ns, tx, ty, tz, qx, qy, qz, qw,
sigma_position, sigma_rotation``: the IMU pose at the second stamp in its frame at the first, and
standard deviations in metres and degrees. In a g2o file the ids of the vertices are the stamps.
"""

from __future__ import annotations

import os

import numpy as np

from bundle.base.paths import as_path
from bundle.errors import InputError, shown
from bundle.inertial.two_loops.closure_loop import Closure
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.io.sequences.csv_tables import read_csv

_STAMPS = ("first_timestamp_ns", "second_timestamp_ns")
_NUMBERS = ("tx", "ty", "tz", "qx", "qy", "qz", "qw", "sigma_position", "sigma_rotation")


def load_closures(path: str | os.PathLike[str]) -> tuple[Closure, ...]:
    """Read the closures of a file, sorted by the stamp of their later end.

    Raises:
        InputError: a line has a wrong format, a sigma is not above 0, a quaternion does not have
            norm 1, or an edge is planar; one line with file, line, expected and found.
        OSError: the file cannot be read.
    """
    path = as_path(path)
    found = _of_g2o(path) if is_pose_graph_file(path) else _of_csv(path)
    if not found:
        raise InputError(f"{shown(path)}: expected closures, found 0")
    return tuple(sorted(found, key=lambda closure: max(closure.first_ns, closure.second_ns)))


def _of_csv(path: os.PathLike[str]) -> list[Closure]:
    table = read_csv(path, _STAMPS, _NUMBERS)
    closures = []
    for row, (stamps, numbers) in enumerate(zip(table.whole, table.numbers, strict=True)):
        norm = float(np.linalg.norm(numbers[3:7]))
        if not np.isfinite(numbers).all() or not abs(norm - 1) < 0.01:
            raise InputError(
                f"{table.place(row)}: expected finite numbers and a quaternion of norm 1, found "
                f"norm {norm:g}"
            )
        if not (numbers[7:] > 0).all():
            raise InputError(
                f"{table.place(row)}: expected sigmas above 0, found {numbers[7]:g}, {numbers[8]:g}"
            )
        sigmas = np.repeat([np.radians(numbers[8]), numbers[7]], 3)
        if stamps[0] == stamps[1]:
            raise InputError(
                f"{table.place(row)}: expected two different stamps, found the same twice"
            )
        pose = np.concatenate([numbers[3:7], numbers[:3]])
        information = np.diag(sigmas**-2.0)
        closures.append(Closure(int(stamps[0]), int(stamps[1]), pose, information))
    return closures


def _of_g2o(path: str | os.PathLike[str]) -> list[Closure]:
    graph = load_g2o(path)
    if graph.dimension != 3:
        raise InputError(f"{shown(path)}: expected edges EDGE_SE3:QUAT, found planar edges")
    stamps = graph.ids[graph.edges].tolist()
    rows = zip(stamps, graph.measurements, graph.information, strict=True)
    return [Closure(first, second, pose, matrix) for (first, second), pose, matrix in rows]
