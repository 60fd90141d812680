"""Weak joints: parts of a model that hang on the rest by few points.

Test. The weight of two images is the number of their common points. A maximum spanning tree of
these weights connects the images; removing its edge (a, b) of weight w leaves two parts, and no
pair of images across them has more than w points in common. Parts across which fewer than 15 points
are seen have an uncertain relative pose and scale: 7 degrees of freedom from 15 points of a few
pixels' noise, of which outliers may be some. Both parts have at least two images.

Cost. Divide the points into 15 disjoint sets. If the points of each set connect all images, any two
parts share at least 15 points, one of each set, and no weak joint exists. This test takes linear
time. Only models that fail it, or small ones, need the pairs of images.

The images of a frame of a rig are one image: the rig holds them together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.base.arrays import distinct
from bundle.base.components import component_roots
from bundle.base.words import named, plural
from bundle.interface.finding import Finding
from bundle.model.problem import Problem

FEW = 15
SMALL = 50_000
MOST_EDGES_TRIED = 20

Ints = NDArray[np.int64]


def weak_joint(problem: Problem, tracks: TrackTable) -> Finding | None:
    """Return the finding about the weakest joint, or None."""
    if len(tracks.points) > SMALL and _is_firm(problem, tracks):
        return None
    images, count = _weakest(problem, tracks)
    if not count:
        return None
    ids = sorted(problem.image_ids[images].tolist())
    return Finding(
        kind="weak_joint",
        sentence=f"Weak joint: {plural(len(ids), 'image')} ({named('image', ids)}) share only "
        f"{plural(count, 'point')} with the other {problem.num_images - len(ids)}: their relative "
        "pose and scale are uncertain. Match more pairs across this joint, or close a loop.",
        evidence={"image_ids": ids, "num_points": count},
    )


def _is_firm(problem: Problem, tracks: TrackTable) -> bool:
    """Return True if the points of each of 15 sets connect all images that have 100 points."""
    many = np.bincount(tracks.images, minlength=problem.num_images) >= 100
    chosen = many[tracks.images]
    images, points = tracks.images[chosen], tracks.points[chosen]
    for rest in range(FEW):
        own = points % FEW == rest
        starts = np.flatnonzero(np.diff(points[own], prepend=-1))
        roots = component_roots(images[own], starts, problem.num_images)
        if len(distinct(roots[many])) > 1:
            return False
    return True


def _weakest(problem: Problem, tracks: TrackTable) -> tuple[Ints, int]:
    """Return the images of the smaller part at the weakest joint, and its points; 0: none."""
    node = _nodes(problem)
    first, second, weight = tracks.pair_counts
    first, second = node[first], node[second]
    apart = first != second
    first, second, weight = first[apart], second[apart], weight[apart]
    order = np.argsort(-weight, kind="stable")
    parent = np.arange(problem.num_images)
    tree: list[tuple[int, int, int]] = []

    def root(image: int) -> int:
        while parent[image] != image:
            parent[image] = parent[parent[image]]
            image = int(parent[image])
        return image

    for a, b, w in zip(
        first[order].tolist(), second[order].tolist(), weight[order].tolist(), strict=True
    ):
        one, other = root(a), root(b)
        if one != other:
            parent[one] = other
            tree.append((a, b, w))
    weak = [edge for edge in reversed(tree) if edge[2] < FEW][:MOST_EDGES_TRIED]
    best: tuple[Ints, int] = (np.zeros(0, np.int64), 0)
    for edge in weak:
        nodes, others = _sides(tree, edge, problem.num_images)
        if min(len(nodes), len(others)) < 2:
            continue
        images = np.flatnonzero(np.isin(node, nodes))
        count = tracks.count_between(images)
        if 0 < count < FEW and (not best[1] or count < best[1]):
            best = (images, count)
    return best


def _nodes(problem: Problem) -> Ints:
    """Return the first image of the frame of each image, or the image itself."""
    node = np.arange(problem.num_images)
    if problem.num_frames:
        carried = np.flatnonzero(problem.image_frame >= 0)
        frame = problem.image_frame[carried]
        first = np.full(problem.num_frames, problem.num_images)
        np.minimum.at(first, frame, carried)
        node[carried] = first[frame]
    return node


def _sides(
    tree: list[tuple[int, int, int]], without: tuple[int, int, int], count: int
) -> tuple[Ints, Ints]:
    """Return the two sides of the tree without one edge, the smaller first."""
    edges = np.array([edge[:2] for edge in tree if edge is not without], np.int64).reshape(-1, 2)
    roots = component_roots(edges.ravel(), np.arange(len(edges)) * 2, count)
    one, other = sorted((np.flatnonzero(roots == roots[end]) for end in without[:2]), key=len)
    return one, other
