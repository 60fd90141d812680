"""What closing loops gives back.

Loop closures as edges between images, out of a pose graph whose ids are those of images.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from bundle.base.arguments import check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path
from bundle.base.words import change, plural
from bundle.errors import InputError
from bundle.graphs.factors.factors import RelativePoseFactor
from bundle.graphs.pose_graphs.information import checked_information
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

__all__ = ["Closures", "LoopClosing", "LoopClosure", "as_closures", "images_of"]


@dataclass(frozen=True, kw_only=True)
class LoopClosure:
    """What became of a closure.

    Attributes:
        image_ids: its two images.
        line: of the file that it comes from; 0: none.
        used: whether the graph was bent to it.
        rotation_before: angle to the measured rotation in the model as it was, in degrees.
        rotation_after: the same after the graph was solved.
        translation_before: distance to the measured translation in the model as it was, in length
            units of the model around the first image.
        translation_after: the same after the graph was solved, in the same unit.
        chi2_before: r^T Omega r in the model as it was.
        chi2_after: the same after the graph was solved.
        is_factor: whether bundle adjustment takes it as well, because its images share few points.
    """

    image_ids: tuple[int, int]
    line: int
    used: bool
    rotation_before: float
    rotation_after: float
    translation_before: float
    translation_after: float
    chi2_before: float
    chi2_after: float
    is_factor: bool


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LoopClosing(Displayed):
    """A problem whose loops are closed, ready for bundle adjustment.

    Attributes:
        problem: images moved as the graph says, points with them.
        initial_problem: the input, untouched.
        closures: in the order given.
        factors: the used closures whose images share too few points to be held together by them,
            for bundle adjustment: ``bundle.solve(closed.problem, factors=closed.factors)``.
        num_nodes: images of the graph, frames of rigs counted once.
        num_edges: pairs of images that share points.
        num_components: pieces of the graph; each stays where its first image is.
        has_free_scales: whether images changed their scale: in a model without rigs.
        scale_range: least and largest scale of an image against the first of its piece.
        variance_factor: by which the information of the model's own edges was divided.
        cost_before: half the sum of chi2 over the graph, without rejected closures, of the model
            as it was.
        cost_after: the same after the graph was solved.
        num_carried_points: points that moved with an image that sees them.
    """

    problem: Problem
    initial_problem: Problem
    closures: tuple[LoopClosure, ...]
    factors: tuple[RelativePoseFactor, ...]
    num_nodes: int
    num_edges: int
    num_components: int
    has_free_scales: bool
    scale_range: tuple[float, float]
    variance_factor: float
    cost_before: float
    cost_after: float
    num_carried_points: int

    @property
    def num_used(self) -> int:
        """Closures that the graph was bent to."""
        return sum(closure.used for closure in self.closures)

    @property
    def num_rejected(self) -> int:
        """Closures that do not fit the others."""
        return len(self.closures) - self.num_used

    def asdict(self) -> dict[str, Any]:
        """Return counts, costs and every closure by name."""
        names = (
            *("num_used", "num_rejected", "num_nodes", "num_edges", "num_components"),
            *("has_free_scales", "scale_range", "variance_factor", "cost_before", "cost_after"),
            "num_carried_points",
        )
        return {
            **{name: getattr(self, name) for name in names},
            "closures": [dataclasses.asdict(closure) for closure in self.closures],
        }

    def _display(self) -> Display:
        least, largest = self.scale_range
        facts = [
            ("closures", f"{self.num_used} used, {self.num_rejected} rejected"),
            ("graph", f"{plural(self.num_nodes, 'pose')}, {plural(self.num_edges, 'edge')}"),
            ("cost", change(self.cost_before, self.cost_after)),
        ]
        if self.has_free_scales:
            facts.append(("scales", f"{least:.4g} to {largest:.4g}"))
        return Display(title="LoopClosing", facts=tuple(facts))


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
