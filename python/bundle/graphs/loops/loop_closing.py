"""Loop closures: edges between images as input, and the result of closing loops."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from bundle.base.arrays import check_type, refuse_row
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.base.words import change, plural
from bundle.errors import InputError
from bundle.graphs.factors.factors import RelativePoseFactor
from bundle.graphs.pose_graphs.edge_weights import checked_information
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem


@dataclass(frozen=True, kw_only=True)
class LoopClosure:
    """Result for one closure.

    Attributes:
        image_ids: ids of its two images.
        line: line in the file of closures; 0: not from a file.
        used: False if the closure was rejected.
        rotation_before: angle to the measured rotation in the given model, in degrees.
        rotation_after: the same angle after solving the graph.
        translation_before: distance to the measured translation in the given model, in the model's
            length unit around the first image.
        translation_after: the same distance after solving the graph, in the same unit.
        chi2_before: r^T Omega r in the given model.
        chi2_after: r^T Omega r after solving the graph.
        is_factor: True if bundle adjustment also needs the closure as a factor, because its images
            share few points.
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
class LoopClosing(Displayed, Tabular):
    """Problem with closed loops, ready for bundle adjustment.

    Attributes:
        problem: the problem with images moved by the graph, and points moved with their images.
        initial_problem: the given problem.
        closures: results in the given order.
        factors: used closures whose images share too few points to stay connected, for bundle
            adjustment: ``bundle.solve(closed.problem, factors=closed.factors)``.
        num_nodes: nodes of the graph: images, or frames of rigs.
        num_edges: pairs of images that share points.
        num_components: number of connected components; the first image of each does not move.
        has_free_scales: True if images could change their scale; True without rigs.
        scale_range: smallest and largest scale of an image relative to the first of its component.
        variance_factor: divisor of the information of the model's own edges.
        cost_before: half the sum of chi2 in the given model, without rejected closures.
        cost_after: the same sum after solving the graph.
        num_carried_points: points that moved with an image.
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
        """Number of closures in use."""
        return sum(closure.used for closure in self.closures)

    @property
    def num_rejected(self) -> int:
        """Number of rejected closures."""
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
"""Pose graph, or its path: edges are closures, and ids are ids of images."""


def as_closures(closures: Closures) -> PoseGraph:
    """Return the checked pose graph, read from a path if necessary."""
    graph = closures
    if not isinstance(closures, PoseGraph):
        if not isinstance(closures, str | os.PathLike):
            check_type("closures", closures, PoseGraph)
        graph = load_g2o(as_path(closures, "closures"))
    assert isinstance(graph, PoseGraph)
    name = graph.path or "closures"
    if graph.dimension != 3:
        raise InputError(f"{name}: expected relative poses in 3D (SE(3)), found poses in 2D")
    if graph.num_edges == 0:
        raise InputError(f"{name}: expected edges that close loops, found 0")
    return checked_information(graph, "file")


def images_of(
    closures: PoseGraph, problem: Problem
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Return the indices (m, 2) of the images of closures."""
    index = {image_id: at for at, image_id in enumerate(problem.image_ids.tolist())}
    ids = closures.ids[closures.edges]
    found = np.array([[index.get(key, -1) for key in pair] for pair in ids.tolist()], np.int64)
    unknown = (found < 0).any(axis=1)
    refuse_row(
        unknown,
        lambda edge: (
            f"{closures.edge_name(edge)}: image {int(ids[edge][np.argmax(found[edge] < 0)])} "
            "is not in the model"
        ),
    )
    if problem.num_frames:
        frames = problem.image_frame[found]
        same = (frames[:, 0] == frames[:, 1]) & (frames[:, 0] >= 0)
        refuse_row(
            same,
            lambda edge: (
                f"{closures.edge_name(edge)}: expected images of two frames, found two images of "
                f"frame {problem.frame_ids[frames[edge, 0]]}"
            ),
        )
    return found
