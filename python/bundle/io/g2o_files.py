"""Reading and writing of pose graphs: ``cpp/core/io/g2o.h`` describes g2o; only poses as TUM."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.paths import as_path, compression_of
from bundle.base.words import plural
from bundle.errors import shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.recognition import check_name
from bundle.io.sequences.trajectory_files import save_tum
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.pose_table import PoseTable
from bundle.model.starts import start_without_poses

_SUFFIXES = (".g2o", ".g2o.gz", ".g2o.bz2", ".tum")
_SECONDS = 10**10  # ids below it are seconds, others nanoseconds


def load_g2o(path: str | os.PathLike[str]) -> PoseGraph:
    """Read a pose graph; compression by gzip or bzip2 is detected automatically."""
    path = as_path(path)
    read = _core.read_g2o(path)
    graph = PoseGraph(
        poses=read["poses"],
        edges=read["edges"],
        measurements=read["measurements"],
        information=read["information"],
        ids=read["ids"],
        fixed=read["fixed"].astype(bool),
        edge_lines=read["edge_lines"],
        path=shown(path),
        has_poses=read["has_vertices"],
        format="toro" if read["is_toro"] else "g2o",
        notes=_notes(read),
    )
    return graph if graph.has_poses else start_without_poses(graph)


def save_g2o(graph: PoseGraph, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a pose graph; a name that ends in ".gz" or ".bz2" is compressed.

    An existing file is replaced only when the new one is complete on the disk. Numbers have the
    fewest digits that read back unchanged. A name that ends in ".tum" gets only the poses, in the
    order of their ids, which are the time stamps. Returns sentences on losses.
    """
    path = as_path(path)
    if graph_format(path) == "tum":
        order = np.argsort(graph.ids)
        ids, poses = graph.ids[order], PoseTable.of_graph(graph).poses[order]
        unit = 1 if np.abs(ids).max(initial=0) >= _SECONDS else 10**9
        save_tum(path, ids * unit, poses)
        edges = plural(graph.num_edges, "edge", grouped=True)
        what = "nanoseconds" if unit == 1 else "seconds"
        return (f"{edges} and information are left out; time stamps are the ids, as {what}.",)
    with atomic.replace_file(path) as temporary:
        _core.write_g2o(temporary, graph, compression_of(path))
    return ()


def graph_format(path: object) -> str:
    """Return the format of an output path: "g2o" or "tum"."""
    return "tum" if str(path).lower().endswith(".tum") else "g2o"


def check_g2o_target(path: str | os.PathLike[str]) -> None:
    """Raise the error that :func:`save_g2o` would raise."""
    path = as_path(path)
    check_name(path, f"a pose graph ({', '.join(_SUFFIXES)})", own=".g2o .tum", compressed=".g2o")
    atomic.check_file(path)


def _notes(read: dict[str, Any]) -> tuple[str, ...]:
    plain, equal, packets = (
        int(read[f"num_{name}"]) for name in ("plain_edges", "equivalences", "sensor_packets")
    )
    notes = []
    if plain:
        notes.append(f"{plural(plain, 'edge')} without information: the identity is taken.")
    if equal:
        notes.append(
            f"{plural(equal, 'line')} EQUIV ignored: the edges that they name stay as measured."
        )
    if packets:
        notes.append(f"{plural(packets, 'packet')} of sensors (ROBOTLASER1) ignored.")
    return tuple(notes)
