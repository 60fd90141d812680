"""Loop closures as edges between images, out of a pose graph whose ids are those of images."""

from __future__ import annotations

import os

import numpy as np

from bundle.base.arguments import check_type
from bundle.base.paths import as_path
from bundle.errors import InputError
from bundle.graphs.pose_graphs.information import checked_information
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

__all__ = ["Closures", "as_closures", "images_of"]

Closures = PoseGraph | str | os.PathLike[str]
"""A pose graph whose edges are closures and whose ids are ids of images, or the path of one."""


def as_closures(closures: Closures) -> PoseGraph:
    """Return the pose graph, read where it is a path, and checked.

    Raises:
        InputError: it is of the plane, has no edges, or an information matrix is none.
        OSError: the path cannot be read.
    """
    graph = closures
    if not isinstance(closures, PoseGraph):
        if not isinstance(closures, str | os.PathLike):
            check_type("closures", closures, PoseGraph)
        graph = load_g2o(as_path(closures, "closures"))
    assert isinstance(graph, PoseGraph)
    name = graph.path or "closures"
    if graph.dimension != 3:
        raise InputError(f"{name}: expected relative poses in space, found poses in the plane")
    if graph.num_edges == 0:
        raise InputError(f"{name}: expected edges that close loops, found none")
    return checked_information(graph, "file")


def images_of(
    closures: PoseGraph, problem: Problem
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Return the indices (m, 2) of the images of closures.

    Raises:
        InputError: an id is that of no image, or both images are of one frame, whose relative
            poses are the rig's; the message names the edge, and file and line where there are some.
    """
    index = {image_id: at for at, image_id in enumerate(problem.image_ids.tolist())}
    ids = closures.ids[closures.edges]
    found = np.array([[index.get(key, -1) for key in pair] for pair in ids.tolist()], np.int64)
    unknown = (found < 0).any(axis=1)
    if unknown.any():
        edge = int(np.argmax(unknown))
        missing = int(ids[edge][np.argmax(found[edge] < 0)])
        raise InputError(
            f"{closures.edge_name(edge)}: expected ids of images of the model, found {missing}, "
            "which is none"
        )
    if problem.num_frames:
        frames = problem.image_frame[found]
        same = (frames[:, 0] == frames[:, 1]) & (frames[:, 0] >= 0)
        if same.any():
            edge = int(np.argmax(same))
            raise InputError(
                f"{closures.edge_name(edge)}: expected images of two frames, found two of frame "
                f"{problem.frame_ids[frames[edge, 0]]}"
            )
    return found
